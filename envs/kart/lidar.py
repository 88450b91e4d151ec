"""Observation of a kart: its LIDAR, and the named components, each in [-1, 1]."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.track import Track
from spikedeploy.envs.kart.world import KartState

FloatArray = NDArray[np.float64]

_FULL = math.tau
_CLOSE = 1e-9  # relative extension of each wall, so that no ray passes through a corner
_FLAT = 1e-12  # determinant that replaces 0 where ray and wall are parallel [px]


@dataclass(frozen=True)
class LidarOptions:
    """Parameters of a LIDAR.

    count    number of rays R
    field    field of view [rad]; below a full circle it is centred on `facing`, with an odd count
    range    largest distance measured [px]
    noise    standard deviation of a distance [px]
    dropout  probability that a ray returns the range
    facing   direction of a full circle's first ray [rad], 0 straight ahead, clockwise
    """

    count: int = 24
    field: float = _FULL
    range: float = 350.0
    noise: float = 0.0
    dropout: float = 0.0
    facing: float = 0.0

    def __post_init__(self) -> None:
        _bounds("count", self.count, 1, 1000)
        _bounds("field", self.field, 0.0, _FULL)
        _bounds("range", self.range, 1.0, 10_000.0)
        _bounds("noise", self.noise, 0.0, 1000.0)
        _bounds("dropout", self.dropout, 0.0, 1.0)
        _bounds("facing", self.facing, -_FULL, _FULL)
        if self.count != int(self.count):
            raise EnvError(f"option lidar.count: {self.count!r} is not a whole number")
        if self.field < _FULL and self.count % 2 == 0:
            raise EnvError(
                f"option lidar.count: {self.count} rays in less than a full circle have none in "
                f"the middle; choose {self.count + 1}"
            )

    @classmethod
    def of(cls, changes: Mapping[str, Any], **defaults: Any) -> LidarOptions:  # noqa: ANN401
        """The defaults with changes by name."""
        known = [field.name for field in fields(cls)]
        for name in changes:
            if name not in known:
                raise EnvError(f"option lidar.{name} is unknown; known: {', '.join(known)}")
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

    options  its parameters
    angles   (R,) directions of the rays from straight ahead [rad]
    range    largest distance measured [px]
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


def _bounds(name: str, value: object, lowest: float, highest: float) -> None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not lowest <= value <= highest:  # type: ignore[operator]
        raise EnvError(
            f"option lidar.{name}: {value!r} is not a number from {lowest:g} to {highest:g}"
        )


_SIZES = {  # of every component except the LIDAR's
    "position": 2,
    "velocity": 2,
    "heading": 2,
    "gate": 3,
    "progress": 1,
    "speed": 1,
}
_CLASSIC_BOX = 54.0, 81.0, 990.0, 958.0  # left, top, right, bottom [px] on every track
CLASSIC_RAYS = 59  # 60 were asked for


class _ObservedKart(Protocol):
    """Part of KartEnv that an Observer reads."""

    lidar: Lidar
    track: Track

    @property
    def CLASSIC_SPEED(self) -> float:  # noqa: N802 - a constant of the class
        """Speed observed as +1 [px/s]."""

    def observed_velocity(self, state: KartState) -> tuple[float, float]:
        """The two numbers of the velocity component, about +-1."""

    def progress_at(self, state: KartState) -> float:
        """Completed share of the path from the start, in [0, 1]."""


class Observer:
    """Assembles the observation of a kart.

    columns  name -> slice of the observation
    size     length of the observation
    """

    def __init__(self, kart: _ObservedKart, names: Sequence[str], classic: bool) -> None:
        known = ["lidar", *_SIZES]
        for name in names:
            if name not in known:
                raise EnvError(f"observe: unknown component {name!r}; known: {', '.join(known)}")
        if len(set(names)) != len(names) or not names:
            raise EnvError(f"observe: {', '.join(names) or 'nothing'}: name each component once")
        self._classic, self.columns = classic, _columns(names, len(kart.lidar.angles))
        self.size = max(place.stop for place in self.columns.values())

    def __call__(self, kart: _ObservedKart, state: KartState, scan: FloatArray) -> FloatArray:
        """The observation (obs,) of a state in which the LIDAR measured `scan` (R,) [px]."""
        values = np.empty(self.size)
        for name, place in self.columns.items():
            lidar = name == "lidar"
            values[place] = self._lidar(kart, scan) if lidar else self._part(kart, state, name)
        # np.maximum and np.minimum take a third of the time of np.clip
        np.maximum(values, -1.0, out=values)
        np.minimum(values, 1.0, out=values)
        return values

    def _lidar(self, kart: _ObservedKart, scan: FloatArray) -> FloatArray:
        """+1 for a wall at the kart's centre, -1 for none within range."""
        reach = kart.lidar.range
        if not self._classic:
            return 1.0 - scan * (2.0 / reach)
        # rays without a hit, or with one in the last 2 px, count as range + range / 600, as in
        # kart-simulator, which adds the range in metres over 6 to a length in px
        most = reach + reach / 600.0
        length = np.where(scan > reach - 2.0, most, scan)
        return 1.0 - length * (2.0 / most)

    def _part(
        self, kart: _ObservedKart, state: KartState, name: str
    ) -> Sequence[float] | FloatArray:
        if name == "heading":
            return math.cos(state.heading), math.sin(state.heading)
        if name == "velocity":
            return kart.observed_velocity(state)
        if name == "speed":
            speed = math.hypot(*state.velocity)
            return (2.0 * speed / kart.CLASSIC_SPEED - 1.0,)
        if name == "position":
            left, top, right, bottom = _CLASSIC_BOX if self._classic else kart.track.box
            across, down = (state.x - left) / (right - left), (state.y - top) / (bottom - top)
            return 2.0 * across - 1.0, 2.0 * down - 1.0
        if name == "progress":
            return (2.0 * kart.progress_at(state) - 1.0,)
        return self._gate(kart, state)

    def _gate(self, kart: _ObservedKart, state: KartState) -> Sequence[float]:
        """Cosine and sine of the next gate's bearing from the heading, and its distance."""
        middles = kart.track.midpoints
        x, y = middles[min(state.next_gate, len(middles) - 1)]
        bearing = math.atan2(y - state.y, x - state.x) - state.heading
        distance = math.hypot(x - state.x, y - state.y)
        return math.cos(bearing), math.sin(bearing), 1.0 - 2.0 * distance / kart.lidar.range


def _columns(names: Sequence[str], rays: int) -> dict[str, slice]:
    columns, end = {}, 0
    for name in names:
        size = rays if name == "lidar" else _SIZES[name]
        columns[name] = slice(end, end + size)
        end += size
    return columns
