"""What makes a track one that a kart can drive: checked once, when its file is read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from envs.errors import EnvError
from envs.track import Track

FloatArray = NDArray[np.float64]
RADIUS = 19.2  # [px] of a kart
CELL = 6.0  # [px] of the map that reachability is looked up in; far narrower than a kart


def check(track: Track, where: str) -> None:
    """Refuse a track that is open, or whose gates or start nobody can reach."""
    _start_is_free(track, where)
    free, origin = free_map(track)
    reached = flooded(free, _cell(track.start, origin))
    if reached[0].any() or reached[-1].any() or reached[:, 0].any() or reached[:, -1].any():
        raise EnvError(
            f"{where}: the walls are open: from the start a kart gets out of the track without "
            "passing the finish. Close the polyline, or draw the finish across the opening"
        )
    for number, gate in enumerate(track.gates, start=1):
        _gate_is_passable(track, gate, number, where, reached, origin)


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
    points = np.concatenate([track.walls, track.gates]).reshape(-1, 2)
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


def _gate_is_passable(
    track: Track,
    gate: FloatArray,
    number: int,
    where: str,
    reached: NDArray[np.bool_],
    origin: FloatArray,
) -> None:
    """Refuse a gate that lies off the track, or across a wall."""
    middle = gate.mean(axis=0)
    if distances(middle[None], track.walls).min() <= RADIUS:
        raise EnvError(f"{where}: gate {number} has a wall through its middle, at {_at(middle)}")
    # the rim passes a gate from as far as a radius; the finish itself bars the map
    x, y = _cell(middle, origin)
    near = int(np.ceil(RADIUS / CELL)) + 2
    around = reached[max(0, x - near) : x + near + 1, max(0, y - near) : y + near + 1]
    if not around.any():
        raise EnvError(
            f"{where}: gate {number} is off the track: no kart gets from the start to its middle "
            f"at {_at(middle)}"
        )


def _at(point: FloatArray) -> str:
    return f"({point[0]:.0f}, {point[1]:.0f})"
