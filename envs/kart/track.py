"""Tracks: walls, gates in order, and a place to start; tracks/*.json hold those that are shipped.

A file holds one JSON object (docs/tracks.md):

    name   text
    walls  polylines, each a list of at least two points [x, y] in px (100 px = 1 m, y downwards)
    gates  pairs of points, in the order in which they are passed; the last is the finish
    start  {"position": [x, y], "spread": px, "heading": [lowest, highest] in rad}
    sway   optional: the finish is moved along y by up to so many px at each reset
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError

FloatArray = NDArray[np.float64]
FOLDER = Path(__file__).parent / "tracks"
FIELDS = ("name", "walls", "gates", "start")
START = ("position", "spread", "heading")


@dataclass(frozen=True, eq=False)
class Track:
    """A track; y points down, 100 px are 1 m.

    name       of the track
    walls      (W, 2, 2) segments that a kart must not touch [px]
    gates      (G, 2, 2) segments to be touched in this order [px]; the last is the finish
    start      (2,) middle of the places to start [px]
    spread     a start is drawn up to this far from it, either way on both axes [px]
    heading    (lowest, highest) at the start [rad], 0 to the right, clockwise
    sway       of the finish along y at each reset, either way [px]
    polylines  of which the walls are the segments, each (points, 2) [px]
    """

    name: str
    walls: FloatArray
    gates: FloatArray
    start: FloatArray
    spread: float
    heading: tuple[float, float]
    sway: float = 0.0
    polylines: tuple[FloatArray, ...] = field(default=(), repr=False)

    @cached_property
    def midpoints(self) -> tuple[tuple[float, float], ...]:
        """Of the gates, (G, 2) [px]."""
        return tuple((float(x), float(y)) for x, y in self.gates.mean(axis=1))

    @cached_property
    def rest(self) -> tuple[float, ...]:
        """(G,) way from each gate's midpoint through the later ones [px]."""
        legs = np.hypot(*np.diff(np.array(self.midpoints), axis=0).T)
        return (*np.cumsum(legs[::-1])[::-1].tolist(), 0.0)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the walls [px]."""
        points = self.walls.reshape(-1, 2)
        (left, top), (right, bottom) = points.min(axis=0), points.max(axis=0)
        return float(left), float(top), float(right), float(bottom)

    @cached_property
    def length(self) -> float:
        """Way from the middle of the start through all gates [px]."""
        return self.remaining(float(self.start[0]), float(self.start[1]), 0)

    def remaining(self, x: float, y: float, next_gate: int) -> float:
        """Way from here through the midpoints of the gates that are left [px]."""
        if next_gate >= len(self.midpoints):
            return 0.0
        gx, gy = self.midpoints[next_gate]
        dx, dy = gx - x, gy - y
        return float((dx * dx + dy * dy) ** 0.5) + self.rest[next_gate]

    def swayed(self, rng: np.random.Generator) -> Track:
        """The track with its finish where it is this time."""
        gates = self.gates.copy()
        gates[-1, :, 1] += rng.uniform(-self.sway, self.sway)
        return replace(self, gates=gates)


def segments(polylines: Sequence[FloatArray]) -> FloatArray:
    """(W, 2, 2) between consecutive points of polylines."""
    return np.concatenate([np.stack((line[:-1], line[1:]), axis=1) for line in polylines])


def names() -> tuple[str, ...]:
    """The tracks that are shipped."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.json")))


def load(track: str | Path) -> Track:
    """A shipped track by its name, or any by the path of its file; one nobody can drive is refused.

    Raises EnvError with the reason.
    """
    path = Path(track)
    if path.suffix != ".json":
        if str(track) not in names():
            raise EnvError(_unknown(str(track)))
        path = FOLDER / f"{track}.json"
    try:
        changed = path.stat().st_mtime_ns
    except OSError as error:
        raise EnvError(f"track {path}: {error.strerror}") from error
    return _read(path, changed)


@lru_cache(maxsize=32)
def _read(path: Path, changed: int) -> Track:
    """The track of a file as it was at a time: read and checked once."""
    from spikedeploy.envs.kart.track_rules import check

    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise EnvError(f"track {path}: not a JSON file ({error})") from error
    track = parse(tree, f"track {path}")
    check(track, f"track {path}")
    return track


def parse(tree: object, where: str) -> Track:
    """The track that a file's object describes; `where` names it in errors."""
    fields = _fields(tree, FIELDS, ("sway",), where)
    start = _fields(fields["start"], START, (), f"{where}: start")
    polylines = _lines(fields["walls"], f"{where}: wall")
    low, high = _numbers(start["heading"], (2,), f"{where}: start heading")
    track = Track(
        name=str(fields["name"]),
        walls=segments(polylines),
        gates=_gates(fields["gates"], where),
        start=_numbers(start["position"], (2,), f"{where}: start position"),
        spread=float(_numbers(start["spread"], (), f"{where}: start spread")),
        heading=(float(low), float(high)),
        sway=float(_numbers(fields.get("sway", 0.0), (), f"{where}: sway")),
        polylines=polylines,
    )
    if track.spread < 0 or track.sway < 0 or low > high:
        raise EnvError(
            f"{where}: spread {track.spread} and sway {track.sway} must not be below 0, and the "
            f"heading [{low}, {high}] must not fall"
        )
    return track


def _gates(value: object, where: str) -> FloatArray:
    lines = _lines(value, f"{where}: gate")
    for number, line in enumerate(lines, start=1):
        if len(line) != 2:
            raise EnvError(f"{where}: gate {number} has {len(line)} points; a gate has two")
    return np.stack(lines)


def _lines(value: object, where: str) -> tuple[FloatArray, ...]:
    """A list of lines, at least one."""
    if not isinstance(value, list) or not value:
        raise EnvError(f"{where}s: must be a list of lines, at least one; found {str(value)[:60]}")
    return tuple(_points(line, f"{where} {number}") for number, line in enumerate(value, 1))


def _points(value: object, where: str) -> FloatArray:
    """At least two points (n, 2), none the same as the one before."""
    points = _numbers(value, (None, 2), where)
    if len(points) < 2:
        raise EnvError(f"{where}: {len(points)} point; a line needs two")
    lengths = np.hypot(*np.diff(points, axis=0).T)
    if not lengths.all():
        place = int(np.flatnonzero(lengths == 0)[0]) + 1
        raise EnvError(f"{where}: points {place} and {place + 1} are the same")
    return points


def _numbers(value: object, shape: Sequence[int | None], where: str) -> FloatArray:
    """An array of finite numbers; None in the shape is any length."""
    wanted = "a number" if not shape else f"numbers of shape {tuple(n or 'n' for n in shape)}"
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise EnvError(f"{where}: must be {wanted}, found {str(value)[:60]}") from None
    fits = len(array.shape) == len(shape) and all(
        wish in (None, size) for wish, size in zip(shape, array.shape, strict=True)
    )
    if not fits or not np.isfinite(array).all():
        raise EnvError(f"{where}: must be {wanted}, all finite; found {str(value)[:60]}")
    return array


def _fields(
    value: object, needed: Sequence[str], optional: Sequence[str], where: str
) -> dict[str, Any]:
    """The fields of a JSON object that has all that it needs and nothing else."""
    if not isinstance(value, dict):
        raise EnvError(f"{where}: must be an object with {', '.join(needed)}")
    missing = [name for name in needed if name not in value]
    unknown = sorted(value.keys() - {*needed, *optional})
    if missing or unknown:
        fault = f"{missing[0]!r} is missing" if missing else f"unknown field {unknown[0]!r}"
        raise EnvError(f"{where}: {fault}; it has {', '.join([*needed, *optional])}")
    return value


def _unknown(name: str) -> str:
    known = [*names(), "corridor"]
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}."
    return f"unknown track {name!r}; {hint} A file of your own ends in .json"
