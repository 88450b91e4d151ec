"""The global heaps of a HDF5 file, where its texts lie; a damaged one can make HDF5 read for ever.

A collection is "GCOL", a version, three bytes, and its size in 8 bytes; then objects, each an
index, a reference count, four bytes and a size in 8 bytes, followed by that many bytes up to a
multiple of 8. The object of index 0 is the free space behind the others, its header included
(HDF5 File Format Specification 3.0, section III.E).
"""

from pathlib import Path

import h5py
import numpy as np

from runtime.errors import ArtifactError

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
