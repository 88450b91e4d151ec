"""The kernels: a layer's whole window of timesteps in few NumPy calls, equal to the interpreter.

States are float64, which holds 24-bit states and their products with 12-bit decays exactly, and
needs two calls where integers need five: trunc(x * keep) is the decay toward zero. Where decays are
short, float32 does the same for smaller states, and is tried first. Nothing is checked for overflow
on the way: either the bounds prove that nothing can overflow, or so few spikes, or the states are
looked at afterwards, and the rare window that did overflow is interpreted once more.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from runtime.advance import Advance
from runtime.bounds import Bounds, bounds, single
from runtime.checks import Checks
from runtime.chip import FixedPoint
from runtime.interpreter import State, update
from runtime.program import Layer, Program
from runtime.raster import Raster
from runtime.scratch import Scratch, aligned
from runtime.synapses import summing

Floats = NDArray[np.floating]

# copies from which on the numbers, and not the calls, take the time
MANY = 4


class Window:
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

    def _checked(self, dtype: type[np.floating]) -> Checks | None:
        """What tells whether states of this type may be believed; None where nothing is rounded."""
        fixed = self.program.chip.fixed
        if not fixed or not self._limits:
            return None
        window = None if self.kept else len(self.spikes)
        most = single(self.layer, fixed) if dtype == np.float32 else None
        return Checks(self.layer, fixed, self._limits, window, most)

    def _prepare(self, dtype: type[np.floating]) -> None:
        """Memory for states of this type, and what runs in it."""
        program, layer, fixed = self.program, self.layer, self.program.chip.fixed
        timesteps, batch, _ = self.spikes.shape
        self.states = aligned((timesteps + 1, 2, batch, layer.size), dtype)
        sums = aligned((timesteps, batch, layer.size), dtype)
        self._drive = Drive(layer, fixed, self._limits, sums, self._scratch)
        self._advance = Advance(
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
