"""Events of cameras: their type, and the HDF5 file that recordings are written to."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import replacing

if TYPE_CHECKING:
    import h5py

# an event: column x and row y [pixels], both from the upper left; time t [us]; polarity p, 1 where
# the light rose and 0 where it fell
EVENT = np.dtype([("x", "<u2"), ("y", "<u2"), ("t", "<i8"), ("p", "u1")])
Events = NDArray[np.void]

MOST_PIXELS = 1 << 16  # along an axis, as x and y have 16 bits
_CHUNK = 1 << 15  # events that HDF5 compresses together
_MARK = "written by an event camera of spikedeploy"


class EventWriter:
    """An HDF5 file of events that grows: `events/x`, `y`, `t` and `p`, and the camera's size.

    The datasets are those of DSEC (Gehrig et al. 2021) without its offset of time: x and y in
    uint16, t in int64 [us], p in uint8, 0 or 1. The group has the attributes height and width
    [pixels]. Use `write_events`, which puts the file in its place when all of it is there.
    """

    def __init__(self, file: "h5py.File", size: tuple[int, int], remark: str = "") -> None:
        if not all(0 < each <= MOST_PIXELS for each in size):
            raise ConfigError(
                f"a camera of {size[0]}x{size[1]} pixels (height x width) cannot be: give 1 to "
                f"{MOST_PIXELS} along each axis."
            )
        self.size = size
        self._last = 0
        group = file.create_group("events")
        group.attrs["height"], group.attrs["width"] = size
        if remark:
            file.attrs["remark"] = remark
        options: dict[str, Any] = {"maxshape": (None,), "chunks": (_CHUNK,), "compression": "lzf"}
        self._columns = {
            name: group.create_dataset(name, (0,), EVENT[name], **options)
            for name in EVENT.names or ()
        }

    def write(self, events: Events) -> None:
        """Append events (E,) of type EVENT, in the order of time; ConfigError for any others."""
        if not len(events):
            return
        height, width = self.size
        before = np.concatenate([[self._last], events["t"][:-1]])
        wrong = (events["t"] < before) | (events["x"] >= width) | (events["y"] >= height)
        if wrong.any():
            at = int(np.argmax(wrong))
            x, y, t, _ = events[at].tolist()
            raise ConfigError(
                f"event {at} at x = {x}, y = {y}, t = {t} us cannot be recorded: events of a "
                f"camera of {height}x{width} pixels (height x width) come in the order of time, "
                f"and the one ahead was at {before[at]} us. Sort them, or correct the size."
            )
        self._last = int(events["t"][-1])
        for name, column in self._columns.items():
            first = len(column)
            column.resize(first + len(events), 0)
            column[first:] = events[name]


@contextmanager
def write_events(path: Path, size: tuple[int, int], remark: str = "") -> Iterator[EventWriter]:
    """Yield the writer of a recording, which is in its place at the end of the block.

    A file that is there is replaced if an event camera here wrote it; else ConfigError. Where one
    appears meanwhile, the recording is kept beside it.

    size: (height, width) of the camera [pixels].
    remark: a text that the file shall hold.
    """
    import h5py  # as packages load without it

    foreign = f"{path} exists, and no event camera here recorded it"
    if path.exists() and not _is_ours(path):
        raise ConfigError(f"{foreign}: name another file, or move it away.")
    with replacing(path) as part:
        with h5py.File(part, "w") as file:
            file.attrs["by"] = _MARK
            yield EventWriter(file, size, remark)
        if path.exists() and not _is_ours(path):
            kept = part.rename(part.with_name(f"{path.stem}-{os.getpid()}{path.suffix}"))
            raise ConfigError(f"{foreign}: the recording is {kept}.")


def _is_ours(path: Path) -> bool:
    """Return True if an existing file is a recording of `write_events`."""
    import h5py

    try:
        with h5py.File(path) as file:
            by = file.attrs.get("by")
    except (OSError, KeyError, ValueError):  # none, a damaged one, or one that is being written
        return False
    return isinstance(by, str) and by == _MARK
