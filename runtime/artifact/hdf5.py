"""The HDF5 container of a NIR file: what must be true of its tree before anything in it is read.

HDF5 can link groups in circles, keep numbers in other files, and claim arrays that no memory holds.
NIR needs none of that.

The global heaps of a HDF5 file, where its texts lie; a damaged one can make HDF5 read for ever.

A collection is "GCOL", a version, three bytes, and its size in 8 bytes; then objects, each an
index, a reference count, four bytes and a size in 8 bytes, followed by that many bytes up to a
multiple of 8. The object of index 0 is the free space behind the others, its header included
(HDF5 File Format Specification 3.0, section III.E).

Reading a NIR file node by node, so that what cannot be read has a name.

`nir.read` checks the shapes of inner graphs even when it is told not to, and says of a node that
cannot be made only that it cannot.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import nir
import numpy as np
from nir.serialization import hdf2dict

from spikedeploy.runtime.errors import ArtifactError

# with the version and its three bytes, so that no weight looks like it
SIGNATURE = b"GCOL\x01\x00\x00\x00"
HEADER = 16


def check_heaps(path: Path) -> None:
    """Refuse a file with a heap that does not end."""
    content = path.read_bytes()
    at = content.find(SIGNATURE)
    while at >= 0:
        if not _ends(content, at):
            raise ArtifactError(
                f"cannot be read as a NIR graph: its texts, at byte {at}, are damaged. Copy the "
                "file or export it again."
            )
        at = content.find(SIGNATURE, at + 1)


def check_texts(name: str, texts: h5py.Dataset, path: Path) -> None:
    """Refuse texts that say they are longer than the file: HDF5 would reserve the memory first.

    Each is kept as its length in 4 bytes, then 12 bytes that say where.
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


def _ends(content: bytes, at: int) -> bool:
    """Whether walking the collection at this place comes to its end."""
    size = _number(content, at + 8, 8)
    here, end = at + HEADER, at + size
    while end - here >= HEADER:
        index, length = _number(content, here, 2), _number(content, here + 8, 8)
        # the header of free space is part of it
        step = length if index == 0 else HEADER + (length + 7) // 8 * 8
        if step < HEADER:
            return False
        here += step
    return True


def _number(content: bytes, at: int, width: int) -> int:
    return int.from_bytes(content[at : at + width], "little")


# bytes of parameters beyond which a file is a mistake, and would only exhaust the memory
LARGEST = 1 << 31
# and what a stored byte can become: deflate packs 1032 zeros into it
PACKED = 1100
FREE = 1 << 20
# groups in groups, and things in all: a graph inside a graph is three groups deeper
DEEPEST = 64
MOST = 100_000


def check_container(file: h5py.File, path: Path) -> None:
    """Refuse links that lead out or round, arrays kept elsewhere, and sizes that cannot be."""
    sizes = {"nothing": 0}
    for name, dataset in _datasets(file):
        _check_type(name, dataset)
        sizes[name] = _size(name, dataset)
        if dataset.dtype.kind == "O":
            check_texts(name, dataset, path)
    if sum(sizes.values()) > LARGEST:
        largest = max(sizes, key=lambda name: sizes[name])
        raise ArtifactError(
            f"{largest} is {sizes[largest]} bytes; all parameters together may be {LARGEST}. The "
            "file is damaged, or the network too large for one machine: divide it."
        )


def _datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Every array by its path, each group walked once."""
    waiting, seen, count = [("", file["/"], 0)], {_address(file["/"])}, 0
    while waiting:
        path, group, depth = waiting.pop()
        for key in group:
            name, count = f"{path}{key}", count + 1
            thing = _linked(group, key, name)
            if isinstance(thing, h5py.Dataset):
                yield name, thing
            elif isinstance(thing, h5py.Group):
                _check_group(name, depth, count, _address(thing) in seen)
                seen.add(_address(thing))
                waiting.append((f"{name}/", thing, depth + 1))


def _linked(group: h5py.Group, key: str, name: str) -> object:
    """What a name in a group stands for, if it is in the group itself."""
    kind = group.get(key, getclass=True, getlink=True)
    if kind is not h5py.HardLink:
        raise ArtifactError(
            f"{name[:60]} is a {kind.__name__} to somewhere else; NIR keeps everything in its "
            "place. Copy what it means to where it is."
        )
    return group[key]


def _check_group(name: str, depth: int, count: int, known: bool) -> None:
    if known:
        raise ArtifactError(
            f"{name[:60]} is a group that is there under another name too, so that reading might "
            "never end. Export the network again."
        )
    if depth >= DEEPEST or count > MOST:
        raise ArtifactError(
            f"{name[:60]}… is deeper than {DEEPEST} groups, or comes after {MOST} others. Flatten "
            "the graph in the tool that wrote it, or divide it."
        )


def _check_type(name: str, dataset: h5py.Dataset) -> None:
    """Refuse what is neither numbers nor texts; a damaged type can crash HDF5 while it reads."""
    kind = dataset.dtype.kind
    if kind == "V" or (kind == "O" and h5py.check_string_dtype(dataset.dtype) is None):
        raise ArtifactError(
            f"{name} holds neither numbers nor texts, which is all that NIR has. It is damaged; "
            "copy or export it again."
        )


def _size(name: str, dataset: h5py.Dataset) -> int:
    """Bytes of an array, which are not many more than those that are stored."""
    if dataset.external or dataset.is_virtual:
        raise ArtifactError(
            f"{name} has its numbers in another file; a NIR file is all that there is. Write them "
            "into it."
        )
    size = int(dataset.nbytes)
    if size > FREE + PACKED * dataset.id.get_storage_size():
        raise ArtifactError(
            f"{name} is {size} bytes, for which too few are in the file. It is damaged; copy or "
            "export it again."
        )
    return size


def _address(group: h5py.Group) -> tuple[int, int]:
    info = h5py.h5o.get_info(group.id)
    return int(info.fileno), int(info.addr)


REMEDY = "Export the network again, or correct the node."


def read_graph(path: Path) -> nir.NIRGraph:
    """The graph in a HDF5 file, as it is written there; nothing is checked but that it is one."""
    check_heaps(path)
    try:
        with h5py.File(path, "r") as file:
            check_container(file, path)
            tree = hdf2dict(file["node"])
        if tree["type"] != "NIRGraph":
            raise ValueError(f"it holds a single {tree['type']} and no graph")
        return _graph(tree, "")
    except ArtifactError:
        raise
    # h5py and nir raise nearly anything when a file is not what they expect
    except Exception as error:
        raise ArtifactError(
            f"cannot be read as a NIR graph: {type(error).__name__}: {error}. The file is "
            "truncated, damaged or something else; copy or export it again."
        ) from error


def _graph(tree: Mapping[str, Any], path: str) -> nir.NIRGraph:
    unknown = sorted(set(tree) - {"type", "nodes", "edges", "metadata"})
    if unknown:
        raise ArtifactError(
            f"graph{f' {path[:-1]!r}' if path else ''} has the unknown field {unknown[0]!r}; NIR "
            f"knows nodes, edges and metadata. {REMEDY}"
        )
    nodes = {name: _node(node, f"{path}{name}") for name, node in tree["nodes"].items()}
    edges = [(_text(source), _text(target)) for source, target in tree["edges"]]
    metadata = dict(tree.get("metadata", {}))
    return nir.NIRGraph(nodes, edges, metadata=metadata, type_check=False)


def _node(tree: object, path: str) -> nir.NIRNode:
    if not isinstance(tree, Mapping) or not isinstance(tree.get("type"), str):
        inner = f"{path}/{next(iter(tree))}" if isinstance(tree, Mapping) and tree else path
        raise ArtifactError(
            f"node {path!r} has no type. If it was called {inner!r}: HDF5 takes a '/' apart, so "
            "that such a name cannot be read back. Rename the node in the tool that wrote it."
        )
    kind = tree["type"]
    if kind == "NIRGraph":
        return _graph(tree, f"{path}.")
    if not isinstance(getattr(nir, kind, None), type):
        raise ArtifactError(
            f"node {path!r}: {kind[:40]!r} is no primitive of NIR. Write it with those, or update "
            "`nir` if it is newer."
        )
    try:
        return nir.dict2NIRNode(dict(tree))
    # each kind has errors of its own, and most do not say which node or which field
    except Exception as error:
        raise ArtifactError(
            f"node {path!r}: no {kind} can be made of {_shapes(tree)}: {error or 'nir refuses'}. "
            f"{REMEDY}"
        ) from error


def _shapes(tree: Mapping[str, Any]) -> str:
    fields = {
        name: value for name, value in sorted(tree.items()) if name not in ("type", "metadata")
    }
    return ", ".join(f"{name} {np.shape(value)}" for name, value in fields.items()) or "nothing"


def _text(name: object) -> str:
    return name.decode() if isinstance(name, bytes) else str(name)
