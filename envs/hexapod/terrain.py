"""Rough ground: a height field of random bumps, drawn anew for every episode."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

_CELL = 0.05  # [m] spacing of the height samples
CEILING = 0.1  # [m] height of the value 1 in MuJoCo's height field
BASE = 0.2  # [m] thickness of the ground below its lowest point
_SPACING = 5  # [cells] spacing of the lattice of bumps, 25 cm
_PATCH = 3  # [cells] half width of the patch whose mean is the local ground
_CLEARING = (0.25, 0.5)  # [m] flat within the first radius of the start, rough beyond the second


@dataclass(frozen=True)
class Field:
    """Size of the ground.

    length  [m] along x
    width   [m] along y
    start   [m] (x, y) of the robot at reset; the field is centred on the origin
    """

    length: float
    width: float
    start: tuple[float, float]

    @property
    def shape(self) -> tuple[int, int]:
        """(rows along y, columns along x)."""
        return round(self.width / _CELL) + 1, round(self.length / _CELL) + 1


class Terrain:
    """The ground of one model.

    height  (rows, columns) [m] in this episode
    mean    (rows, columns) [m] averaged over a patch of 35 cm around each sample
    """

    def __init__(self, field: Field, model: mujoco.MjModel) -> None:
        self.field = field
        rows, columns = field.shape
        self._heights = model.hfield_data.reshape(rows, columns)
        y = np.linspace(-field.width / 2, field.width / 2, rows)[:, None]
        x = np.linspace(-field.length / 2, field.length / 2, columns)[None, :]
        near, far = _CLEARING
        distance = np.hypot(x - field.start[0], y - field.start[1])
        self._rough = np.clip((distance - near) / (far - near), 0.0, 1.0)
        self.height: NDArray[np.float64] = np.zeros((rows, columns))
        self.mean: NDArray[np.float64] = np.zeros((rows, columns))

    def roughen(self, bump: float, rng: np.random.Generator) -> None:
        """Draw new ground with bumps of up to `bump` [m]."""
        noise = _bumps(self.field.shape, rng)
        lowest = noise.min()
        # height = bump (noise - min) / (max - min), fading to the middle height at the start
        level = (noise - lowest) / (noise.max() - lowest)
        self.height = bump * (0.5 + self._rough * (level - 0.5))
        self.mean = _box_mean(self.height, _PATCH)
        self._heights[:] = self.height / CEILING

    def ground(self, x: float, y: float) -> float:
        """Mean height of the ground around a point [m], bilinear, constant beyond the edge."""
        rows, columns = self.mean.shape
        u = min(max((x + self.field.length / 2) / _CELL, 0.0), columns - 1.001)
        v = min(max((y + self.field.width / 2) / _CELL, 0.0), rows - 1.001)
        i, j = math.floor(v), math.floor(u)
        v, u = v - i, u - j
        item = self.mean.item
        low = (1.0 - u) * item(i, j) + u * item(i, j + 1)
        high = (1.0 - u) * item(i + 1, j) + u * item(i + 1, j + 1)
        height: float = (1.0 - v) * low + v * high
        return height


def _bumps(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float64]:
    """Random heights on a lattice of 25 cm, interpolated to every sample and smoothed."""
    rows, columns = shape
    lattice = rng.random((rows // _SPACING + 2, columns // _SPACING + 2))
    fine = _blur(_stretch(_stretch(lattice).T).T)
    return fine[:rows, :columns]


def _stretch(lattice: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear interpolation along the first axis, SPACING samples from one row to the next."""
    weight = np.arange(_SPACING)[None, :, None] / _SPACING
    between = lattice[:-1, None] * (1.0 - weight) + lattice[1:, None] * weight
    return between.reshape(-1, lattice.shape[1])


def _blur(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Binomial blur (1, 2, 1)/4 along both axes."""
    for axis in (0, 1):
        neighbours = np.roll(height, 1, axis) + np.roll(height, -1, axis)
        height = 0.5 * height + 0.25 * neighbours
    return height


def _box_mean(height: NDArray[np.float64], half: int) -> NDArray[np.float64]:
    """Mean over a square of 2 half + 1 samples, edges repeated."""
    side = 2 * half + 1
    padded = np.pad(height, half, mode="edge")
    total = np.pad(padded.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    square = (
        total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]
    )
    mean: NDArray[np.float64] = square / side**2
    return mean
