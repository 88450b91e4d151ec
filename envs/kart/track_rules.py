"""What makes a track one that a kart can drive: checked once, when its file is read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.track import Track

FloatArray = NDArray[np.float64]
RADIUS = 19.2  # [px] of a kart
CELL = 6.0  # [px] of the map that reachability is looked up in; far narrower than a kart
LARGEST = 20_000.0  # [px] from end to end; the map of a wider track would fill the memory
RIM = RADIUS + 2 * CELL  # [px] from a barrier to the cells next to it, at most


def check(track: Track, where: str) -> None:
    """Refuse a track that is open, or whose gates or start nobody can reach."""
    _is_of_a_size(track, where)
    _start_is_free(track, where)
    free, origin = free_map(track)
    reached = flooded(free, _cell(track.start, origin))
    if reached[0].any() or reached[-1].any() or reached[:, 0].any() or reached[:, -1].any():
        raise EnvError(
            f"{where}: the walls are open, or the start is outside of them: a kart gets out of the "
            "track without passing the finish. Close the polyline, or draw the finish across the "
            "opening"
        )
    cells = origin + CELL * np.argwhere(reached)
    for number, gate in enumerate(track.gates, start=1):
        _gate_is_clear(track, gate, number, where)
        # the finish bars the map, so that only the rim gets there
        _gate_is_reached(gate, number, where, cells, CELL if number < len(track.gates) else RIM)
    for shift in (-track.sway, track.sway) if track.sway else ():
        swayed = track.gates[-1] + (0.0, shift)
        _gate_is_clear(track, swayed, len(track.gates), f"{where}, swayed by {shift:g} px")
        _gate_is_reached(swayed, len(track.gates), f"{where}, swayed by {shift:g} px", cells, RIM)


def _is_of_a_size(track: Track, where: str) -> None:
    points = np.concatenate([track.walls, track.gates, [[track.start, track.start]]]).reshape(-1, 2)
    widest = float(np.ptp(points, axis=0).max())
    if widest > LARGEST:
        raise EnvError(f"{where}: it is {widest:g} px wide; at most {LARGEST:g}. Scale it down")


def distances(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Distance (n, m) [px] of points (n, 2) to segments (m, 2, 2)."""
    base, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    offset = points[:, None] - base
    # s = clip((p - a) . d / d . d, 0, 1) ; |p - a - s d|
    share = (offset * along).sum(-1) / (along * along).sum(-1)
    nearest = offset - np.clip(share, 0.0, 1.0)[..., None] * along
    result: FloatArray = np.sqrt((nearest * nearest).sum(-1))
    return result


def free_map(track: Track) -> tuple[NDArray[np.bool_], FloatArray]:
    """Cells (x, y) in which a kart touches neither wall nor finish, and where the map begins."""
    points = np.concatenate([track.walls, track.gates, [[track.start, track.start]]]).reshape(-1, 2)
    origin = points.min(axis=0) - 3 * RADIUS
    shape = np.ceil((points.max(axis=0) + 3 * RADIUS - origin) / CELL).astype(int)
    barriers = np.concatenate([track.walls, track.gates[-1:]])
    centres = np.indices(shape).reshape(2, -1).T * CELL + origin
    nearest = np.full(len(centres), np.inf)
    for barrier in barriers:  # one after the other: all at once would be gigabytes
        np.minimum(nearest, distances(centres, barrier[None])[:, 0], out=nearest)
    return (nearest > RADIUS).reshape(shape), origin


def flooded(free: NDArray[np.bool_], seed: tuple[int, int]) -> NDArray[np.bool_]:
    """The free cells that are connected with one of them."""
    reached = np.zeros_like(free)
    reached[seed] = free[seed]
    while True:
        grown = reached.copy()
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        grown &= free
        if np.array_equal(grown, reached):
            return reached
        reached = grown


def _cell(point: FloatArray, origin: FloatArray) -> tuple[int, int]:
    x, y = np.rint((point - origin) / CELL).astype(int)
    return int(x), int(y)


def _start_is_free(track: Track, where: str) -> None:
    offsets = np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]]) * track.spread
    room = distances(track.start + offsets, track.walls).min()
    if room <= RADIUS:
        raise EnvError(
            f"{where}: a kart of radius {RADIUS} px starts {room:.1f} px from a wall; move the "
            "start or lower its spread"
        )


def _gate_is_clear(track: Track, gate: FloatArray, number: int, where: str) -> None:
    """Refuse a gate that crosses a wall, but for its ends, which may stick out a little."""
    (a, b), along = gate, gate[1] - gate[0]
    starts, walls = track.walls[:, 0], track.walls[:, 1] - track.walls[:, 0]
    # a + share along = start + u wall;  [p, q] = px qy - py qx
    steep = _cross(along, walls)
    steep = np.where(steep == 0.0, np.inf, steep)  # alongside: never crosses
    share, u = _cross(starts - a, walls) / steep, _cross(starts - a, along) / steep
    inner = np.minimum(share, 1.0 - share) * np.hypot(*along) > RADIUS
    crossed = inner & (u >= 0.0) & (u <= 1.0)
    if crossed.any():
        place = a + share[crossed][0] * (b - a)
        raise EnvError(f"{where}: gate {number} is crossed by a wall at {_at(place)}; shorten it")


def _gate_is_reached(
    gate: FloatArray, number: int, where: str, cells: FloatArray, reach: float
) -> None:
    """Refuse a gate from which the cells (n, 2) where karts get to stay away further than that."""
    if distances(cells, gate[None]).min() > reach:
        raise EnvError(
            f"{where}: gate {number} is off the track: no kart gets from the start to "
            f"{_at(gate[0])}-{_at(gate[1])}"
        )


def _cross(p: FloatArray, q: FloatArray) -> FloatArray:
    product: FloatArray = p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]
    return product


def _at(point: FloatArray) -> str:
    return f"({point[0]:.0f}, {point[1]:.0f})"
