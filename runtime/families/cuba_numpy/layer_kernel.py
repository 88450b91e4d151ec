"""A layer's window of timesteps in few NumPy calls, equal to the interpreter.

States are float64, which holds 24-bit states and their products with 12-bit decays exactly, and
needs two calls where integers need five: trunc(x * decay) is the decay toward zero. Where decays
are short, float32 does the same for smaller states, and is tried first: a sixth faster in a large
batch (docs/performance.md). Overflow is not checked in every timestep: either the bounds prove
that no number can be too large, or that so few spikes cannot make one, or the states are looked at
afterwards. A window that did overflow, which is rare, is computed once more, in float64 or by the
interpreter.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, LayerState
from spikedeploy.runtime.chips.registers import magnitude
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import SavedState
from spikedeploy.runtime.families.cuba.bounds import (
    Bounds,
    bounds,
    register_limit,
    single,
    spikes_without_overflow,
)
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint
from spikedeploy.runtime.families.cuba.neurons import update
from spikedeploy.runtime.families.cuba_numpy.neuron_update import NeuronUpdate
from spikedeploy.runtime.families.cuba_numpy.raster import Raster, Scratch, aligned
from spikedeploy.runtime.families.cuba_numpy.sums import summing

Floats = NDArray[np.floating]


class _OverflowCheck:
    """Whether every number of a window fitted its register.

    What the bounds prove costs nothing; where they leave something open, so few spikes may not be
    able to overflow; else the largest and the smallest state are looked for, which may report an
    overflow where there was none, and is fast.

    fixed: the integers of the chip.
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
        most: int | None = None,
    ) -> None:
        self.fixed = fixed
        current, membrane = register_limit(fixed.current), register_limit(fixed.membrane)
        self._limit = min(current, membrane) if most is None else min(current, membrane, most)
        self._push = float(layer.voltage_bias.max(initial=0))
        self._open = limits.current > self._limit or max(limits.above, limits.below) > self._limit
        # membranes that no spike resets are all kept, and looked at as they are
        self._open_above = layer.spiking and limits.above > self._limit
        pushed = min(limits.current, current) + magnitude(layer.voltage_bias)
        # refractory, and accumulators and pushes that overflow, are left to the interpreter
        self._never = (
            fixed.refractory > 1
            or limits.drive > register_limit(fixed.accumulator)
            or pushed > register_limit(fixed.push)
        )
        self._safe_spikes = -1
        if timesteps is not None:
            self._safe_spikes = spikes_without_overflow(layer, fixed, timesteps, self._limit)

    @property
    def proven(self) -> bool:
        """Whether there is nothing to look at."""
        return not (self._never or self._open)

    def passed(self, states: Floats, presynaptic: Sequence[Raster]) -> bool:
        """Whether no register overflowed on the way to these states."""
        if self._never or not self._open:
            return not self._never
        if self._safe_spikes >= 0:
            spikes = sum([raster.spikes() for raster in presynaptic])
            if spikes <= self._safe_spikes:
                return True
        # what max() and min() do, without their overhead in Python
        highest = float(np.maximum.reduce(states, axis=None))
        lowest = float(np.minimum.reduce(states, axis=None))
        if self._open_above:
            # a membrane before its reset is not kept, but cannot have been higher than this: what
            # the one before left, and the current
            highest = 2 * max(highest, 0.0) + self._push
        return -self._limit <= lowest and highest <= self._limit


def proven(program: Program, layer: Layer, fixed: CubaFixedPoint, timesteps: int) -> bool:
    """Whether no spikes in a window from zero can make a number of the layer that does not fit."""
    limits = bounds(program, layer, fixed, timesteps)
    return _OverflowCheck(layer, fixed, limits, timesteps).proven


_ALL = slice(None)
# copies from which on the numbers, and not the calls, take the time
_MANY = 4


class LayerKernel:
    """One layer, ready to run windows of T timesteps for a batch of B, in the same memory.

    fixed: the integers of the chip; None computes in float64.
    biased: rows of a window in which the bias axon spikes.
    states: (T + 1, 2, B, N) current and membrane, before the window and after each timestep.
    spikes: (T, B, N) of the last window.
    waiting: whether the layer had not started in the last window.
    interpreted: whether the interpreter had to run the last window; only then are there
    overflows: (B,) numbers that did not fit their register.
    """

    def __init__(
        self,
        program: Program,
        layer: Layer,
        fixed: CubaFixedPoint | None,
        shape: tuple[int, int],
        kept: bool,
        scratch: Scratch,
        biased: slice = _ALL,
    ) -> None:
        self._program, self.layer, self._fixed = program, layer, fixed
        self._biased = biased
        self._kept, self._scratch = kept, scratch
        timesteps, batch = shape
        self.spikes = np.zeros((timesteps, batch, layer.size), np.bool_)
        self.overflows = np.zeros(batch, np.int64)
        self.waiting = self.interpreted = False
        self._refractory = np.zeros((batch, layer.size), np.int64)
        # of a window from zero, or of states that are kept
        self._window = None if kept else timesteps
        self._limits = bounds(program, layer, fixed, self._window) if fixed else None
        self._prepare(np.dtype(np.float32 if self._short() else np.float64))

    def reset(self) -> None:
        """Forget the state."""
        self.states[-1] = 0.0
        self._refractory[:] = 0

    @property
    def ordinary(self) -> bool:
        """Whether the last window ran, and not in the interpreter."""
        return not (self.waiting or self.interpreted)

    def run(self, presynaptic: Sequence[Raster]) -> Raster:
        """Spikes of the window, from those that arrive through each synapses of the layer."""
        self.waiting = self.interpreted = False
        if self._kept:
            self.states[0] = self.states[-1]
        self._input(presynaptic)
        self._update()
        if self._check is not None and not self._check.passed(self.states, presynaptic):
            return self._again(presynaptic)
        return Raster(self.spikes)

    def wait(self) -> Raster:
        """No spikes, because the layer has not started."""
        self.waiting, self.interpreted = True, False
        self.spikes.fill(False)
        return Raster(self.spikes)

    def saved(self) -> SavedState:
        """Copies of the states, and of the timesteps of refractory left."""
        return {"states": self.states[-1].copy(), "refractory": self._refractory.copy()}

    def restore(self, saved: SavedState) -> None:
        """Continue from there."""
        if saved["states"].dtype != self.states.dtype:
            self._prepare(saved["states"].dtype)
        self.states[-1] = saved["states"]
        self._refractory = saved["refractory"].copy()

    def _short(self) -> bool:
        """Whether float32 is worth trying."""
        fixed, (_, batch, _) = self._fixed, self.spikes.shape
        # a membrane that just spikes must be well within what float32 holds
        if not fixed or single(self.layer, fixed) <= 4 * self.layer.threshold.max():
            return False
        check = self._checked(np.dtype(np.float64))
        return batch >= _MANY or not (check and check.proven)

    def _checked(self, dtype: np.dtype[Any]) -> _OverflowCheck | None:
        """What looks for overflows in states of this type; None where nothing is rounded."""
        if not self._fixed or not self._limits:
            return None
        most = single(self.layer, self._fixed) if dtype == np.float32 else None
        return _OverflowCheck(self.layer, self._fixed, self._limits, self._window, most)

    def _prepare(self, dtype: np.dtype[Any]) -> None:
        """Memory for states of this type, and what runs in it."""
        layer, fixed, kept = self.layer, self._fixed, self._kept
        timesteps, batch, neurons = self.spikes.shape
        self.states = aligned((timesteps + 1, 2, batch, neurons), dtype)
        sums = aligned(self.spikes.shape, dtype)
        self._input = _SynapticInput(layer, fixed, self._limits, sums, self._biased, self._scratch)
        subtract = self._program.convention.reset == "subtract"
        self._update = NeuronUpdate(layer, fixed, self.states, sums, self.spikes, kept, subtract)
        self._check = self._checked(dtype)

    def _again(self, presynaptic: Sequence[Raster]) -> Raster:
        """The window in float64, and from now on all; or by the specification."""
        if self.states.dtype == np.float32:
            before = self.states[0]
            self._prepare(np.dtype(np.float64))
            self.states[-1] = before
            return self.run(presynaptic)
        self.interpreted = True
        if self._fixed is not None:
            self._interpret(self._fixed)
        return Raster(self.spikes)

    def _interpret(self, fixed: CubaFixedPoint) -> None:
        """The window once more, by the specification."""
        before = self.states[0].astype(np.int64)
        state = LayerState(before[0], before[1], self._refractory)
        self.overflows.fill(0)
        for row, weights in enumerate(self._input.weights()):
            result = update(fixed, self._program.convention, self.layer, weights, state)
            self.states[row + 1] = state.current, state.membrane
            self.spikes[row] = result.spikes
            self.overflows += result.overflows.sum(axis=1)
        if self._kept:
            self._refractory = state.refractory


class _SynapticInput:
    """What arrives at a layer in each timestep of a window: all synapses and the bias.

    sums: (T, B, N) [state units].
    biased: rows in which the bias axon spikes.
    """

    def __init__(
        self,
        layer: Layer,
        fixed: CubaFixedPoint | None,
        limits: Bounds | None,
        sums: Floats,
        biased: slice,
        scratch: Scratch,
    ) -> None:
        self._sums = sums
        self._more = aligned(sums.shape, sums.dtype)
        self._unit = unit = 1 << fixed.mantissa_shift if fixed else 1
        partial = limits.partial if limits else None
        biases = [_biases(layer, biased, len(sums)), *[0 * layer.bias] * (len(layer.synapses) - 1)]
        self._first, *self._others = (
            summing(synapses.weight, bias, partial, unit, self._more if k else sums, scratch)
            for k, (synapses, bias) in enumerate(zip(layer.synapses, biases, strict=True))
        )

    def __call__(self, presynaptic: Sequence[Raster]) -> None:
        """Fill `sums`."""
        self._first(presynaptic[0])
        for index, summed in enumerate(self._others, start=1):
            summed(presynaptic[index])
            np.add(self._sums, self._more, self._sums)

    def weights(self) -> NDArray[np.int64]:
        """(T, B, N) the same in weight mantissas."""
        return np.asarray(self._sums / self._unit, np.int64)


def _biases(layer: Layer, biased: slice, timesteps: int) -> NDArray[Any]:
    """Weights of the bias axon: (N,), or (T, 1, N) where it spikes in some timesteps alone."""
    if range(timesteps)[biased] == range(timesteps):
        return layer.bias
    biases = np.zeros((timesteps, 1, layer.size), layer.bias.dtype)
    biases[biased] = layer.bias
    return biases
