"""Checks: whether what was computed in a hurry may be believed."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from runtime.bounds import Bounds, bounds, harmless, room
from runtime.chip import FixedPoint
from runtime.program import Layer, Program
from runtime.raster import Raster

Floats = NDArray[np.floating]


class Checks:
    """Whether the fast way may be believed.

    What the bounds prove costs nothing; where they leave something open, it may be that so few
    spikes cannot do it; else the states are looked at, all at once, which may find a window
    doubtful that is not, and is quick.

    timesteps: of a window that starts from zero; None where states are kept.
    most: largest magnitude for which the number type of the states is exact, if that is less than
        the registers hold.
    """

    def __init__(
        self,
        layer: Layer,
        fixed: FixedPoint,
        limits: Bounds,
        timesteps: int | None,
        most: int | None,
    ) -> None:
        current, membrane = room(fixed.current), room(fixed.membrane)
        self._room = min(current, membrane) if most is None else min(current, membrane, most)
        self._push = float(layer.voltage_bias.max(initial=0))
        self._open = limits.current > self._room or max(limits.above, limits.below) > self._room
        self._open_above = limits.above > self._room
        pushed = min(limits.current, current) + np.abs(layer.voltage_bias).max(initial=0)
        # refractory, and accumulators and pushes that overflow, are left to the interpreter
        self._never = (
            fixed.refractory > 1
            or limits.drive > room(fixed.accumulator)
            or pushed > room(fixed.push)
        )
        self._harmless = -1
        if timesteps is not None:
            self._harmless = harmless(layer, fixed, timesteps, self._room)

    @property
    def proven(self) -> bool:
        """Whether there is nothing to look at."""
        return not (self._never or self._open)

    def passed(self, states: Floats, arriving: Sequence[Raster]) -> bool:
        """Whether no register overflowed on the way to these states."""
        if self._never or not self._open:
            return not self._never
        if self._harmless >= 0 and sum([raster.spikes() for raster in arriving]) <= self._harmless:
            return True
        # what max() and min() do, without their detour through Python
        highest = float(np.maximum.reduce(states, axis=None))
        lowest = float(np.minimum.reduce(states, axis=None))
        if self._open_above:
            # a membrane before its reset is not kept, but cannot have been higher than this: what
            # the one before left, and the current
            highest = 2 * max(highest, 0.0) + self._push
        return -self._room <= lowest and highest <= self._room


def proven(program: Program, layer: Layer, fixed: FixedPoint, timesteps: int) -> bool:
    """Whether no spikes in a window from zero can make a number of the layer that does not fit."""
    limits = bounds(program, layer, fixed, timesteps)
    return Checks(layer, fixed, limits, timesteps, None).proven
