"""Observation of the hexapod: names, order and scales of the 77 values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.hexapod.robot import STANCE

FloatArray = NDArray[np.float64]

LIMIT = 10.0  # observations saturate at this magnitude, as sensors do


class ObservationEntry(NamedTuple):
    """Consecutive values of an observation; each is (measured - centre) / spread.

    name    key in the environment's OBSERVATION
    size    number of values
    centre  (size,) or one for all [unit of the measurement]
    spread  (size,) or one for all, so that values are about +-1
    """

    name: str
    size: int
    centre: Sequence[float] | FloatArray | float
    spread: Sequence[float] | FloatArray | float


BODY = (
    ObservationEntry("height", 1, 0.097, 0.03),  # [m] of the torso above the mean ground around it
    ObservationEntry("gravity", 3, 0.0, (0.3, 0.3, 1.0)),  # [1] in the body's frame
    ObservationEntry("heading", 1, 0.0, 1.0),  # [rad] from the course
    ObservationEntry("velocity", 3, 0.0, 0.5),  # [m/s] in the body's frame
    ObservationEntry("angular_velocity", 3, 0.0, 1.0),  # [rad/s] in the body's frame
    ObservationEntry("joints", 18, STANCE, 0.6),  # [rad] leg after leg: coxa, femur, tibia
    ObservationEntry("joint_velocity", 18, 0.0, 3.0),  # [rad/s]
    ObservationEntry("previous", 18, 0.0, 1.0),  # [action unit] last filtered command
    ObservationEntry("contact", 6, 0.0, 1.0),  # [1] feet on the ground
    ObservationEntry("phase", 2, 0.0, 1.0),  # [1] sine and cosine of the gait
)
COURSE = (
    ObservationEntry("speed", 1, 0.0, 0.4),  # [m/s] smoothed, along the course
    ObservationEntry("lateral", 1, 0.0, 1.0),  # [m] off the course, left positive
    ObservationEntry("lateral_velocity", 1, 0.0, 0.5),  # [m/s]
)
LOAD = ObservationEntry("load", 1, 0.0, 24.0)  # [N] all feet together


def layout(entries: Sequence[ObservationEntry]) -> dict[str, slice]:
    """Name of each entry -> its slice of the observation."""
    slices, end = {}, 0
    for entry in entries:
        slices[entry.name] = slice(end, end + entry.size)
        end += entry.size
    return slices


def scaling(entries: Sequence[ObservationEntry]) -> tuple[FloatArray, FloatArray]:
    """Centre (obs,) and spread (obs,) of every value."""
    centres = [np.broadcast_to(entry.centre, entry.size) for entry in entries]
    spreads = [np.broadcast_to(entry.spread, entry.size) for entry in entries]
    return np.concatenate(centres).astype(np.float64), np.concatenate(spreads).astype(np.float64)
