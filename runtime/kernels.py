"""The kernels: a layer's whole window of timesteps in few NumPy calls, equal to the interpreter.

States are float64, which holds 24-bit states and their products with 12-bit decays exactly, and
needs two calls where integers need five: trunc(x * keep) is the decay toward zero. Nothing is
checked for overflow on the way: either the bounds prove that nothing can overflow, or the states
are looked at afterwards, and the rare window that did overflow is interpreted once more.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from runtime.bounds import Bounds, bounds, room
from runtime.chip import FixedPoint
from runtime.interpreter import State, update
from runtime.program import Layer, Program
from runtime.synapses import Raster, summing

Floats = NDArray[np.float64]
Bits = NDArray[np.bool_]

# from so many neurons on copyto beats putmask
WIDE = 4096


class Window:
    """One layer, ready to run windows of T timesteps for a batch of B, in the same memory.

    states: (T + 1, 2, B, N) current and membrane, before the window and after each timestep.
    spikes: (T, B, N) of the last window.
    waiting: whether the layer let the last window pass.
    interpreted: whether the interpreter had to run the last window; only then are there
    overflows: (B,) numbers that did not fit their register.
    """

    def __init__(
        self, program: Program, layer: Layer, timesteps: int, batch: int, kept: bool
    ) -> None:
        fixed = program.chip.fixed
        self.program, self.layer, self.kept = program, layer, kept
        self.states = np.zeros((timesteps + 1, 2, batch, layer.size))
        self.spikes = np.zeros((timesteps, batch, layer.size), np.bool_)
        self.overflows = np.zeros(batch, np.int64)
        self.waiting = self.interpreted = False
        self._silent = np.zeros((batch, layer.size), np.int64)
        limits = bounds(program, layer, fixed, None if kept else timesteps) if fixed else None
        self._drive = Drive(layer, fixed, limits, timesteps, batch)
        self._advance = Advance(program, layer, self.states, self._drive.sums, self.spikes, kept)
        self._checks = Checks(layer, fixed, limits) if fixed and limits else None

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
        self.waiting = False
        if self.kept:
            self.states[0] = self.states[-1]
        self._drive(arriving)
        self._advance()
        self.interpreted = self._checks is not None and not self._checks.passed(self.states)
        if self.interpreted:
            self._interpret()
        return Raster(self.spikes)

    def wait(self) -> Raster:
        """No spikes, because the layer has not started."""
        self.waiting, self.interpreted = True, False
        self.spikes.fill(False)
        return Raster(self.spikes)

    def _interpret(self) -> None:
        """The window once more, by the specification."""
        before = self.states[0].astype(np.int64)
        state = State(before[0], before[1], self._silent)
        self.overflows.fill(0)
        for row, weights in enumerate(self._drive.weights()):
            tick = update(self.program, self.layer, weights, state)
            self.states[row + 1] = state.current, state.membrane
            self.spikes[row] = tick.spikes
            self.overflows += tick.overflows.sum(axis=1)
        if self.kept:
            self._silent = state.silent


class Drive:
    """What arrives at a layer in each timestep of a window: all synapses and the bias.

    sums: (T, B, N) [state units].
    """

    def __init__(
        self,
        layer: Layer,
        fixed: FixedPoint | None,
        limits: Bounds | None,
        timesteps: int,
        batch: int,
    ) -> None:
        self.sums = np.empty((timesteps, batch, layer.size))
        self._more = np.empty_like(self.sums)
        self._unit = unit = 1 << fixed.mantissa_shift if fixed else 1
        partial = limits.partial if limits else None
        biases = [layer.bias, *[0 * layer.bias] * (len(layer.synapses) - 1)]
        self._first, *self._others = (
            summing(synapses.weight, bias, partial, unit, timesteps, batch)
            for synapses, bias in zip(layer.synapses, biases, strict=True)
        )

    def __call__(self, arriving: Sequence[Raster]) -> None:
        """Fill `sums`."""
        self._first(arriving[0], self.sums)
        for index, summed in enumerate(self._others, start=1):
            summed(arriving[index], self._more)
            np.add(self.sums, self._more, self.sums)

    def weights(self) -> NDArray[np.int64]:
        """(T, B, N) the same in weight mantissas."""
        return np.asarray(self.sums / self._unit, np.int64)


class Advance:
    """The timesteps of a window, one after another.

    kept: whether there may be a state before the first.
    """

    def __init__(
        self,
        program: Program,
        layer: Layer,
        states: Floats,
        drive: Floats,
        spikes: Bits,
        kept: bool,
    ) -> None:
        fixed = program.chip.fixed
        self._rounded = fixed is not None
        # (2, 1, N): one multiplication decays currents and membranes
        keep = np.stack([layer.current_keep, layer.membrane_keep])[:, None]
        self._keep = keep / float(fixed.decay_one if fixed else 1)
        # arrays of one shape take NumPy's shortest way; a (N,) beside a (1, N) costs half a us more
        shape = spikes[0].shape
        self._threshold = np.broadcast_to(layer.threshold.astype(np.float64), shape).copy()
        bias = np.broadcast_to(layer.voltage_bias.astype(np.float64), shape).copy()
        self._bias = bias if bias.any() else None
        self._kept = kept
        self._ticks = [
            (states[t], states[t + 1], states[t + 1, 0], states[t + 1, 1], drive[t], spikes[t])
            for t in range(len(spikes))
        ]
        self._reset: Callable[[Floats, Bits, Floats], None] = np.putmask
        self._to = np.zeros(1)
        if program.convention.reset == "subtract":
            self._reset, self._to = _subtract, self._threshold
        elif spikes[0].size >= WIDE:
            self._reset = _copy

    def __call__(self) -> None:
        """Fill `states` and `spikes`."""
        # names of the function are found faster than those of the module
        multiply, trunc, add, greater = np.multiply, np.trunc, np.add, np.greater
        keep, threshold, bias = self._keep, self._threshold, self._bias
        reset, to = self._reset, self._to
        resting = not self._kept
        for before, after, current, membrane, drive, fired in self._ticks:
            if resting:
                # from zero, both states become what arrives
                np.copyto(after, drive)
                resting = False
            else:
                multiply(before, keep, after)
                if self._rounded:
                    trunc(after, after)
                add(current, drive, current)
                add(membrane, current, membrane)
            if bias is not None:
                add(membrane, bias, membrane)
            greater(membrane, threshold, fired)
            reset(membrane, fired, to)


class Checks:
    """Whether the fast way may be believed.

    What the bounds prove costs nothing; where they leave something open, the states are looked at:
    all at once, which may find a window doubtful that is not, and is quick.
    """

    def __init__(self, layer: Layer, fixed: FixedPoint, limits: Bounds) -> None:
        current, membrane = room(fixed.current), room(fixed.membrane)
        self._room = min(current, membrane)
        self._push = float(layer.voltage_bias.max(initial=0))
        self._open = limits.current > current or max(limits.above, limits.below) > membrane
        self._open_above = limits.above > membrane
        pushed = min(limits.current, current) + np.abs(layer.voltage_bias).max(initial=0)
        # refractory, and accumulators and pushes that overflow, are left to the interpreter
        self._never = (
            fixed.refractory > 1
            or limits.drive > room(fixed.accumulator)
            or pushed > room(fixed.push)
        )

    def passed(self, states: Floats) -> bool:
        """Whether no register overflowed on the way to these states."""
        if self._never or not self._open:
            return not self._never
        # what max() and min() do, without their detour through Python
        highest = float(np.maximum.reduce(states, axis=None))
        lowest = float(np.minimum.reduce(states, axis=None))
        if self._open_above:
            # a membrane before its reset is not kept, but cannot have been higher than this: what
            # the one before left, and the current
            highest = 2 * max(highest, 0.0) + self._push
        return -self._room <= lowest and highest <= self._room


def _subtract(membrane: Floats, fired: Bits, threshold: Floats) -> None:
    np.subtract(membrane, threshold, out=membrane, where=fired)


def _copy(membrane: Floats, fired: Bits, value: Floats) -> None:
    np.copyto(membrane, value, where=fired)
