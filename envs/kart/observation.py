"""Observation of a kart: named components, each in [-1, 1]."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.lidar import Lidar
from spikedeploy.envs.kart.track import Track
from spikedeploy.envs.kart.world import KartState

FloatArray = NDArray[np.float64]

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
    """What an Observer reads from the environment of a kart, see KartEnv."""

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
