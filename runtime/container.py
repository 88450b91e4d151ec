"""The HDF5 container of a NIR file: what must be true of its tree before anything in it is read.

HDF5 can link groups in circles, keep numbers in other files, and claim arrays that no memory holds.
NIR needs none of that.
"""

from collections.abc import Iterator
from pathlib import Path

import h5py

from runtime.errors import ArtifactError
from runtime.heap import check_texts

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
