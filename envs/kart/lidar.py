"""The LIDAR of a kart: its options, and distances to walls."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import EnvError

FloatArray = NDArray[np.float64]

_FULL = math.tau
_CLOSE = 1e-9  # relative extension of each wall, so that no ray passes through a corner
_FLAT = 1e-12  # determinant that replaces 0 where ray and wall are parallel [px]


_BOUNDS = {  # of LidarOptions
    "count": (1, 1000),
    "field": (0.0, _FULL),
    "range": (1.0, 10_000.0),
    "noise": (0.0, 1000.0),
    "dropout": (0.0, 1.0),
    "facing": (-_FULL, _FULL),
}


@dataclass(frozen=True)
class LidarOptions:
    """Parameters of a LIDAR.

    count: number of rays R
    field: field of view [rad]; below a full circle it is centred on `facing`, with an odd count
    range: largest distance measured [px]
    noise: standard deviation of a distance [px]
    dropout: probability that a ray returns the range
    facing: direction of a full circle's first ray [rad], 0 straight ahead, clockwise
    """

    count: int = 24
    field: float = _FULL
    range: float = 350.0
    noise: float = 0.0
    dropout: float = 0.0
    facing: float = 0.0

    def __post_init__(self) -> None:
        for name, (lowest, highest) in _BOUNDS.items():
            found: Any = getattr(self, name)
            number = isinstance(found, (int, float)) and not isinstance(found, bool)
            if not number or not lowest <= found <= highest:
                bounds = f"a number from {lowest:g} to {highest:g}"
                raise EnvError(f"option lidar.{name}: {found!r} is not {bounds}")
        if self.count != int(self.count):
            raise EnvError(f"option lidar.count: {self.count!r} is not a whole number")
        if self.field < _FULL and self.count % 2 == 0:
            raise EnvError(
                f"option lidar.count: {self.count} rays in less than a full circle have none in "
                f"the middle; choose {self.count + 1}"
            )

    @classmethod
    def with_changes(cls, changes: Mapping[str, Any], **defaults: Any) -> LidarOptions:  # noqa: ANN401
        """Return the defaults with changes by name."""
        if unknown := [name for name in changes if name not in _BOUNDS]:
            known = ", ".join(_BOUNDS)
            raise EnvError(f"option lidar.{unknown[0]} is unknown; known: {known}")
        return cls(**{**defaults, **changes})

    @property
    def angles(self) -> FloatArray:
        """Directions of the rays (R,) from straight ahead [rad], clockwise."""
        if self.field >= _FULL:
            return self.facing + _FULL * np.arange(self.count) / self.count
        half = self.field / 2 if self.count > 1 else 0.0
        return self.facing + np.linspace(-half, half, self.count)


class Lidar:
    """A LIDAR among walls, which set_walls gives it.

    options: its parameters
    angles: (R,) directions of the rays from straight ahead [rad]
    range: largest distance measured [px]
    """

    def __init__(self, options: LidarOptions) -> None:
        self.options = options
        self.angles = options.angles
        self.range = float(options.range)
        # (R, 2): ray directions at heading 0, and the same turned by 90 degrees; those of any
        # heading are a combination of the two
        cosine, sine = np.cos(self.angles), np.sin(self.angles)
        self._ahead, self._beside = np.stack((cosine, sine), 1), np.stack((-sine, cosine), 1)

    def set_walls(self, walls: FloatArray) -> None:
        """Measure distances to these walls (W, 2, 2) [px] from now on."""
        start, along = walls[:, 0], walls[:, 1] - walls[:, 0]
        self._across = np.ascontiguousarray(np.stack((along[:, 1], -along[:, 0])))  # (2, W)
        self._offset = (start * self._across.T).sum(axis=1)  # (W,)
        self._turned = np.ascontiguousarray(np.stack((-start[:, 1], start[:, 0])))  # (2, W)

    def distances(self, x: float, y: float, heading: float) -> FloatArray:
        """Distances (R,) [px] from a position [px] and heading [rad]; the range without a hit."""
        rays = math.cos(heading) * self._ahead + math.sin(heading) * self._beside
        # p + t ray = start + u along;  [a, b] = ax by - ay bx
        # t = [start - p, along] / [ray, along],  u = [start - p, ray] / [ray, along]
        determinant = rays @ self._across
        determinant[determinant == 0.0] = _FLAT
        distance = (self._offset - np.array((x, y)) @ self._across) / determinant
        share = rays @ (self._turned - np.array(((-y,), (x,))))
        share /= determinant
        share -= 0.5
        missed = (np.abs(share) > 0.5 + _CLOSE) | (distance < 0.0)
        distance[missed] = self.range
        # what min() does, without its detour through Python
        nearest: FloatArray = np.minimum.reduce(distance, axis=1, initial=self.range)
        return nearest

    def measure(self, x: float, y: float, heading: float, rng: np.random.Generator) -> FloatArray:
        """Distances (R,) [px] with the sensor's noise and dropouts."""
        distance = self.distances(x, y, heading)
        if self.options.noise:
            distance += rng.normal(0.0, self.options.noise, len(distance))
            distance = np.minimum(np.maximum(distance, 0.0), self.range)
        if self.options.dropout:
            distance[rng.random(len(distance)) < self.options.dropout] = self.range
        return distance
