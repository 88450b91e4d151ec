"""Checks that a track can be driven: closed walls, a free start, reachable gates."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.track import RADIUS, Track, segments

FloatArray = NDArray[np.float64]
_CELL = 6.0  # [px] of the reachability map; far narrower than a kart
_PIECE = 300.0  # [px] of a wall that is looked at at once
_LARGEST_TRACK = 20_000.0  # [px] width or height; the map of a larger one would fill the memory
_LARGEST_AREA = 6e7  # [px^2] as much
_RIM = RADIUS + 2 * _CELL  # [px] largest distance of a barrier from its nearest free cells


def check(track: Track, where: str) -> None:
    """Raise EnvError unless walls are closed, the start is free and every gate can be reached."""
    _check_size(track, where)
    _check_start(track, where)
    free, origin = _free_map(track)
    reached = _flooded(free, _cell(track.start, origin))
    if reached[0].any() or reached[-1].any() or reached[:, 0].any() or reached[:, -1].any():
        raise EnvError(
            f"{where}: the walls are open, or the start is outside of them: a kart can leave the "
            "track without passing the finish. Close the polyline, or draw the finish across the "
            "opening"
        )
    cells = origin + _CELL * np.argwhere(reached)
    for number, gate in enumerate(track.gates, start=1):
        _check_gate_crossings(track, gate, number, where)
        # the finish is a barrier of the map: free cells end a rim's distance before it
        _check_gate_reachable(
            gate, number, where, cells, _CELL if number < len(track.gates) else _RIM
        )
    for shift in (-track.sway, track.sway) if track.sway else ():
        swayed = track.gates[-1] + (0.0, shift)
        _check_gate_crossings(track, swayed, len(track.gates), f"{where}, swayed by {shift:g} px")
        _check_gate_reachable(
            swayed, len(track.gates), f"{where}, swayed by {shift:g} px", cells, _RIM
        )


def _check_size(track: Track, where: str) -> None:
    points = np.concatenate([track.walls, track.gates, [[track.start, track.start]]]).reshape(-1, 2)
    widest = float(np.ptp(points, axis=0).max())
    if widest > _LARGEST_TRACK:
        raise EnvError(
            f"{where}: the track is {widest:g} px wide; at most {_LARGEST_TRACK:g}. Scale it down"
        )
    if (moved := max(track.spread, track.sway)) > _LARGEST_TRACK:
        raise EnvError(
            f"{where}: spread {track.spread:g} and sway {track.sway:g}, and {moved:g} px are more "
            f"than a track has, {_LARGEST_TRACK:g}. Make them smaller"
        )
    if (area := float(np.prod(np.ptp(points, axis=0)))) > _LARGEST_AREA:
        raise EnvError(
            f"{where}: the track covers {area:g} square px; at most {_LARGEST_AREA:g}. Scale it "
            "down"
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


def _free_map(track: Track) -> tuple[NDArray[np.bool_], FloatArray]:
    """Map of the cells (x, y) in which a kart touches neither wall nor finish, and its origin."""
    points = np.concatenate([track.walls, track.gates, [[track.start, track.start]]]).reshape(-1, 2)
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


def _flooded(free: NDArray[np.bool_], seed: tuple[int, int]) -> NDArray[np.bool_]:
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
    """Where runs of free cells start, and where they end."""
    edges = np.flatnonzero(np.diff(row, prepend=False, append=False))
    return edges[::2].tolist(), edges[1::2].tolist()


def _cell(point: FloatArray, origin: FloatArray) -> tuple[int, int]:
    x, y = np.rint((point - origin) / _CELL).astype(int)
    return int(x), int(y)


def _check_start(track: Track, where: str) -> None:
    offsets = np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]]) * track.spread
    clearance = distances(track.start + offsets, track.walls).min()
    if clearance <= RADIUS:
        raise EnvError(
            f"{where}: a kart of radius {RADIUS} px can start {clearance:.1f} px from a wall; "
            "move the start or lower its spread"
        )


def _check_gate_crossings(track: Track, gate: FloatArray, number: int, where: str) -> None:
    """Refuse a gate that crosses a wall, except near its ends, which may stick out a little."""
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
        raise EnvError(f"{where}: gate {number} is crossed by a wall at {_at(place)}; shorten it")


def _check_gate_reachable(
    gate: FloatArray, number: int, where: str, cells: FloatArray, limit: float
) -> None:
    """Refuse a gate that is farther than `limit` [px] from every reachable cell (n, 2)."""
    if distances(cells, gate[None]).min() > limit:
        raise EnvError(
            f"{where}: gate {number} is off the track: no kart can get from the start to "
            f"{_at(gate[0])}-{_at(gate[1])}"
        )


def _cross(p: FloatArray, q: FloatArray) -> FloatArray:
    product: FloatArray = p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]
    return product


def _at(point: FloatArray) -> str:
    return f"({point[0]:.0f}, {point[1]:.0f})"
