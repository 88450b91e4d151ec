"""Observations along the path of a ghost, which records poses only."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.ghosts import Ghost

Floats = NDArray[np.float64]
RADIUS = 19.2  # [px] of a kart


def ghost_observations(ghost: Ghost, world: Any) -> Floats:  # noqa: ANN401
    """Observations (S + 1, obs) that the environment would have made at the poses of a ghost."""
    pose = ghost.pose.astype(np.float64)
    turn = _turn(pose[:, 2]) / world.CONTROL_DT
    if "forward" in world.ACTIONS:  # turns are observed a step before the kart moves
        turn = np.append(turn[1:], 0.0)
    velocity = ghost.speed[:, None] * _direction(pose, not world.TURNS)
    gates = gates_passed(pose[:, :2], world.track.gates)
    return np.stack(
        [
            world.observe_at(*pose[k], velocity[k], float(turn[k]), int(gates[k]))
            for k in range(len(pose))
        ]
    )


def gates_passed(path: Floats, gates: Floats) -> NDArray[np.int64]:
    """Number of gates passed in order at each point of a path (S + 1,)."""
    passed = np.zeros(len(path), np.int64)
    start = 0
    for number, (a, b) in enumerate(gates, 1):
        touches = np.flatnonzero(_distance(path[start:], a, b) <= RADIUS)
        if not len(touches):
            break
        start += int(touches[0])
        passed[start:] = number
    return passed


def _distance(points: Floats, a: Floats, b: Floats) -> Floats:
    """Distances (n,) of points (n, 2) from a segment."""
    along = b - a
    share = np.clip((points - a) @ along / (along @ along), 0.0, 1.0)
    found: Floats = np.hypot(*(points - a - share[:, None] * along).T)
    return found


def _turn(heading: Floats) -> Floats:
    """Change of heading [rad] in the step before (S + 1,)."""
    change = np.diff(heading, prepend=heading[:1])
    found: Floats = (change + np.pi) % (2 * np.pi) - np.pi
    return found


def _direction(pose: Floats, pushed: bool) -> Floats:
    """Unit direction of motion (S + 1, 2): the heading, or if it has none (`pushed`) the path."""
    if not pushed:
        return np.stack((np.cos(pose[:, 2]), np.sin(pose[:, 2])), axis=1)
    moved = np.diff(pose[:, :2], axis=0, prepend=pose[:1, :2])
    found: Floats = moved / np.maximum(np.hypot(*moved.T), 1e-9)[:, None]
    return found
