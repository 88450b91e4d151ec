"""Reading the HDF5 container of a NIR file into a graph, without trusting it.

HDF5 can link groups in circles, keep numbers in other files, claim arrays that no memory holds, and
read a damaged heap of texts without end; `nir.read` also checks inner graphs when told not to, and
does not say which node it cannot make. So the container is checked before anything in it is read,
and the graph is read node by node.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import nir
import numpy as np
from nir.serialization import hdf2dict

from spikedeploy.runtime.errors import ArtifactError

# bytes of all parameters: a file with more is taken for a mistake that would exhaust the memory
_MAX_PARAMETER_BYTES = 1 << 31
# bytes of an array for each that is stored (deflate packs 1032 zeros into one), and besides those
_MAX_EXPANSION = 1100
_FREE_BYTES = 1 << 20
# nested groups (a graph inside a graph takes three), and links in all
_MAX_DEPTH = 64
_MAX_LINKS = 100_000
# "GCOL" with version and padding, so that no weight is mistaken for it
_HEAP_SIGNATURE = b"GCOL\x01\x00\x00\x00"
_HEAP_HEADER = 16  # [bytes]
_REMEDY = "Export the network again, or correct the node."


def read_graph(path: Path) -> nir.NIRGraph:
    """The graph in a HDF5 file, as written; ArtifactError where the file holds none.

    Whether the graph can be computed is for runtime.graph.validate to check.
    """
    _check_heaps(path)
    try:
        with h5py.File(path, "r") as file:
            _check_container(file, path)
            tree = hdf2dict(file["node"])
        if tree["type"] != "NIRGraph":
            raise ValueError(f"it holds a single {tree['type']} and no graph")
        return _graph(tree, "")
    except ArtifactError:
        raise
    # h5py and nir raise exceptions of many types for a damaged file
    except Exception as error:
        raise ArtifactError(
            f"cannot be read as a NIR graph: {type(error).__name__}: {error}. The file is "
            "truncated, damaged or of another format; copy or export it again."
        ) from error


def _check_heaps(path: Path) -> None:
    """Raise ArtifactError where a global heap, in which texts lie, is damaged.

    A heap collection is "GCOL", a version, three bytes, and its size in 8 bytes; then objects: an
    index, a reference count, four bytes and a size in 8 bytes, followed by that many bytes up to a
    multiple of 8. The object of index 0 is the free space after the others, its header included
    (HDF5 File Format Specification 3.0, section III.E).
    """
    content = path.read_bytes()
    at = content.find(_HEAP_SIGNATURE)
    while at >= 0:
        if not _ends(content, at):
            raise ArtifactError(
                f"cannot be read as a NIR graph: its texts, at byte {at}, are damaged. Copy the "
                "file or export it again."
            )
        at = content.find(_HEAP_SIGNATURE, at + 1)


def _ends(content: bytes, at: int) -> bool:
    """Whether the heap collection at this byte has an end."""
    size = _number(content, at + 8, 8)
    here, end = at + _HEAP_HEADER, at + size
    while end - here >= _HEAP_HEADER:
        index, length = _number(content, here, 2), _number(content, here + 8, 8)
        # the size of free space includes its header
        step = length if index == 0 else _HEAP_HEADER + (length + 7) // 8 * 8
        if step < _HEAP_HEADER:
            return False
        here += step
    return True


def _number(content: bytes, at: int, width: int) -> int:
    return int.from_bytes(content[at : at + width], "little")


def _check_container(file: h5py.File, path: Path) -> None:
    """Raise ArtifactError where links leave the file or form a circle, or sizes are impossible."""
    sizes: dict[str, int] = {}
    for name, dataset in _datasets(file):
        _check_type(name, dataset)
        sizes[name] = _size(name, dataset)
        if dataset.dtype.kind == "O":
            _check_texts(name, dataset, path)
    if sum(sizes.values()) > _MAX_PARAMETER_BYTES:
        largest = max(sizes, key=lambda name: sizes[name])
        raise ArtifactError(
            f"{largest} is {sizes[largest]} bytes; all parameters together may be "
            f"{_MAX_PARAMETER_BYTES}. The file is damaged, or the network too large for one "
            "machine: divide it."
        )


def _datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Every array by its path; each group is visited once."""
    waiting, seen, count = [("", file["/"], 0)], {_address(file["/"])}, 0
    while waiting:
        path, group, depth = waiting.pop()
        for key in group:
            name, count = f"{path}{key}", count + 1
            member = _linked(group, key, name)
            if isinstance(member, h5py.Dataset):
                yield name, member
            elif isinstance(member, h5py.Group):
                _check_group(name, depth, count, _address(member) in seen)
                seen.add(_address(member))
                waiting.append((f"{name}/", member, depth + 1))


def _linked(group: h5py.Group, key: str, name: str) -> object:
    """The member of a group by its name; ArtifactError where it is only a link to elsewhere."""
    kind = group.get(key, getclass=True, getlink=True)
    if kind is not h5py.HardLink:
        raise ArtifactError(
            f"{name[:60]} is a {kind.__name__} to somewhere else; a NIR file may hold only "
            "hard links. Replace it by a copy of its target."
        )
    return group[key]


def _check_group(name: str, depth: int, count: int, known: bool) -> None:
    if known:
        raise ArtifactError(
            f"{name[:60]} is a group that is there under another name too, so that reading might "
            "never end. Export the network again."
        )
    if depth >= _MAX_DEPTH or count > _MAX_LINKS:
        raise ArtifactError(
            f"{name[:60]}… is deeper than {_MAX_DEPTH} groups, or comes after {_MAX_LINKS} other "
            "links. Flatten the graph in the tool that wrote it, or divide it."
        )


def _check_type(name: str, dataset: h5py.Dataset) -> None:
    """Refuse other types than numbers and texts; HDF5 can crash on reading a damaged type."""
    kind = dataset.dtype.kind
    if kind == "V" or (kind == "O" and h5py.check_string_dtype(dataset.dtype) is None):
        raise ArtifactError(
            f"{name} holds neither numbers nor texts; NIR has nothing else. The file is "
            "damaged; copy or export it again."
        )


def _size(name: str, dataset: h5py.Dataset) -> int:
    """Bytes of an array; ArtifactError where the file stores too few for it."""
    if dataset.external or dataset.is_virtual:
        raise ArtifactError(
            f"{name} has its numbers in another file; a NIR file must hold all of them. Write "
            "them into it."
        )
    size = int(dataset.nbytes)
    if size > _FREE_BYTES + _MAX_EXPANSION * dataset.id.get_storage_size():
        raise ArtifactError(
            f"{name} is {size} bytes, for which too few are in the file. It is damaged; copy or "
            "export it again."
        )
    return size


def _address(group: h5py.Group) -> tuple[int, int]:
    info = h5py.h5o.get_info(group.id)
    return int(info.fileno), int(info.addr)


def _check_texts(name: str, texts: h5py.Dataset, path: Path) -> None:
    """Refuse texts longer than the file: HDF5 would reserve the memory before it reads.

    Each is stored as its length in 4 bytes, then 12 bytes of its place in a heap.
    """
    if (offset := texts.id.get_offset()) is None:
        return
    with path.open("rb") as file:
        file.seek(offset)
        lengths = np.frombuffer(file.read(16 * int(texts.size)).ljust(16, b"\0"), "<u4")
    if lengths[::4].size and lengths[::4].max() > path.stat().st_size:
        raise ArtifactError(
            f"{name} holds a text of {lengths[::4].max()} bytes, more than the file. It is "
            "damaged; copy or export it again."
        )


def _graph(tree: Mapping[str, Any], path: str) -> nir.NIRGraph:
    unknown = sorted(set(tree) - {"type", "nodes", "edges", "metadata"})
    if unknown:
        raise ArtifactError(
            f"graph{f' {path[:-1]!r}' if path else ''} has the unknown field {unknown[0]!r}; NIR "
            f"knows nodes, edges and metadata. {_REMEDY}"
        )
    nodes = {name: _node(node, f"{path}{name}") for name, node in tree["nodes"].items()}
    edges = [(_text(source), _text(target)) for source, target in tree["edges"]]
    metadata = dict(tree.get("metadata", {}))
    return nir.NIRGraph(nodes, edges, metadata=metadata, type_check=False)


def _node(tree: object, path: str) -> nir.NIRNode:
    if not isinstance(tree, Mapping) or not isinstance(tree.get("type"), str):
        inner = f"{path}/{next(iter(tree))}" if isinstance(tree, Mapping) and tree else path
        raise ArtifactError(
            f"node {path!r} has no type. If it was called {inner!r}: HDF5 splits names at '/', so "
            "that such a name cannot be read back. Rename the node in the tool that wrote it."
        )
    kind = tree["type"]
    if kind == "NIRGraph":
        return _graph(tree, f"{path}.")
    if not isinstance(getattr(nir, kind, None), type):
        raise ArtifactError(
            f"node {path!r}: {kind[:40]!r} is no primitive of NIR. Use one, or update `nir` if the "
            "primitive is newer."
        )
    try:
        return nir.dict2NIRNode(dict(tree))
    # each primitive has its own exceptions, and most name neither node nor field
    except Exception as error:
        raise ArtifactError(
            f"node {path!r}: no {kind} can be made of {_shapes(tree)}: {error or 'nir refuses'}. "
            f"{_REMEDY}"
        ) from error


def _shapes(tree: Mapping[str, Any]) -> str:
    fields = {
        name: value for name, value in sorted(tree.items()) if name not in ("type", "metadata")
    }
    return ", ".join(f"{name} {np.shape(value)}" for name, value in fields.items()) or "nothing"


def _text(name: object) -> str:
    return name.decode() if isinstance(name, bytes) else str(name)
