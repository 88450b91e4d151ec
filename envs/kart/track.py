"""A track: walls, gates in order, and a start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
RADIUS = 19.2  # [px] of a kart, for which all tracks are drawn


@dataclass(frozen=True, eq=False)
class Track:
    """A track; y points down, 100 px are 1 m.

    name       of the track
    walls      (W, 2, 2) segments that a kart must not touch [px]
    gates      (G, 2, 2) segments to pass in this order [px]; the last is the finish
    start      (2,) centre of the start positions [px]
    spread     start positions are drawn uniformly within this distance on both axes [px]
    heading    (lowest, highest) at the start [rad], 0 to the right, clockwise
    sway       largest shift of the finish along y at a reset, either way [px]
    polylines  whose segments are the walls, each (points, 2) [px]
    """

    name: str
    walls: FloatArray
    gates: FloatArray
    start: FloatArray
    spread: float
    heading: tuple[float, float]
    sway: float = 0.0
    polylines: tuple[FloatArray, ...] = field(default=(), repr=False)

    @cached_property
    def midpoints(self) -> tuple[tuple[float, float], ...]:
        """Midpoint of each gate, (G, 2) [px]."""
        return tuple((float(x), float(y)) for x, y in self.gates.mean(axis=1))

    @cached_property
    def rest(self) -> tuple[float, ...]:
        """(G,) length of the path from each gate's midpoint through the later ones [px]."""
        legs = np.hypot(*np.diff(np.array(self.midpoints), axis=0).T)
        return (*np.cumsum(legs[::-1])[::-1].tolist(), 0.0)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the walls [px]."""
        points = self.walls.reshape(-1, 2)
        (left, top), (right, bottom) = points.min(axis=0), points.max(axis=0)
        return float(left), float(top), float(right), float(bottom)

    @cached_property
    def length(self) -> float:
        """Length of the path from the centre of the start through all gates [px]."""
        return self.remaining(float(self.start[0]), float(self.start[1]), 0)

    def remaining(self, x: float, y: float, next_gate: int) -> float:
        """Length of the path from (x, y) through the midpoints of the remaining gates [px]."""
        if next_gate >= len(self.midpoints):
            return 0.0
        gx, gy = self.midpoints[next_gate]
        dx, dy = gx - x, gy - y
        return float((dx * dx + dy * dy) ** 0.5) + self.rest[next_gate]

    def swayed(self, rng: np.random.Generator) -> Track:
        """The track with its finish shifted at random, as at a reset."""
        gates = self.gates.copy()
        gates[-1, :, 1] += rng.uniform(-self.sway, self.sway)
        return replace(self, gates=gates)


def segments(polylines: Sequence[FloatArray]) -> FloatArray:
    """Segments (W, 2, 2) between consecutive points of polylines."""
    return np.concatenate([np.stack((line[:-1], line[1:]), axis=1) for line in polylines])
