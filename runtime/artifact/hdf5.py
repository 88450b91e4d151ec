"""The HDF5 container of a NIR file: written for a release of `nir`, and read without trusting it.

`nir.read` checks inner graphs when told not to, and does not say which node it cannot make. So the
container is checked before anything in it is read (hdf5_limits), and the graph is read node by
node.

What a HDF5 file may hold, and what it may unpack to, before anything in it is read.

HDF5 can link groups in circles, keep numbers in other files, claim arrays that no memory holds,
unpack a thousand zeros from a byte, and read a damaged heap of texts without end.
"""

import math
import mmap
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import h5py
import nir
import numpy as np
from nir.serialization import hdf2dict

from spikedeploy.runtime.errors import ArtifactError

# releases that refuse the field v_reset; then all that files were opened with
_WITHOUT_V_RESET = ("1.0.4", "1.0.5")
RELEASES = ("1.0.1", "1.0.3", *_WITHOUT_V_RESET, "1.0.6", "1.0.7", "1.0.8")
_REMEDY = "Export the network again, or correct the node."


def write_graph(path: Path, graph: nir.NIRGraph, older: str | None = None) -> None:
    """Write a file that a release of `nir` opens; ArtifactError where it has no such network."""
    if older is not None and older not in RELEASES:
        raise ArtifactError(f"nir {older} was not tried. Choose one of {', '.join(RELEASES)}.")
    nir.write(path, graph)
    if older not in _WITHOUT_V_RESET:
        return
    with h5py.File(path, "r+") as file:
        for name, node in file["node/nodes"].items():
            if "v_reset" not in node:
                continue
            if np.any(node["v_reset"][()]):
                raise ArtifactError(
                    f"node {name!r}: nir {older} has no v_reset, and it is not 0. Choose 1.0.6 or "
                    "later."
                )
            del node["v_reset"]


def read_graph(path: Path) -> nir.NIRGraph:
    """The graph in a HDF5 file, as written; ArtifactError where the file holds none.

    Whether the graph can be computed is for runtime.graph.validate to check.
    """
    try:
        longest = check_file(path)
        with h5py.File(path, "r") as file:
            check_container(file, path, longest)
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


# bytes of all parameters: a file with more is taken for a mistake that would exhaust the memory
_MAX_PARAMETER_BYTES = 1 << 31
# bytes that a file may unpack to for each that it takes on the disk, and besides those: numbers of
# trained networks hardly shrink, and what has 48 MiB of zeros is small
_MAX_EXPANSION = 8
_FREE_BYTES = 48 << 20
# arithmetic is done in float32 at least: smaller numbers grow when they are read
_SMALLEST_NUMBER = 4
# bytes of all texts, if each were as long as the longest
_MAX_TEXT_BYTES = 1 << 28
# nested groups (a graph inside a graph takes three), and links in all: a neuron has up to nine
_MAX_DEPTH = 64
_MAX_LINKS = 32_768
# "GCOL" with version and padding, so that no weight is mistaken for it
_HEAP_SIGNATURE = b"GCOL\x01\x00\x00\x00"
_HEAP_HEADER = 16  # [bytes]
_FILE_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# heap collections of a file of spikes, each of which is looked for in all of it; and their objects
_MAX_HEAPS = 256
_MAX_INDEX = 1 << 16
_HARMLESS = 1 << 26  # [bytes] that a claim may take for a moment


def check_file(path: Path, *, claims: bool = False) -> int:
    """Bytes of the longest text; ArtifactError where texts are damaged or the file is hollow.

    claims: whether to look at the lengths of texts that attributes claim, too.

    A heap collection is "GCOL", a version, three bytes, and its size in 8 bytes; then objects: an
    index, a reference count, four bytes and a size in 8 bytes, followed by that many bytes up to a
    multiple of 8. The object of index 0 is the free space after the others, its header included
    (HDF5 File Format Specification 3.0, section III.E).
    """
    size = path.stat().st_size
    if size > (most := _budget(path)):
        raise ArtifactError(
            f"the file is {size} bytes with holes, of which the disk holds too few; at most {most}."
            " It is damaged or not whole; copy or export it again."
        )
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        heaps = _found(content, _HEAP_SIGNATURE)
        longest = max((_longest_text(content, at) for at in heaps), default=0)
        if claims:
            _check_claims(content)
    return longest


def _check_claims(content: mmap.mmap) -> None:
    """Raise ArtifactError where an attribute claims a text that is far longer than the file.

    Where h5py does not show it, such a text is stored as its length in 4 bytes, the place of its
    heap collection in 8, and its index there in 4. HDF5 allocates the length, up to 4 GiB, before
    it looks into the heap. Where the place, too, is damaged, the claim is not found.
    """
    base, most = max(content.find(_FILE_SIGNATURE), 0), max(len(content), _HARMLESS)
    heaps = list(islice(_found(content, _HEAP_SIGNATURE, base), _MAX_HEAPS + 1))
    if len(heaps) > _MAX_HEAPS:
        raise ArtifactError(f"the file has more than {_MAX_HEAPS} heaps of texts. Write fewer.")
    for at in heaps:
        for place in _found(content, (at - base).to_bytes(8, "little")):
            length, index = _number(content, place - 4, 4), _number(content, place + 8, 4)
            if length > most and 0 < index < _MAX_INDEX:
                raise ArtifactError(
                    f"an attribute claims a text of {length} bytes, more than the file. It is "
                    "damaged; copy or export it again."
                )


def _found(content: mmap.mmap, wanted: bytes, start: int = 0) -> Iterator[int]:
    """Where the bytes begin, from `start` on."""
    at = content.find(wanted, start)
    while at >= 0:
        yield at
        at = content.find(wanted, at + 1)


def _budget(path: Path) -> int:
    """Bytes that a file may unpack to."""
    return budget(path, _FREE_BYTES, _MAX_EXPANSION)


def budget(path: Path, free: int, expansion: int) -> int:
    """Bytes that a file may unpack to: `free`, and more for each that it takes on the disk."""
    found = path.stat()
    # what a file claims beyond what the disk holds of it are holes
    stored = min(found.st_size, 512 * getattr(found, "st_blocks", found.st_size))
    return min(free + expansion * stored, _MAX_PARAMETER_BYTES)


def _longest_text(content: mmap.mmap, at: int) -> int:
    """Bytes of the longest object in the heap collection at this byte."""
    size, longest = _number(content, at + 8, 8), 0
    here, end = at + _HEAP_HEADER, min(at + size, len(content))
    while end - here >= _HEAP_HEADER:
        index, length = _number(content, here, 2), _number(content, here + 8, 8)
        # the size of free space includes its header
        step = length if index == 0 else _HEAP_HEADER + (length + 7) // 8 * 8
        if step < _HEAP_HEADER:
            raise ArtifactError(
                f"cannot be read as a NIR graph: its texts, at byte {at}, are damaged. Copy the "
                "file or export it again."
            )
        longest = max(longest, length if index else 0)
        here += step
    return longest


def _number(content: mmap.mmap, at: int, width: int) -> int:
    return int.from_bytes(content[at : at + width], "little")


def check_container(
    file: h5py.File, path: Path, longest_text: int, most: int | None = None
) -> None:
    """Raise ArtifactError where links leave the file or form a circle, or sizes are impossible.

    most: bytes that all arrays together may unpack to; by default those of a network.
    """
    sizes: dict[str, int] = {}
    for name, dataset in _datasets(file):
        _check_type(name, dataset)
        sizes[name] = _size(name, dataset)
        if dataset.dtype.kind == "O":
            _check_texts(name, dataset, path, longest_text)
    most = _budget(path) if most is None else most
    if sum(sizes.values()) > most:
        largest = max(sizes, key=lambda name: sizes[name])
        raise ArtifactError(
            f"{largest} is {sizes[largest]} bytes, for which too few are in the file: all arrays "
            f"together unpack to {sum(sizes.values())}, of a file of this size at most {most}. "
            "Copy or export it again if it is damaged, write it without compression if it is "
            "almost empty, else divide the network."
        )


def _datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Every array by its path; each group is visited once."""
    waiting, seen, count = [("", file["/"], 0)], {_address(file["/"])}, 0
    while waiting:
        path, group, depth = waiting.pop()
        count += len(group)
        _check_count(path, count)
        for key in group:
            name = f"{path}{key}"
            member = _linked(group, key, name)
            if isinstance(member, h5py.Dataset):
                yield name, member
            elif isinstance(member, h5py.Group):
                _check_group(name, depth, _address(member) in seen)
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


def _check_count(path: str, count: int) -> None:
    if count > _MAX_LINKS:
        raise ArtifactError(
            f"{path[:60]} brings the file to {count} arrays and groups; at most {_MAX_LINKS}. "
            "Write several neurons as one node, or divide the network."
        )


def _check_group(name: str, depth: int, known: bool) -> None:
    if known:
        raise ArtifactError(
            f"{name[:60]} is a group that is there under another name too, so that reading might "
            "never end. Export the network again."
        )
    if depth >= _MAX_DEPTH:
        raise ArtifactError(
            f"{name[:60]}… is deeper than {_MAX_DEPTH} groups. Flatten the graph in the tool that "
            "wrote it."
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
    """Bytes in memory of an array, or of one of its chunks, which is read as a whole."""
    if dataset.external or dataset.is_virtual:
        raise ArtifactError(
            f"{name} has its numbers in another file; a NIR file must hold all of them. Write "
            "them into it."
        )
    values = max(int(dataset.size or 0), math.prod(dataset.chunks or (0,)))
    return values * max(_SMALLEST_NUMBER, int(dataset.dtype.itemsize))


def _address(group: h5py.Group) -> tuple[int, int]:
    info = h5py.h5o.get_info(group.id)
    return int(info.fileno), int(info.addr)


def _check_texts(name: str, texts: h5py.Dataset, path: Path, longest: int) -> None:
    """Refuse texts longer than the file: HDF5 would reserve the memory before it reads.

    Each is stored as its length in 4 bytes, then 12 bytes of its place in a heap.
    """
    if (found := int(texts.size or 0) * longest) > _MAX_TEXT_BYTES:
        raise ArtifactError(
            f"{name} holds {texts.size} texts, and one in the file has {longest} bytes: up to "
            f"{found}; at most {_MAX_TEXT_BYTES}. Shorten the texts."
        )
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
