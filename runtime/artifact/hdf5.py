"""The HDF5 container of a NIR file: written for a release of `nir`, and read without trusting it.

`nir.read` checks inner graphs even when told not to, and does not name the node it cannot build. So
the container is checked before anything in it is read, and the graph is read node by node. HDF5 can
link groups in circles, keep numbers in other files, claim arrays that no memory holds, and unpack a
thousand zeros from a byte.
"""

import math
import mmap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import nir
import numpy as np
from nir.serialization import hdf2dict

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.shapes import ELEMENTWISE

# releases that refuse the field v_reset; then all that files were opened with
_WITHOUT_V_RESET = ("1.0.4", "1.0.5")
RELEASES = ("1.0.1", "1.0.3", *_WITHOUT_V_RESET, "1.0.6", "1.0.7", "1.0.8")
_REMEDY = "Export the network again, or correct the node."

# bytes of all arrays: a file with more is taken for a mistake that would exhaust the memory
_MAX_BYTES = 1 << 31
# bytes that a file may unpack to, and more for each that it takes on the disk: numbers of trained
# networks hardly shrink; zeros between the legs of a whole body, and of what was pruned, do
_FREE_BYTES, _EXPANSION = 96 << 20, 8
# arithmetic is done in float32 at least: smaller numbers grow when they are read
_SMALLEST_NUMBER = 4
# arrays and groups; a neuron has up to nine
_MAX_MEMBERS = 32_768


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
    """Read the graph in an HDF5 file as written; ArtifactError where the file holds none.

    Whether the graph can be computed is for runtime.graph.validate to check.
    """
    try:
        check_container(path, byte_budget(path, _FREE_BYTES, _EXPANSION))
        with h5py.File(path, "r") as file:
            if "node" not in file:
                found = ", ".join(list(file)[:8]) or "nothing"
                raise ArtifactError(
                    f"cannot be read as a NIR graph: it is HDF5 that holds {found}, not node. "
                    "Give the file of a network; recordings of cameras go to --events."
                )
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
        return nir.dict2NIRNode(_with_shapes(kind, tree))
    # each primitive has its own exceptions, and most name neither node nor field
    except Exception as error:
        fields = {n: np.shape(value) for n, value in sorted(tree.items()) if n != "type"}
        shapes = ", ".join(f"{n} {shape}" for n, shape in fields.items() if n != "metadata")
        raise ArtifactError(
            f"node {path!r}: no {kind} can be made of {shapes or 'nothing'}: "
            f"{error or 'nir refuses'}. {_REMEDY}"
        ) from error


def _with_shapes(kind: str, tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a node, expanding those with one number for all values.

    Tools write the parameters of neurons as one number, or some of them.
    """
    fields = dict(tree)
    if not issubclass(getattr(nir, kind), ELEMENTWISE):
        return fields
    numbers = {
        name: np.atleast_1d(value)
        for name, value in fields.items()
        if isinstance(value, (np.ndarray, np.number)) and value.dtype.kind in "fiu"
    }
    largest = max((each.shape for each in numbers.values()), key=math.prod, default=())
    for name, each in numbers.items():
        fields[name] = np.full(largest, each.ravel()[0]) if each.size == 1 else each
    return fields


def _text(name: object) -> str:
    return name.decode() if isinstance(name, bytes) else str(name)


def byte_budget(path: Path, free: int, expansion: int) -> int:
    """Bytes that a file may unpack to: `free`, and more for each that it takes on the disk."""
    found = path.stat()
    # what a file claims beyond what the disk holds of it are holes
    stored = min(found.st_size, 512 * getattr(found, "st_blocks", found.st_size))
    return min(free + expansion * stored, _MAX_BYTES)


def check_container(path: Path, budget: int) -> None:
    """Raise ArtifactError where links leave the file or form a circle, or arrays are too large.

    budget: bytes that all arrays together may unpack to.
    """
    _check_heaps(path)
    with h5py.File(path, "r") as file:
        sizes = {name: _declared_bytes(name, array) for name, array in _arrays(file)}
    if (found := sum(sizes.values())) > budget:
        largest = max(sizes, key=lambda name: sizes[name])
        raise ArtifactError(
            f"{largest} is {sizes[largest]} bytes, for which too few are in the file: all arrays "
            f"together unpack to {found}, of a file of this size at most {budget}. Copy or export "
            "it again if it is damaged, write it without compression if it is almost empty, else "
            "divide the network."
        )


def _arrays(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Every array by its path; ArtifactError at links to elsewhere, circles, and too many."""
    waiting, seen, count = [("", file["/"])], {_address(file["/"])}, 0
    while waiting:
        path, group = waiting.pop()
        if (count := count + len(group)) > _MAX_MEMBERS:
            raise ArtifactError(
                f"{path[:60]} brings the file to {count} arrays and groups; at most "
                f"{_MAX_MEMBERS}. Write several neurons as one node, or divide the network."
            )
        for key in group:
            name, kind = f"{path}{key}", group.get(key, getclass=True, getlink=True)
            if kind is not h5py.HardLink:
                raise ArtifactError(
                    f"{name[:60]} is a {kind.__name__} to somewhere else; a NIR file may hold only "
                    "hard links. Replace it by a copy of its target."
                )
            member = group[key]
            if isinstance(member, h5py.Dataset):
                yield name, member
            elif isinstance(member, h5py.Group):
                if (address := _address(member)) in seen:
                    raise ArtifactError(
                        f"{name[:60]} is a group that is there under another name too, so that "
                        "reading might never end. Export the network again."
                    )
                seen.add(address)
                waiting.append((f"{name}/", member))


def open_member(file: h5py.File, place: str) -> h5py.Dataset:
    """The dataset at a path; ArtifactError where any of its numbers are in another file.

    Only what is on the path is looked at.
    """
    parts = place.split("/")
    for k in range(len(parts)):
        name = "/".join(parts[: k + 1])
        if isinstance(file.get(name, getlink=True), h5py.ExternalLink):
            raise ArtifactError(f"{name} is a link to another file. Replace it by its target.")
    found = file[place]
    if not isinstance(found, h5py.Dataset):
        raise ArtifactError(f"{place} is no array. Write it as one.")
    if found.external or found.is_virtual:
        raise ArtifactError(f"{place} has its numbers in another file. Write them into it.")
    return found


def _address(group: h5py.Group) -> tuple[int, int]:
    info = h5py.h5o.get_info(group.id)
    return int(info.fileno), int(info.addr)


def _declared_bytes(name: str, array: h5py.Dataset) -> int:
    """Bytes in memory of an array, or of one of its chunks, which is read as a whole."""
    kind = array.dtype.kind
    # HDF5 can crash on reading a damaged type
    if kind == "V" or (kind == "O" and h5py.check_string_dtype(array.dtype) is None):
        fields = f" but the fields {', '.join(names)}" if (names := array.dtype.names) else ""
        raise ArtifactError(
            f"{name} holds neither numbers nor texts{fields}; NIR has nothing else. Give the file "
            "of a network; recordings of cameras go to --events."
        )
    if array.external or array.is_virtual:
        raise ArtifactError(
            f"{name} has its numbers in another file; a NIR file must hold all of them. Write them "
            "into it."
        )
    values = max(int(array.size or 0), math.prod(array.chunks or (0,)))
    return values * max(_SMALLEST_NUMBER, int(array.dtype.itemsize))


def _check_heaps(path: Path) -> None:
    """Raise ArtifactError where a heap of texts is damaged, on which HDF5 can read without end.

    A heap is "GCOL", a version, three bytes, and its size in 8 bytes; then objects: an index, a
    reference count, four bytes and a size in 8 bytes, followed by that many bytes up to a multiple
    of 8. The object of index 0 is the free space after the others, its header of 16 bytes included
    (HDF5 File Format Specification 3.0, section III.E).
    """
    heap = b"GCOL\x01\x00\x00\x00"
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        at = content.find(heap)
        while at >= 0:
            here = at + 16
            end = min(at + int.from_bytes(content[at + 8 : here], "little"), len(content))
            while end - here >= 16:
                index = int.from_bytes(content[here : here + 2], "little")
                length = int.from_bytes(content[here + 8 : here + 16], "little")
                step = 16 + (length + 7) // 8 * 8 if index else length
                if step < 16:
                    raise ArtifactError(
                        f"its texts, at byte {at}, are damaged. Copy the file or export it again."
                    )
                here += step
            at = content.find(heap, at + 1)
