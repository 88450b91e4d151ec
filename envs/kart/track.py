"""A track: walls, gates in order, a start; its file, the rules that it keeps, and corridors."""

from __future__ import annotations

import difflib
import json
import re
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
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
    sway: largest shift of the finish along y at a reset, either way [px]
    """

    name: str
    walls: FloatArray
    gates: FloatArray
    start: FloatArray
    spread: float
    heading: tuple[float, float]
    sway: float = 0.0

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

    def swayed(self, rng: np.random.Generator) -> Track:
        """The track with its finish shifted at random, as at a reset."""
        gates = self.gates.copy()
        gates[-1, :, 1] += rng.uniform(-self.sway, self.sway)
        return replace(self, gates=gates)


def segments(polylines: Sequence[FloatArray]) -> FloatArray:
    """Segments (W, 2, 2) between consecutive points of polylines."""
    return np.concatenate([np.stack((line[:-1], line[1:]), axis=1) for line in polylines])


Cell = tuple[int, int]

_HALF = 50.0  # [px] half a cell's side, as in kart-simulator
_CENTRE = (500.0, 500.0)  # [px] of the first cell
_SPREAD = 25.0  # [px] of start positions within it
_NAME = re.compile(r"corridor(?:-(\d+))?$")
_LENGTHS = (2, 64)  # cells
_DIRECTIONS: tuple[Cell, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))  # right, down, left, up


def length_of(name: str) -> int | None:
    """Cells of `corridor` (3, as in kart-simulator) or `corridor-N`; None for other names."""
    match = _NAME.match(name)
    if match is None:
        return None
    count = int(match[1] or 3)
    if not _LENGTHS[0] <= count <= _LENGTHS[1]:
        raise EnvError(f"track {name!r}: a corridor has {_LENGTHS[0]} to {_LENGTHS[1]} cells")
    return count


def corridor(count: int, rng: np.random.Generator) -> Track:
    """A corridor of `count` cells that does not touch itself; its far end is the finish."""
    path = _path(count, rng)
    steps = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(path)]
    # a cell is open towards its predecessor and its successor, the last one towards the finish
    entered: list[set[Cell]] = [set(), *({(-dx, -dy)} for dx, dy in steps)]
    left = [*steps, steps[-1]]
    openings = [before | {after} for before, after in zip(entered, left, strict=True)]
    polylines = tuple(
        _side(cell, side)
        for cell, open_sides in zip(path, openings, strict=True)
        for side in _DIRECTIONS
        if side not in open_sides
    )
    heading = float(np.arctan2(steps[0][1], steps[0][0]))
    return Track(
        name=f"corridor-{count}",
        walls=segments(polylines),
        gates=np.stack([_side(cell, step) for cell, step in zip(path, left, strict=True)]),
        start=np.array(_CENTRE),
        spread=_SPREAD,
        heading=(heading, heading),
    )


def _path(count: int, rng: np.random.Generator) -> list[Cell]:
    """Cells of a random walk, each beside no earlier cell except its predecessor."""
    while True:
        path: list[Cell] = [(0, 0)]
        while len(path) < count:
            earlier = {other for cell in path[:-1] for other in (cell, *_beside(cell))}
            choices = [cell for cell in _beside(path[-1]) if cell not in earlier]
            if not choices:
                break  # a dead end: start again
            path.append(choices[int(rng.integers(len(choices)))])
        if len(path) == count:
            return path


def _beside(cell: Cell) -> list[Cell]:
    return [(cell[0] + dx, cell[1] + dy) for dx, dy in _DIRECTIONS]


def _side(cell: Cell, side: Cell) -> FloatArray:
    """Edge (2, 2) of a cell on one of its sides [px]."""
    middle = np.array(_CENTRE) + 2 * _HALF * np.array(cell) + _HALF * np.array(side)
    along = _HALF * np.array([side[1], side[0]])
    edge: FloatArray = np.stack([middle - along, middle + along])
    return edge


_CELL = 6.0  # [px] of the reachability map; far narrower than a kart
_PIECE = 300.0  # [px] of a wall that is looked at at once
_LARGEST_TRACK = 20_000.0  # [px] width or height; the map of a larger one would fill the memory
_LARGEST_AREA = 6e7  # [px^2] as much
_RIM = RADIUS + 2 * _CELL  # [px] largest distance of a barrier from its nearest free cells


def check(track: Track, where: str) -> None:
    """Raise EnvError unless walls are closed, the start is free and every gate can be reached."""
    points = np.concatenate([track.walls, track.gates, [[track.start, track.start]]]).reshape(-1, 2)
    sides = np.ptp(points, axis=0)
    widest = float(max(*sides, track.spread, track.sway))
    if widest > _LARGEST_TRACK or np.prod(sides) > _LARGEST_AREA:
        raise EnvError(
            f"{where}: the track, its spread or its sway are {widest:g} px wide and cover "
            f"{np.prod(sides):g} square px; at most {_LARGEST_TRACK:g} and {_LARGEST_AREA:g}. "
            "Scale it down"
        )
    offsets = np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]]) * track.spread
    clearance = distances(track.start + offsets, track.walls).min()
    if clearance <= RADIUS:
        raise EnvError(
            f"{where}: a kart of radius {RADIUS} px can start {clearance:.1f} px from a wall; "
            "move the start or lower its spread"
        )
    free, origin = _free_map(track, points)
    reached = _flood(free, _cell(track.start, origin))
    if reached[0].any() or reached[-1].any() or reached[:, 0].any() or reached[:, -1].any():
        raise EnvError(
            f"{where}: the walls are open, or the start is outside of them: a kart can leave the "
            "track without passing the finish. Close the polyline, or draw the finish across the "
            "opening"
        )
    cells, last = origin + _CELL * np.argwhere(reached), len(track.gates)
    for number, gate in enumerate(track.gates, start=1):
        # the finish is a barrier of the map: free cells end a rim's distance before it
        _check_gate(track, gate, f"{where}: gate {number}", cells, _CELL if number < last else _RIM)
    for shift in (-track.sway, track.sway) if track.sway else ():
        swayed = track.gates[-1] + (0.0, shift)
        place = f"{where}, swayed by {shift:g} px: gate {last}"
        _check_gate(track, swayed, place, cells, _RIM)


def distances(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Distance (n, m) [px] of points (n, 2) to segments (m, 2, 2)."""
    base, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    offset = points[:, None] - base
    # s = clip((p - a) . d / d . d, 0, 1) ; |p - a - s d|
    share = (offset * along).sum(-1) / (along * along).sum(-1)
    nearest = offset - np.clip(share, 0.0, 1.0)[..., None] * along
    result: FloatArray = np.sqrt((nearest * nearest).sum(-1))
    return result


def _free_map(track: Track, points: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
    """Map of the cells (x, y) in which a kart touches neither wall nor finish, and its origin."""
    origin = points.min(axis=0) - 3 * RADIUS
    shape = np.ceil((points.max(axis=0) + 3 * RADIUS - origin) / _CELL).astype(int)
    barriers = np.concatenate([track.walls, track.gates[-1:]])
    free = np.ones(shape, bool)
    for barrier in barriers:
        for piece in _pieces(barrier):
            # of the cells that are near enough to matter, the distance to the whole barrier
            low = np.maximum(np.floor((piece.min(axis=0) - RADIUS - origin) / _CELL), 0).astype(int)
            high = np.ceil((piece.max(axis=0) + RADIUS - origin) / _CELL).astype(int) + 1
            window = free[low[0] : high[0], low[1] : high[1]]
            cells = np.indices(window.shape).reshape(2, -1).T + low
            nearest = distances(cells * _CELL + origin, barrier[None])[:, 0]
            window &= (nearest > RADIUS).reshape(window.shape)
    return free, origin


def _pieces(barrier: FloatArray) -> FloatArray:
    """Pieces (n, 2, 2) of a segment, none of them long: a window around each is small."""
    count = int(np.ceil(np.hypot(*(barrier[1] - barrier[0])) / _PIECE)) or 1
    return segments([np.linspace(barrier[0], barrier[1], count + 1)])


def _flood(free: NDArray[np.bool_], seed: tuple[int, int]) -> NDArray[np.bool_]:
    """Flood fill: the free cells that are connected with the seed cell, row by row."""
    reached = np.zeros_like(free)
    runs = [_runs(row) for row in free]
    waiting = [(seed[0], seed[1], seed[1] + 1)] if free[seed] else []
    while waiting:
        row, first, end = waiting.pop()
        starts, ends = runs[row]
        for run in range(bisect_right(ends, first), bisect_left(starts, end)):
            if reached[row, starts[run]]:
                continue
            reached[row, starts[run] : ends[run]] = True
            beside = (each for each in (row - 1, row + 1) if 0 <= each < len(free))
            waiting += [(each, starts[run], ends[run]) for each in beside]
    return reached


def _runs(row: NDArray[np.bool_]) -> tuple[list[int], list[int]]:
    edges = np.flatnonzero(np.diff(row, prepend=False, append=False))
    return edges[::2].tolist(), edges[1::2].tolist()


def _cell(point: FloatArray, origin: FloatArray) -> tuple[int, int]:
    x, y = np.rint((point - origin) / _CELL).astype(int)
    return int(x), int(y)


def _check_gate(track: Track, gate: FloatArray, name: str, cells: FloatArray, limit: float) -> None:
    """Refuse a gate that a wall crosses, except near its ends, which may stick out a little.

    Refuse one that is farther than `limit` [px] from every reachable cell (n, 2).
    """
    (a, b), along = gate, gate[1] - gate[0]
    starts, walls = track.walls[:, 0], track.walls[:, 1] - track.walls[:, 0]
    # a + share along = start + u wall;  [p, q] = px qy - py qx
    determinant = _cross(along, walls)
    determinant = np.where(determinant == 0.0, np.inf, determinant)  # parallel: never crosses
    share = _cross(starts - a, walls) / determinant
    u = _cross(starts - a, along) / determinant
    inner = np.minimum(share, 1.0 - share) * np.hypot(*along) > RADIUS
    crossed = inner & (u >= 0.0) & (u <= 1.0)
    if crossed.any():
        place = a + share[crossed][0] * (b - a)
        raise EnvError(f"{name} is crossed by a wall at {_at(place)}; shorten it")
    if distances(cells, gate[None]).min() > limit:
        raise EnvError(
            f"{name} is off the track: no kart can get from the start to {_at(a)}-{_at(b)}"
        )


def _cross(p: FloatArray, q: FloatArray) -> FloatArray:
    product: FloatArray = p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]
    return product


def _at(point: FloatArray) -> str:
    return f"({point[0]:.0f}, {point[1]:.0f})"


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
            known = [*names(), "corridor"]
            close = difflib.get_close_matches(str(track), known, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}."
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
    check(track, f"track {path}")
    return track


def parse(tree: object, where: str) -> Track:
    """The track in a file's JSON object; `where` names the file in errors."""
    fields = _fields(tree, _FIELDS, ("sway",), where)
    start = _fields(fields["start"], _START, (), f"{where}: start")
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
    )
    if max(len(track.walls), len(track.gates)) > _MOST_WALLS:
        raise EnvError(
            f"{where}: {len(track.walls)} segments of walls and {len(track.gates)} gates; at most "
            f"{_MOST_WALLS} of each. Draw with fewer points"
        )
    if track.spread < 0 or track.sway < 0 or low > high:
        raise EnvError(
            f"{where}: spread {track.spread} and sway {track.sway} must not be negative, "
            f"and the heading [{low}, {high}] must be in ascending order"
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


def _fields(
    value: object, needed: Sequence[str], optional: Sequence[str], where: str
) -> dict[str, Any]:
    """The fields of a JSON object, which must have all the needed ones and no unknown ones."""
    if not isinstance(value, dict):
        raise EnvError(f"{where}: must be an object with {', '.join(needed)}")
    missing = [name for name in needed if name not in value]
    unknown = sorted(value.keys() - {*needed, *optional})
    if missing or unknown:
        fault = f"{missing[0]!r} is missing" if missing else f"unknown field {unknown[0]!r}"
        raise EnvError(f"{where}: {fault}; it has {', '.join([*needed, *optional])}")
    return value
