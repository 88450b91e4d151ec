"""The kernels: a layer's whole window of timesteps in few NumPy calls, equal to the interpreter.

States are float64, which holds 24-bit states and their products with 12-bit decays exactly, and
needs two calls where integers need five: trunc(x * keep) is the decay toward zero. Where decays are
short, float32 does the same for smaller states, and is tried first. Nothing is checked for overflow
on the way: either the bounds prove that nothing can overflow, or so few spikes, or the states are
looked at afterwards, and the rare window that did overflow is interpreted once more.

Checks: whether what was computed in a hurry may be believed.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import LayerState
from spikedeploy.runtime.compiler.program import Layer, Program
from spikedeploy.runtime.emulator.raster import Raster, Scratch, aligned
from spikedeploy.runtime.families.cuba.bounds import Bounds, bounds, harmless, room, single
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint
from spikedeploy.runtime.families.cuba.neurons import update
from spikedeploy.runtime.families.cuba_numpy.neuron_update import NeuronUpdate
from spikedeploy.runtime.families.cuba_numpy.sums import summing

Floats = NDArray[np.floating]


class OverflowCheck:
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
        fixed: CubaFixedPoint,
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


def proven(program: Program, layer: Layer, fixed: CubaFixedPoint, timesteps: int) -> bool:
    """Whether no spikes in a window from zero can make a number of the layer that does not fit."""
    limits = bounds(program, layer, fixed, timesteps)
    return OverflowCheck(layer, fixed, limits, timesteps, None).proven


# copies from which on the numbers, and not the calls, take the time
MANY = 4


class LayerKernel:
    """One layer, ready to run windows of T timesteps for a batch of B, in the same memory.

    states: (T + 1, 2, B, N) current and membrane, before the window and after each timestep.
    spikes: (T, B, N) of the last window.
    waiting: whether the layer let the last window pass.
    interpreted: whether the interpreter had to run the last window; only then are there
    overflows: (B,) numbers that did not fit their register.
    """

    def __init__(
        self,
        program: Program,
        layer: Layer,
        timesteps: int,
        batch: int,
        kept: bool,
        scratch: Scratch,
    ) -> None:
        fixed = program.chip.fixed
        self.program, self.layer, self.kept = program, layer, kept
        self._scratch = scratch
        self.spikes = np.zeros((timesteps, batch, layer.size), np.bool_)
        self.overflows = np.zeros(batch, np.int64)
        self.waiting = self.interpreted = False
        self._silent = np.zeros((batch, layer.size), np.int64)
        self._limits = bounds(program, layer, fixed, None if kept else timesteps) if fixed else None
        self._prepare(np.float32 if self._short() else np.float64)

    def reset(self) -> None:
        """Forget the state."""
        self.states[-1] = 0.0
        self._silent[:] = 0

    @property
    def ordinary(self) -> bool:
        """Whether the last window ran, and ran fast."""
        return not (self.waiting or self.interpreted)

    def run(self, arriving: Sequence[Raster]) -> Raster:
        """Spikes of the window, given what each synapse of the layer hears."""
        self.waiting = self.interpreted = False
        if self.kept:
            self.states[0] = self.states[-1]
        self._drive(arriving)
        self._advance()
        if self._checks is not None and not self._checks.passed(self.states, arriving):
            return self._again(arriving)
        return Raster(self.spikes)

    def wait(self) -> Raster:
        """No spikes, because the layer has not started."""
        self.waiting, self.interpreted = True, False
        self.spikes.fill(False)
        return Raster(self.spikes)

    def _short(self) -> bool:
        """Whether float32 is worth trying."""
        fixed, (_, batch, _) = self.program.chip.fixed, self.spikes.shape
        # a membrane that just spikes must be well within what float32 holds
        if not fixed or single(self.layer, fixed) <= 4 * self.layer.threshold.max():
            return False
        checks = self._checked(np.float64)
        return batch >= MANY or not (checks and checks.proven)

    def _checked(self, dtype: type[np.floating]) -> OverflowCheck | None:
        """What tells whether states of this type may be believed; None where nothing is rounded."""
        fixed = self.program.chip.fixed
        if not fixed or not self._limits:
            return None
        window = None if self.kept else len(self.spikes)
        most = single(self.layer, fixed) if dtype == np.float32 else None
        return OverflowCheck(self.layer, fixed, self._limits, window, most)

    def _prepare(self, dtype: type[np.floating]) -> None:
        """Memory for states of this type, and what runs in it."""
        program, layer, fixed = self.program, self.layer, self.program.chip.fixed
        timesteps, batch, _ = self.spikes.shape
        self.states = aligned((timesteps + 1, 2, batch, layer.size), dtype)
        sums = aligned((timesteps, batch, layer.size), dtype)
        self._drive = SynapticInput(layer, fixed, self._limits, sums, self._scratch)
        self._advance = NeuronUpdate(
            program, layer, self.states, self._drive.sums, self.spikes, self.kept
        )
        self._checks = self._checked(dtype)

    def _again(self, arriving: Sequence[Raster]) -> Raster:
        """The window in wider numbers, and from now on all; or by the specification."""
        if self.states.dtype == np.float32:
            before = self.states[0]
            self._prepare(np.float64)
            self.states[-1] = before
            self.states[0] = before
            return self.run(arriving)
        self.interpreted = True
        self._interpret()
        return Raster(self.spikes)

    def _interpret(self) -> None:
        """The window once more, by the specification."""
        before = self.states[0].astype(np.int64)
        state = LayerState(before[0], before[1], self._silent)
        self.overflows.fill(0)
        for row, weights in enumerate(self._drive.weights()):
            tick = update(
                self.program.chip.fixed, self.program.convention, self.layer, weights, state
            )
            self.states[row + 1] = state.current, state.membrane
            self.spikes[row] = tick.spikes
            self.overflows += tick.overflows.sum(axis=1)
        if self.kept:
            self._silent = state.refractory


class SynapticInput:
    """What arrives at a layer in each timestep of a window: all synapses and the bias.

    sums: (T, B, N) [state units].
    """

    def __init__(
        self,
        layer: Layer,
        fixed: CubaFixedPoint | None,
        limits: Bounds | None,
        sums: Floats,
        scratch: Scratch,
    ) -> None:
        self.sums = sums
        self._more = aligned(sums.shape, sums.dtype)
        self._unit = unit = 1 << fixed.mantissa_shift if fixed else 1
        partial = limits.partial if limits else None
        biases = [layer.bias, *[0 * layer.bias] * (len(layer.synapses) - 1)]
        self._first, *self._others = (
            summing(synapses.weight, bias, partial, unit, self._more if k else sums, scratch)
            for k, (synapses, bias) in enumerate(zip(layer.synapses, biases, strict=True))
        )

    def __call__(self, arriving: Sequence[Raster]) -> None:
        """Fill `sums`."""
        self._first(arriving[0])
        for index, summed in enumerate(self._others, start=1):
            summed(arriving[index])
            np.add(self.sums, self._more, self.sums)

    def weights(self) -> NDArray[np.int64]:
        """(T, B, N) the same in weight mantissas."""
        return np.asarray(self.sums / self._unit, np.int64)
