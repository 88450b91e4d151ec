"""A recording of an event camera as a stream of events that were checked, whatever its format."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.camera_events import EVENT, MOST_PIXELS, Events
from spikedeploy.runtime.errors import ObservationError

Size: TypeAlias = tuple[int, int]
Columns: TypeAlias = tuple[NDArray[Any], ...]  # x, y, t and p of some events, as stored
Parts: TypeAlias = Callable[[], Iterator[Columns]]

PART = 1 << 16  # events that are read at once
# names of columns, as NumPy, Tonic, faery, event_stream, ESIM and ROS have them
_NAMES = {
    "x": ("x", "xs"),
    "y": ("y", "ys"),
    "t": ("t", "ts", "timestamp"),
    "p": ("p", "ps", "pol", "on", "polarity"),
}
_CODINGS = ({0, 1}, {-1, 1})  # polarities of falling and of rising light
# [us] after which a counter of 32 bits begins anew, and by how much it then falls at least, unless
# the camera was silent for nine minutes
_WRAP, _FALL = 1 << 32, 7 << 29
_COARSEST = 1e-5  # [s] between numbers that a float type can hold where times are


def named_columns(names: Iterable[str]) -> dict[str, str]:
    """Return the names in a file by x, y, t and p, as far as they are there."""
    there = set(names)
    found = {key: next((n for n in known if n in there), "") for key, known in _NAMES.items()}
    return {key: name for key, name in found.items() if name}


@dataclass(frozen=True)
class Recording:
    """A file of events, which is read as often as wanted.

    path: path of the file.
    size: (height, width) of the camera [pixels]; None where nothing says it.
    parts: reads columns x, y, t and p one part after another. Times are microseconds in whole
        numbers, of which those of 32 bits may wrap, or seconds in floats.
    offset: time that is added to all [us].
    remarks: sentences on how the file is read, where that is not plain.
    """

    path: Path
    size: Size | None
    parts: Parts
    offset: int = 0
    remarks: tuple[str, ...] = ()

    def events(self) -> Iterator[Events]:
        """Events (E,) in the order of time, part by part; ObservationError where any is none."""
        count, wraps, last, stored = 0, 0, 0, 0
        polarities = set[float]()
        for x, y, t, p in self._parts():
            if t.dtype.kind == "f":
                us = _microseconds(self.path, t)
            elif t.dtype.itemsize == 4:
                us = t.astype(np.int64)
                falls = us - np.concatenate([[stored], us[:-1]]) < -_FALL
                wrapped = wraps + np.cumsum(falls)
                stored, wraps = int(us[-1]), int(wrapped[-1])
                us = us + _WRAP * wrapped
            else:
                us = t.astype(np.int64)
            events = np.empty(len(us), EVENT)
            us = us + self.offset
            self._check(count, x, y, us, last)
            polarities |= set(np.unique(p).tolist())
            if not any(polarities <= coding for coding in _CODINGS):
                shown = ", ".join(f"{each:.10g}" for each in sorted(polarities)[:6])
                raise ObservationError(
                    f"{self.path} has the polarities {shown}; known are 0 where the light fell and "
                    "1 where it rose, or -1 and 1. Write them so."
                )
            events["x"], events["y"], events["t"], events["p"] = x, y, us, p > 0
            count, last = count + len(us), int(us[-1])
            yield events

    def _parts(self) -> Iterator[Columns]:
        """Parts that hold events, as columns of numbers; ObservationError where there are none."""
        try:
            for part in self.parts():
                numbers = all(each.ndim == 1 and each.dtype.kind in "biuf" for each in part)
                if not numbers or len({len(each) for each in part}) > 1:
                    pairs = zip("xytp", part, strict=True)
                    shown = ", ".join(f"{name} {each.dtype} {each.shape}" for name, each in pairs)
                    raise ObservationError(
                        f"{self.path} holds {shown}; x, y, t and p must be columns of numbers, of "
                        "one length. Cut all to the shortest, if the recording is truncated."
                    )
                if len(part[0]):
                    yield part
        except (ObservationError, ModuleNotFoundError):
            raise
        # h5py and faery raise exceptions of many types for a damaged file
        except Exception as error:
            raise damaged(self.path, error) from error

    def _check(
        self, count: int, x: NDArray[Any], y: NDArray[Any], us: NDArray[np.int64], last: int
    ) -> None:
        """Refuse events between or outside the pixels, or out of the order of time.

        count, last: number of the events before, and time of the last of them [us].
        """
        height, width = self.size or (MOST_PIXELS, MOST_PIXELS)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        inside &= (x == np.rint(x)) & (y == np.rint(y))
        if not inside.all():
            at = int(np.argmin(inside))
            raise ObservationError(
                f"{self.path}: event {count + at} is at x = {x[at]:g}, y = {y[at]:g}; the camera "
                f"has {height}x{width} whole pixels (height x width). Correct the event, or the "
                "size: in the file, or where that has none with --camera HxW."
            )
        before = np.concatenate([[last], us[:-1]])
        if (us < before).any():
            at = int(np.argmax(us < before))
            raise ObservationError(
                f"{self.path}: event {count + at} is at t = {us[at]} us, before t = {before[at]} "
                "us of the one ahead of it; times count from 0. Sort the events by time, and write "
                "them anew."
            )


def _microseconds(path: Path, seconds: NDArray[Any]) -> NDArray[np.int64]:
    """Times [us] of times [s]; ObservationError where they cannot be seconds, or are too coarse."""
    if not np.isfinite(seconds).all():
        raise ObservationError(f"{path} has an event at no time. Correct the events.")
    latest, step = seconds.max(), float(np.spacing(np.abs(seconds).max()))
    is_whole = latest > seconds.min() and (seconds == np.rint(seconds)).all()
    if is_whole or step > _COARSEST:
        why = "all of them whole" if is_whole else f"which has one number each {step:.3g} s there"
        raise ObservationError(
            f"{path} holds times of up to {latest:.10g} in {seconds.dtype}, {why}; times in floats "
            "are seconds. Write them in microseconds, as whole numbers."
        )
    return np.rint(seconds.astype(np.float64) * 1e6).astype(np.int64)


def damaged(path: Path, error: Exception) -> ObservationError:
    """Return the error of a file that a library could not read."""
    return ObservationError(
        f"{path} cannot be read to its end as {path.suffix or 'a recording'}: "
        f"{str(error).strip().rstrip('.') or type(error).__name__}. The file is truncated, damaged "
        "or of another format; copy or convert it again."
    )
