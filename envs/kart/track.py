"""A track: walls, gates in order, a start; its file, and the rules that it keeps."""

from __future__ import annotations

import difflib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import EnvError
from spikedeploy.runtime.files import suffix

FloatArray = NDArray[np.float64]
RADIUS = 19.2  # [px] of a kart, for which all tracks are drawn


@dataclass(frozen=True, eq=False)
class Track:
    """A track; y points down, 100 px are 1 m.

    name: of the track
    walls: (W, 2, 2) segments that a kart must not touch [px]
    gates: (G, 2, 2) segments to pass in this order [px]; the last is the finish
    start: (2,) centre of the start positions [px]
    spread: start positions are drawn uniformly within this distance on both axes [px]
    heading: (lowest, highest) at the start [rad], 0 to the right, clockwise
    """

    name: str
    walls: FloatArray
    gates: FloatArray
    start: FloatArray
    spread: float
    heading: tuple[float, float]

    @cached_property
    def midpoints(self) -> tuple[tuple[float, float], ...]:
        """Midpoint of each gate, (G, 2) [px]."""
        return tuple((float(x), float(y)) for x, y in self.gates.mean(axis=1))

    @cached_property
    def rest(self) -> tuple[float, ...]:
        """(G,) length of the path from each gate's midpoint through the later ones [px]."""
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
        """Length of the path from the centre of the start through all gates [px]."""
        return self.remaining(float(self.start[0]), float(self.start[1]), 0)

    def remaining(self, x: float, y: float, next_gate: int) -> float:
        """Length of the path from (x, y) through the midpoints of the remaining gates [px]."""
        if next_gate >= len(self.midpoints):
            return 0.0
        gx, gy = self.midpoints[next_gate]
        dx, dy = gx - x, gy - y
        return float((dx * dx + dy * dy) ** 0.5) + self.rest[next_gate]


def segments(polylines: Sequence[FloatArray]) -> FloatArray:
    """Segments (W, 2, 2) between consecutive points of polylines."""
    return np.concatenate([np.stack((line[:-1], line[1:]), axis=1) for line in polylines])


_CELL = 6.0  # [px] of the map of reachable cells; far narrower than a kart
_PIECE = 300.0  # [px] of a wall that is looked at at once
_LARGEST_TRACK = 20_000.0  # [px] width or height; the map of a larger one would fill the memory
_LARGEST_AREA = 6e7  # [px^2] as much
_RIM = RADIUS + 2 * _CELL  # [px] largest distance of a barrier from its nearest free cells


def check(track: Track, where: str) -> None:
    """Raise EnvError unless walls are closed, the start is free and every gate can be reached."""
    points = np.concatenate([track.walls, track.gates, [[track.start, track.start]]]).reshape(-1, 2)
    sides = np.ptp(points, axis=0)
    if max(*sides, track.spread) > _LARGEST_TRACK or np.prod(sides) > _LARGEST_AREA:
        raise EnvError(
            f"{where}: the track is {sides[0]:g} x {sides[1]:g} px, with a spread of "
            f"{track.spread:g} px; at most {_LARGEST_TRACK:g} and {_LARGEST_AREA:g} square px. "
            "Scale it down"
        )
    offsets = np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]]) * track.spread
    clearance = distances(track.start + offsets, track.walls).min()
    if clearance <= RADIUS:
        raise EnvError(
            f"{where}: a kart of radius {RADIUS} px can start {clearance:.1f} px from a wall; "
            "move the start or lower its spread"
        )
    origin = points.min(axis=0) - 3 * RADIUS
    reached = _connected(_free_cells(track, points, origin), (track.start - origin) / _CELL)
    if reached[0].any() or reached[-1].any() or reached[:, 0].any() or reached[:, -1].any():
        raise EnvError(
            f"{where}: the walls are open, or the start is outside of them: a kart can leave the "
            "track without passing the finish. Close the polyline, or draw the finish across the "
            "opening"
        )
    cells, last = origin + _CELL * np.argwhere(reached), len(track.gates)
    for number, gate in enumerate(track.gates, start=1):
        # the finish is a barrier of the map: free cells end a rim's distance before it
        if distances(cells, gate[None]).min() > (_CELL if number < last else _RIM):
            (a, b), (c, d) = gate.round().tolist()
            raise EnvError(
                f"{where}: gate {number} is off the track: no kart can get from the start to "
                f"({a:.0f}, {b:.0f})-({c:.0f}, {d:.0f})"
            )


def distances(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Distance (n, m) [px] of points (n, 2) to segments (m, 2, 2)."""
    base, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    offset = points[:, None] - base
    # s = clip((p - a) . d / d . d, 0, 1) ; |p - a - s d|
    share = (offset * along).sum(-1) / (along * along).sum(-1)
    nearest = offset - np.clip(share, 0.0, 1.0)[..., None] * along
    result: FloatArray = np.sqrt((nearest * nearest).sum(-1))
    return result


def _pieces(barriers: FloatArray) -> FloatArray:
    """Pieces (n, 2, 2) of segments, none of them long: a window around each is small."""
    lengths = np.hypot(*(barriers[:, 1] - barriers[:, 0]).T)
    counts = np.maximum(np.ceil(lengths / _PIECE), 1).astype(int)
    ends = zip(barriers, counts.tolist(), strict=True)
    return segments([np.linspace(a, b, count + 1) for (a, b), count in ends])


def _free_cells(track: Track, points: FloatArray, origin: FloatArray) -> NDArray[np.bool_]:
    """Map (x, y) of the cells in which a kart touches neither wall nor finish."""
    free = np.ones(np.ceil((points.max(axis=0) + 3 * RADIUS - origin) / _CELL).astype(int), bool)
    for barrier in _pieces(np.concatenate([track.walls, track.gates[-1:]])):
        low = np.maximum((barrier.min(axis=0) - RADIUS - origin) // _CELL, 0).astype(int)
        high = np.ceil((barrier.max(axis=0) + RADIUS - origin) / _CELL).astype(int) + 1
        window = free[low[0] : high[0], low[1] : high[1]]
        cells = np.indices(window.shape).reshape(2, -1).T + low
        nearest = distances(cells * _CELL + origin, barrier[None])
        window &= (nearest > RADIUS).reshape(window.shape)
    return free


def _connected(free: NDArray[np.bool_], cell: FloatArray) -> NDArray[np.bool_]:
    """The free cells that are connected with one of them."""
    import pygame

    surface = pygame.surfarray.make_surface(np.where(free, 255, 0)[..., None].repeat(3, axis=2))
    mask = pygame.mask.from_threshold(surface, (255, 255, 255), (1, 1, 1, 255))
    found = mask.connected_component(np.rint(cell).astype(int).tolist())
    reached: NDArray[np.bool_] = pygame.surfarray.array3d(found.to_surface())[..., 0] > 0
    return reached


FOLDER = Path(__file__).parent / "tracks"
_LARGEST = 5 << 20  # [bytes]
_MOST_WALLS = 20_000  # segments; and gates
_FARTHEST = 1e9  # [px] of a coordinate: squares of larger ones overflow
_FIELDS = ("name", "walls", "gates", "start")
_START = ("position", "spread", "heading")


def names() -> tuple[str, ...]:
    """Names of the shipped tracks."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.json")))


def load(track: str | Path) -> Track:
    """A shipped track by name, or any track by the path of its file.

    Raises EnvError where the file is malformed or the track cannot be driven.
    """
    path = Path(track)
    if suffix(path) != ".json":
        if str(track) not in names():
            close = difflib.get_close_matches(str(track), names(), n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(names())}."
            raise EnvError(f"unknown track {str(track)!r}; {hint} A file of your own ends in .json")
        path = FOLDER / f"{track}.json"
    try:
        found = path.stat()
    except OSError as error:
        raise EnvError(f"track {path}: {error.strerror}") from error
    if not path.is_file() or found.st_size > _LARGEST:
        raise EnvError(f"track {path}: no file, or more than {_LARGEST} bytes: no track is so long")
    return _read(path, found.st_mtime_ns)


@lru_cache(maxsize=32)
def _read(path: Path, changed: int) -> Track:
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise EnvError(f"track {path}: not a JSON file ({error})") from error
    track = parse(tree, f"track {path}")
    if path.parent != FOLDER:  # those are checked by tests, and the check loads pygame
        check(track, f"track {path}")
    return track


def parse(tree: object, where: str) -> Track:
    """The track in a file's JSON object; `where` names the file in errors."""
    fields = _fields(tree, _FIELDS, where)
    start = _fields(fields["start"], _START, f"{where}: start")
    polylines = _lines(fields["walls"], f"{where}: wall")
    low, high = _numbers(start["heading"], (2,), f"{where}: start heading")
    track = Track(
        name=str(fields["name"]),
        walls=segments(polylines),
        gates=_gates(fields["gates"], where),
        start=_numbers(start["position"], (2,), f"{where}: start position"),
        spread=float(_numbers(start["spread"], (), f"{where}: start spread")),
        heading=(float(low), float(high)),
    )
    if max(len(track.walls), len(track.gates)) > _MOST_WALLS:
        raise EnvError(
            f"{where}: {len(track.walls)} segments of walls and {len(track.gates)} gates; at most "
            f"{_MOST_WALLS} of each. Draw with fewer points"
        )
    if track.spread < 0 or low > high:
        raise EnvError(
            f"{where}: the spread {track.spread} must not be negative, and the heading "
            f"[{low}, {high}] must be in ascending order"
        )
    return track


def _gates(value: object, where: str) -> FloatArray:
    lines = _lines(value, f"{where}: gate")
    for number, line in enumerate(lines, start=1):
        if len(line) != 2:
            raise EnvError(f"{where}: gate {number} has {len(line)} points; a gate has two")
    return np.stack(lines)


def _lines(value: object, where: str) -> tuple[FloatArray, ...]:
    if not isinstance(value, list) or not value:
        raise EnvError(f"{where}s: must be a list of lines, at least one; found {str(value)[:60]}")
    return tuple(_points(line, f"{where} {number}") for number, line in enumerate(value, 1))


def _points(value: object, where: str) -> FloatArray:
    """Read at least two points (n, 2), no two consecutive ones equal."""
    points = _numbers(value, (None, 2), where)
    if len(points) < 2:
        raise EnvError(f"{where}: {len(points)} point; a line needs two")
    if (equal := np.flatnonzero((np.diff(points, axis=0) == 0).all(axis=1))).size:
        raise EnvError(f"{where}: points {equal[0] + 1} and {equal[0] + 2} are the same")
    return points


def _numbers(value: object, shape: Sequence[int | None], where: str) -> FloatArray:
    """An array of finite numbers; None in the shape stands for any length."""
    wanted = "a number" if not shape else f"numbers of shape {tuple(n or 'n' for n in shape)}"
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise EnvError(f"{where}: must be {wanted}, found {str(value)[:60]}") from None
    fits = len(array.shape) == len(shape) and all(
        wanted in (None, size) for wanted, size in zip(shape, array.shape, strict=True)
    )
    if not fits or not (np.abs(array) <= _FARTHEST).all():
        raise EnvError(
            f"{where}: must be {wanted}, all finite and within ±{_FARTHEST:g}; found "
            f"{str(value)[:60]}"
        )
    return array


def _fields(value: object, needed: Sequence[str], where: str) -> dict[str, Any]:
    """The fields of a JSON object, which must have these and no others."""
    if not isinstance(value, dict):
        raise EnvError(f"{where}: must be an object with {', '.join(needed)}")
    missing = [name for name in needed if name not in value]
    unknown = sorted(value.keys() - {*needed})
    if missing or unknown:
        fault = f"{missing[0]!r} is missing" if missing else f"unknown field {unknown[0]!r}"
        raise EnvError(f"{where}: {fault}; it has {', '.join(needed)}")
    return value
