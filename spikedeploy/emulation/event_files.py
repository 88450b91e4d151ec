"""Recordings of event cameras: files of several formats as one stream of checked events.

Structured arrays of NumPy are read here, HDF5 in `event_hdf5`; AEDAT 4, Prophesee's .raw (EVT 2,
2.1, 3) and .dat, and .es by faery. All are read in parts, so that memory does not grow with the
recording.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.event_columns import (
    PART,
    Columns,
    Polarity,
    Size,
    check_kinds,
    check_names,
    check_shapes,
    named_columns,
    whole_pixels,
    whole_times,
)
from spikedeploy.emulation.event_hdf5 import hdf5_recording
from spikedeploy.runtime.artifact.nir_data import is_nir_data
from spikedeploy.runtime.camera_events import EVENT, MOST_PIXELS, Events
from spikedeploy.runtime.errors import ObservationError
from spikedeploy.runtime.files import suffix

# by the ending of a file, in small letters, the type by which faery reads it
_FAERY = {".aedat4": "aedat", ".raw": "evt", ".dat": "dat", ".es": "es"}
KINDS = f"HDF5, NumPy structured arrays (.npy), {', '.join(_FAERY)}"
# [us] after which a counter of 32 bits begins anew, and by how much it then falls at least, unless
# the camera was silent for nine minutes
_WRAP, _FALL = 1 << 32, 7 << 29
# [us] from the end and from the beginning of such a counter, between which times fall that are
# stored in more bits
_NEAR = 1 << 26
# what a size of faery means that no header gave: .raw and .dat have at most 14 bits for x and y
_UNKNOWN = (1 << 14, 1 << 14)
_BEGAN_ANEW = (
    "times that fall by almost 2^32 us are read as a counter of 32 bits that began anew: they go on"
)
_SORT = "Sort the events by time and write them anew"


@dataclass(frozen=True)
class Recording:
    """A file of events, which is read as often as wanted.

    path: path of the file.
    size: (height, width) of the camera [pixels]; None where nothing says it.
    parts: reads x, y, t [us] and p of some events after another, unchecked.
    remarks: on how the file is read, where that is not plain; sentences. Reading it adds to them.
    counter: whether times are known to be a counter of 32 bits, however they are stored.
    """

    path: Path
    size: Size | None
    parts: Callable[[], Iterator[Columns]]
    remarks: list[str] = field(default_factory=list)
    counter: bool = False

    def events(self) -> Iterator[Events]:
        """Events (E,) in the order of time, part by part; ObservationError where any is none.

        A time of 32 bits that falls by almost 2**32 us is a counter that began anew: it goes on.
        """
        count, wraps, last, stored = 0, 0, 0, 0
        height, width = self.size or (MOST_PIXELS, MOST_PIXELS)
        polarity = Polarity(self.path)
        for x, y, t, p in self._parts():
            x, y = whole_pixels(self.path, "x", x), whole_pixels(self.path, "y", y)
            is_counter = self.counter or t.dtype.itemsize == 4
            t = whole_times(self.path, t)
            ahead = np.concatenate([[stored if count else t[0]], t[:-1]])
            falls = (t - ahead < -_FALL) & (t < _WRAP)
            if not is_counter:
                falls &= (ahead >= _WRAP - _NEAR) & (ahead < _WRAP) & (t < _NEAR)
            if falls.any():
                self._add_remark(_BEGAN_ANEW)
            offset = _WRAP * (wraps + np.cumsum(falls))
            found, wraps, stored = t + offset, int(offset[-1]) // _WRAP, int(t[-1])
            before = np.concatenate([[last if count else found[0]], found[:-1]])
            outside = (x < 0) | (x >= width) | (y < 0) | (y >= height)
            for wrong, refuse in ((outside, self._outside), (found < before, self._unordered)):
                if wrong.any():
                    at = int(np.argmax(wrong))
                    raise ObservationError(
                        f"{self.path}: event {count + at} "
                        + refuse(int(x[at]), int(y[at]), int(found[at]), int(before[at]))
                    )
            if not count and found[0] < 0:
                raise ObservationError(
                    f"{self.path}: event 0 is at t = {found[0]} us; times are counted from 0 on. "
                    "Add an offset to all of them."
                )
            events = np.empty(len(t), EVENT)
            events["x"], events["y"], events["t"] = x, y, found
            events["p"] = polarity.rising(p)
            count, last = count + len(t), int(found[-1])
            yield events

    def _add_remark(self, text: str) -> None:
        if text not in self.remarks:  # it is read more than once
            self.remarks.append(text)

    def _parts(self) -> Iterator[Columns]:
        """The parts that hold events; ObservationError where the file is damaged."""
        try:
            yield from (part for part in self.parts() if len(part[2]))
        except (ObservationError, ModuleNotFoundError):
            raise
        # h5py and faery raise exceptions of many types for a damaged file
        except Exception as error:
            raise _damaged(self.path, error) from error

    def _outside(self, x: int, y: int, _t: int, _before: int) -> str:
        height, width = self.size or (MOST_PIXELS, MOST_PIXELS)
        return (
            f"is at x = {x}, y = {y}; the camera has {height}x{width} pixels (height x width). "
            "Correct the event, or the size: in the file, or where that has none with --camera HxW."
        )

    def _unordered(self, _x: int, _y: int, t: int, before: int) -> str:
        return f"at t = {t} us comes {before - t} us before the one ahead of it. {_SORT}."


def open_recording(
    path: Path, camera: Size | None = None, fallback: Size | None = None
) -> Recording:
    """The recording in a file; ObservationError where its format is not known or it is damaged.

    camera: (height, width) [pixels]; must be what the file says, where it does.
    fallback: likewise, where neither file nor `camera` say it.
    """
    if not path.is_file():
        raise ObservationError(f"{path} is no file. Give a recording: {KINDS}.")
    form = suffix(path)
    found: Size | None = None
    remarks: tuple[str, ...] = ()
    try:
        if form == ".npy":
            parts = _numpy_parts(path)
        elif form in _FAERY:
            found, parts = _faery_parts(path, form)
        elif is_nir_data(path):
            found, parts, remarks = hdf5_recording(path, camera or fallback)
        else:
            raise ObservationError(f"{path} is no recording of events that is known: {KINDS}.")
    except (ObservationError, ModuleNotFoundError):
        raise
    except Exception as error:
        raise _damaged(path, error) from error
    if camera and found and camera != found:
        raise ObservationError(
            f"{path} says that its camera has {found[0]}x{found[1]} pixels (height x width), "
            f"--camera {camera[0]}x{camera[1]}. Leave --camera out."
        )
    return Recording(
        path, camera or found or fallback, parts, list(remarks), counter=form == ".dat"
    )


def _damaged(path: Path, error: Exception) -> ObservationError:
    return ObservationError(
        f"{path} cannot be read to its end as {path.suffix or 'a recording'}: "
        f"{str(error).strip().rstrip('.') or type(error).__name__}. The file is truncated, damaged "
        "or of another format; copy or convert it again."
    )


# NumPy


def _numpy_parts(path: Path) -> Callable[[], Iterator[Columns]]:
    # memory-mapped, which takes no memory; no objects are loaded, which could execute code
    array = np.lib.format.open_memmap(path, mode="r")
    names = array.dtype.names or ()
    fields, missing = named_columns(names)
    if missing:
        raise ObservationError(
            f"{path} holds {', '.join(names) or f'plain {array.dtype}'}; needed is a structured "
            f"array with the fields x, y, t [us] and p, and {missing[0]!r} is missing. Rasters go "
            "to --input."
        )
    check_names(path, names)
    check_kinds(path, [array.dtype[fields[name]] for name in "xytp"])
    check_shapes(path, [array.shape])

    def parts() -> Iterator[Columns]:
        for first in range(0, len(array), PART):
            rows = array[first : first + PART]
            yield tuple(np.asarray(rows[fields[name]]) for name in "xytp")

    return parts


# AEDAT 4, Prophesee


def _faery_parts(path: Path, form: str) -> tuple[Size | None, Callable[[], Iterator[Columns]]]:
    import faery

    with path.open("rb") as file:
        if form == ".raw" and file.read(1) != b"%":
            raise ObservationError(
                f"{path} has no header, which says whether its events are EVT 2, 2.1 or 3. Record "
                "it anew, or convert it with the tools of the camera."
            )

    def stream() -> faery.FiniteEventsStream:
        kind = _FAERY[form]
        return faery.events_stream_from_file(path, dimensions_fallback=_UNKNOWN, file_type=kind)

    width, height = stream().dimensions()
    size = None if (width, height) == _UNKNOWN else (height, width)

    def parts() -> Iterator[Columns]:
        if form == ".raw":
            _check_times_high(path)
        words, first, offset = _dat_words(path) if form == ".dat" else None, 0, 0
        # a stream is read once
        for events in stream():
            t, p = events["t"].astype(np.int64), events["p"]
            if words is not None:
                stored = words[first : first + len(t), 0].astype(np.int64)
                # of its four bits faery keeps whether there is one
                p = words[first : first + len(t), 1] >> 28
                # headers of faery hold the time of the first event
                offset = offset if first else int(t[0] - stored[0])
                t, first = stored + offset, first + len(t)
            yield events["x"], events["y"], t, p

    return size, parts


def _dat_words(path: Path) -> NDArray[np.uint32]:
    """Words (E, 2) of a .dat: time [us], then x, y and p in 14, 14 and 4 bits.

    The times are as they are stored; faery raises each that falls to the one ahead of it. Behind
    the header stand two bytes, then eight for each event.
    """
    place = len(_header(path)) + 2
    return np.memmap(path, "<u4", "r", place, ((path.stat().st_size - place) // 8, 2))


# by version of EVT: a word, the place of its type in it, and of the time where that is TIME_HIGH
_WORDS = {"2": ("<u4", 28, 0), "21": ("<u8", 60, 32), "3": ("<u2", 12, 0)}
_TIME_HIGH = 8


def _check_times_high(path: Path) -> None:
    """Refuse a .raw whose high bits of time fall, unless all begin anew; faery takes each for that.

    Words as in Prophesee's documentation, docs.prophesee.ai, Encoding Formats EVT 2.0, 2.1, 3.0.
    """
    header = _header(path)
    version = re.search(rb"% (?:evt |format EVT)(\d)\.?(1?)", header)
    known = _WORDS.get(b"".join(version.groups()).decode()) if version else None
    if known is None:
        return
    kind, of_type, of_time = known
    most = (1 << (of_type - of_time)) - 1
    width = np.dtype(kind).itemsize
    last = 0
    with path.open("rb") as file:
        file.seek(len(header))
        while part := file.read(width * PART):
            words = np.frombuffer(part[: len(part) // width * width], kind)
            high = (words[words >> of_type == _TIME_HIGH] >> of_time & most).astype(np.int64)
            falls = -np.diff(high, prepend=last)
            if ((falls > 0) & (falls < most // 8 * 7)).any():
                raise ObservationError(f"{path}: its times jump back. {_SORT}.")
            last = int(high[-1]) if len(high) else last


def _header(path: Path) -> bytes:
    """The lines that begin with "%", ahead of all others; of .raw to "% end"."""
    found = b""
    with path.open("rb") as file:
        while (line := file.readline(PART)).startswith(b"%") and line.endswith(b"\n"):
            found += line
            if line.strip() == b"% end":
                break
    return found
