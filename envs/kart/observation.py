"""What a kart observes: named components, each in [-1, 1]."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError

if TYPE_CHECKING:
    from spikedeploy.envs.kart.ends import KartState
    from spikedeploy.envs.kart.env import KartEnv

FloatArray = NDArray[np.float64]

SIZES = {  # of every component but the LIDAR's
    "position": 2,
    "velocity": 2,
    "heading": 2,
    "gate": 3,
    "progress": 1,
    "speed": 1,
}
CLASSIC_BOX = 54.0, 81.0, 990.0, 958.0  # left, top, right, bottom [px] on every track
CLASSIC_RAYS = 59  # 60 were asked for


class Observer:
    """Puts observations together.

    columns  name -> place in the observation
    size     numbers in all
    """

    def __init__(self, kart: KartEnv, names: Sequence[str], classic: bool) -> None:
        known = ["lidar", *SIZES]
        for name in names:
            if name not in known:
                raise EnvError(f"observe: unknown component {name!r}; known: {', '.join(known)}")
        if len(set(names)) != len(names) or not names:
            raise EnvError(f"observe: {', '.join(names) or 'nothing'}: name each component once")
        self._classic, self.columns = classic, _columns(names, len(kart.lidar.angles))
        self.size = max(place.stop for place in self.columns.values())

    def __call__(self, kart: KartEnv, at: KartState, scan: FloatArray) -> FloatArray:
        """The observation (obs,) of a situation in which the LIDAR measured `scan` (R,)."""
        values = np.empty(self.size)
        for name, place in self.columns.items():
            lidar = name == "lidar"
            values[place] = self._lidar(kart, scan) if lidar else self._part(kart, at, name)
        # a maximum and a minimum do what np.clip does in a third of the time
        np.maximum(values, -1.0, out=values)
        np.minimum(values, 1.0, out=values)
        return values

    def _lidar(self, kart: KartEnv, scan: FloatArray) -> FloatArray:
        """+1 for a wall at the kart's centre, -1 for none within range."""
        reach = kart.lidar.range
        if not self._classic:
            return 1.0 - scan * (2.0 / reach)
        # what is not hit, or hit in the last 2 px, counts as range + range / 6 m, a number without
        # a unit that the seed adds to pixels
        most = reach + reach / 600.0
        length = np.where(scan > reach - 2.0, most, scan)
        return 1.0 - length * (2.0 / most)

    def _part(self, kart: KartEnv, at: KartState, name: str) -> Sequence[float] | FloatArray:
        if name == "heading":
            return math.cos(at.heading), math.sin(at.heading)
        if name == "velocity":
            return kart.observed_velocity(at)
        if name == "speed":
            speed = math.hypot(*at.velocity)
            return (2.0 * speed / kart.CLASSIC_SPEED - 1.0,)
        if name == "position":
            left, top, right, bottom = CLASSIC_BOX if self._classic else kart.track.box
            across, down = (at.x - left) / (right - left), (at.y - top) / (bottom - top)
            return 2.0 * across - 1.0, 2.0 * down - 1.0
        if name == "progress":
            return (2.0 * kart.progress_at(at) - 1.0,)
        return self._gate(kart, at)

    def _gate(self, kart: KartEnv, at: KartState) -> Sequence[float]:
        """Cosine and sine of the next gate's bearing from the heading, and its distance."""
        middles = kart.track.midpoints
        x, y = middles[min(at.next_gate, len(middles) - 1)]
        bearing = math.atan2(y - at.y, x - at.x) - at.heading
        distance = math.hypot(x - at.x, y - at.y)
        return math.cos(bearing), math.sin(bearing), 1.0 - 2.0 * distance / kart.lidar.range


def _columns(names: Sequence[str], rays: int) -> dict[str, slice]:
    columns, end = {}, 0
    for name in names:
        size = rays if name == "lidar" else SIZES[name]
        columns[name] = slice(end, end + size)
        end += size
    return columns
