"""One small network for all legs, for `--set policy.copies=examples.hexapod_tiles:legs`."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from examples.hexapod_tiles.env import ACROSS, GRID, SCANS
from examples.hexapod_tiles.kinematics import NEUTRAL

_LEFT = np.array([False, False, False, True, True, True])  # legs, RF to LR
_SECOND = np.array([False, True, False, True, False, True])  # those of the second tripod
_LANE = 2  # points of a strip to either side of a leg's foothold that it reads

# entry of the observation, number in it, sign of what a mirror shows
_POSE = (
    ("gravity", 0, 1),
    ("gravity", 1, -1),
    ("heading", 0, -1),
    ("velocity", 0, 1),
    ("velocity", 1, -1),
    ("angular_velocity", 2, -1),
    ("lateral", 0, -1),
)


def legs(
    observation: Mapping[str, slice],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return which observations each leg reads (6, F), their signs (6, F), and its actions (6, 3).

    Left legs read what a mirror shows, and legs of the second tripod half a period later: one
    network serves all. A leg reads the pose of the body, its own joints, and its own part of the
    scan: the points about its foothold, or of the strip ahead and of earlier rows those that come
    to lie there.

    observation: name of each entry -> its slice
    """

    def columns(name: str, *places: int) -> NDArray[np.int64]:
        return np.array([observation[name].start + place for place in places])

    pose = [columns(name, place) for name, place, _ in _POSE]
    places = [observation[name] for name in ("scan", "earlier") if name in observation]
    scans = [np.arange(place.start, place.stop) for place in places]
    inputs, signs = [], []
    for leg in range(6):
        own = [columns(name, 3 * leg, 3 * leg + 1, 3 * leg + 2) for name in ("joints", "previous")]
        lanes = [_lane(scan, leg) for scan in scans]
        points = [(lane[:, ::-1] if _LEFT[leg] else lane).ravel() for lane in lanes]
        read = np.concatenate(
            [columns("phase", 0, 1), *pose, *own, columns("contact", leg), *points]
        )
        sign = np.ones(len(read), np.int64)
        sign[:2] = -1 if _SECOND[leg] else 1
        if _LEFT[leg]:
            sign[2 : 2 + len(_POSE)] = [mirrored for *_, mirrored in _POSE]
        inputs.append(read)
        signs.append(sign)
    return np.stack(inputs), np.stack(signs), np.arange(18).reshape(6, 3)


def _lane(scan: NDArray[np.int64], leg: int) -> NDArray[np.int64]:
    """Return the points (along, across) of a scan, or of rows of a strip, that a leg reads."""
    if len(scan) == len(SCANS["around"]):
        points: NDArray[np.int64] = scan.reshape(6, *GRID)[leg]
        return points
    across = np.abs(SCANS["ahead"][:, 1].reshape(-1, ACROSS)[0] - NEUTRAL[leg, 1]).argmin()
    return scan.reshape(-1, ACROSS)[:, across - _LANE : across + _LANE + 1]
