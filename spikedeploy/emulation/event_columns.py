"""Columns of events as files hold them: which names they have, and what is checked of them."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ObservationError

Size: TypeAlias = tuple[int, int]
Columns: TypeAlias = tuple[NDArray[Any], ...]  # x, y, t [us] and p of some events

PART = 1 << 16  # events that are read at once
# names of columns, as NumPy, Tonic, faery, event_stream, ESIM and ROS have them
NAMES = {
    "x": ("x", "xs"),
    "y": ("y", "ys"),
    "t": ("t", "ts", "timestamp"),
    "p": ("p", "ps", "pol", "on", "polarity"),
}
# numbers of falling and of rising light
_CODINGS = ({0, 1}, {-1, 1})
_SHOWN = 6  # numbers of a wrong coding that are named
LATEST = 1 << 62  # [us], so that sums of two times are whole numbers of 64 bits
_COARSEST = 1e-5  # [s] between numbers that a type can hold where times are


def named_columns(names: Iterable[str]) -> tuple[dict[str, str], list[str]]:
    """The names by x, y, t and p, as far as they are there, and which of the four are missing."""
    there = set(names)
    found = {key: next((n for n in known if n in there), "") for key, known in NAMES.items()}
    return {key: name for key, name in found.items() if name}, [k for k in NAMES if not found[k]]


def check_names(path: Path, names: Iterable[str]) -> None:
    """Refuse two names for one column, of which the other would be left out unseen."""
    there = set(names)
    for key, known in NAMES.items():
        if len(found := [name for name in known if name in there]) > 1:
            raise ObservationError(
                f"{path} holds {' and '.join(found)}, each of which is a name for {key}; which of "
                "them is it? Leave the others out, or give them other names."
            )


def check_kinds(path: Path, kinds: Sequence[np.dtype[Any]], seconds: bool = False) -> None:
    """Refuse columns x, y, t, p that are no numbers, or times that are no whole microseconds.

    seconds: whether times are in seconds where they are no whole numbers.
    """
    whole = [kind.kind in "biu" for kind in kinds]
    real = [kind.kind in "biuf" for kind in kinds]
    if not all(real) or not (whole[2] or seconds):
        shown = ", ".join(f"{n} {kind}" for n, kind in zip("xytp", kinds, strict=True))
        raise ObservationError(
            f"{path} holds {shown}; x, y, t [us] and p must be whole numbers. Convert it: t in "
            "seconds times 1e6, rounded."
        )


def check_shapes(path: Path, shapes: Sequence[tuple[int, ...]]) -> None:
    """Refuse columns that differ in length."""
    if len(set(shapes)) != 1 or len(shapes[0]) != 1:
        shown = ", ".join(f"{n} {shape}" for n, shape in zip("xytp", shapes, strict=True))
        raise ObservationError(
            f"{path} holds {shown}, which must be columns of one length. The recording is "
            "truncated; cut all columns to the shortest."
        )


def whole_pixels(path: Path, name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Whole pixels; ObservationError where some lie between, as those of a rectified picture do."""
    if values.dtype.kind != "f":
        return values
    if not (np.isfinite(values) & (values == np.rint(values))).all():
        wrong = values[~(np.isfinite(values) & (values == np.rint(values)))][0]
        raise ObservationError(
            f"{path} has an event at {name} = {wrong:g}; events are at whole pixels. Give the "
            "events before they were rectified, or round them."
        )
    return values.astype(np.int64)


def microseconds(path: Path, seconds: NDArray[Any]) -> NDArray[np.int64]:
    """Times [us] of times in seconds; ObservationError where they seem to be microseconds."""
    if not np.isfinite(seconds).all():
        raise ObservationError(f"{path} has an event at no time. Correct the events.")
    if seconds[-1] > seconds[0] and (seconds == np.rint(seconds)).all():
        raise ObservationError(
            f"{path} holds times from {seconds[0]:g} on in {seconds.dtype}, all of them whole: "
            "times in seconds have parts of a second, so that the unit is not known. Write t in "
            "microseconds, as whole numbers."
        )
    return to_microseconds(path, seconds)


def to_microseconds(path: Path, seconds: NDArray[Any]) -> NDArray[np.int64]:
    """Times [us] of finite times [s]; ObservationError where their type is too coarse for them."""
    latest = np.abs(seconds).max(initial=0)
    if (step := float(np.spacing(latest))) > _COARSEST:
        raise ObservationError(
            f"{path} holds times of up to {latest:.10g} s in {seconds.dtype}, which has one number "
            f"each {step:.3g} s there: when the events were is lost. Write t in microseconds, as "
            "whole numbers, from what it was rounded from."
        )
    return np.rint(seconds.astype(np.float64) * 1e6).astype(np.int64)


def whole_times(path: Path, t: NDArray[Any]) -> NDArray[np.int64]:
    """Times [us] in 64 bits; ObservationError where one is too late for that."""
    if (t >= LATEST).any():
        raise ObservationError(
            f"{path} has an event at t = {t[t >= LATEST][0]} us; times are less than 2^62 us. "
            "Count them from the recording's beginning."
        )
    return t.astype(np.int64)


class Polarity:
    """The coding of a recording's polarity, from what was seen of it so far: 0/1 or -1/1."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seen: set[float] = set()

    def rising(self, p: NDArray[Any]) -> NDArray[np.bool_]:
        """(E,) whether light rose; ObservationError where these are of another coding."""
        self._seen |= set(np.unique(p).tolist())
        if not any(self._seen <= coding for coding in _CODINGS):
            found = sorted(self._seen, key=lambda p: (p != p, p))  # nan last: a set has no order
            shown = ", ".join(f"{int(n) if n == n and n % 1 == 0 else n}" for n in found[:_SHOWN])
            raise ObservationError(
                f"{self._path} has the polarities {shown}{' ...' * (len(found) > _SHOWN)}; known "
                "are 0 where the light fell and 1 where it rose, or -1 and 1. Write them so."
            )
        return np.asarray(p > 0)
