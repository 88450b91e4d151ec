"""Kinematics of the hexapod's legs: joint angles to feet, and back.

Lengths and hips are those of hexapod.xml. In the plane of a leg, x outward and z up:

    reach  r = 0.052 + 0.066 cos(f) + 0.133 cos(f + t)
    height z = 0.066 sin(f) + 0.133 sin(f + t)

with femur f and tibia t; the coxa turns the plane about the vertical axis, forward where positive.
"""

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.hexapod.robot import STANCE

FloatArray = NDArray[np.float64]

_COXA, _FEMUR, _TIBIA = 0.052, 0.066, 0.133  # [m]
# (6, 2) [m] of the torso's frame, and the direction outward [rad] where the coxa is 0; RF to LR
HIPS = np.array(
    [
        [0.124, -0.061],
        [0.0, -0.103],
        [-0.124, -0.061],
        [0.124, 0.061],
        [0.0, 0.103],
        [-0.124, 0.061],
    ]
)
_OUTWARD = np.radians([-45.0, -90.0, -135.0, 45.0, 90.0, 135.0])
_FORWARD = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])  # sense of a coxa about the vertical axis


def feet(joints: FloatArray) -> FloatArray:
    """Feet (..., 6, 3) [m] in the torso's frame for joint angles (..., 18) [rad]."""
    coxa, femur, tibia = np.moveaxis(joints.reshape(*joints.shape[:-1], 6, 3), -1, 0)
    reach = _COXA + _FEMUR * np.cos(femur) + _TIBIA * np.cos(femur + tibia)
    height = _FEMUR * np.sin(femur) + _TIBIA * np.sin(femur + tibia)
    turned = _OUTWARD + _FORWARD * coxa
    x, y = HIPS.T
    return np.stack([x + reach * np.cos(turned), y + reach * np.sin(turned), height], -1)


def joints(points: FloatArray) -> FloatArray:
    """Joint angles (..., 18) [rad] that bring the feet to points (..., 6, 3) [m], or nearest."""
    offset = points[..., :2] - HIPS
    turned = np.arctan2(offset[..., 1], offset[..., 0]) - _OUTWARD
    coxa = _FORWARD * ((turned + np.pi) % (2 * np.pi) - np.pi)
    reach, height = np.hypot(offset[..., 0], offset[..., 1]) - _COXA, points[..., 2]
    far = np.clip(np.hypot(reach, height), abs(_FEMUR - _TIBIA) + 1e-6, _FEMUR + _TIBIA - 1e-6)
    # law of cosines
    knee = np.arccos((far**2 - _FEMUR**2 - _TIBIA**2) / (2 * _FEMUR * _TIBIA))
    lift = np.arccos((_FEMUR**2 + far**2 - _TIBIA**2) / (2 * _FEMUR * far))
    found = np.stack([coxa, np.arctan2(height, reach) + lift, -knee], -1)
    return found.reshape(*found.shape[:-2], 18)


STANDING: FloatArray = feet(STANCE)  # (6, 3) [m]
NEUTRAL: FloatArray = STANDING[:, :2]  # footholds of the stance
