"""Advancing: the neurons of a layer from timestep to timestep, in few NumPy calls."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Layer, Program
from spikedeploy.runtime.families.cuba.bounds import exact_ticks

Floats = NDArray[np.floating]
Bits = NDArray[np.bool_]

# from so many neurons on two calls without a branch beat putmask
WIDE = 4096


class NeuronUpdate:
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
        self._drive, self._currents = drive, states[1:, 0]
        # where nothing stays of a current, it is what arrives, and only the membrane decays
        self._first = 0 if layer.current_decay.any() else 1
        # (2, 1, N): one multiplication decays currents and membranes
        keep = np.stack([layer.current_decay, layer.membrane_decay])[self._first :, None]
        self._keep = (keep / float(fixed.decay_one if fixed else 1)).astype(states.dtype)
        # arrays of one shape take NumPy's shortest way; a (N,) beside a (1, N) costs half a us more
        shape = spikes[0].shape
        self._threshold = np.broadcast_to(layer.threshold.astype(states.dtype), shape).copy()
        bias = np.broadcast_to(layer.voltage_bias.astype(states.dtype), shape).copy()
        self._bias = bias if bias.any() else None
        self._kept = kept
        of = slice(self._first, 2)
        exact = exact_ticks(layer, fixed) if fixed and not kept else -1
        self._ticks = [
            (
                states[t, of],
                states[t + 1, of],
                states[t + 1, 0],
                states[t + 1, 1],
                drive[t],
                spike,
                fixed is not None and t > exact,
            )
            for t, spike in enumerate(spikes)
        ]
        self._others = np.empty_like(spikes[0])
        self._reset: Callable[[Floats, Bits, Floats], None] = np.putmask
        self._to = np.zeros(1, states.dtype)
        if program.convention.reset == "subtract":
            self._reset, self._to = _subtract, self._threshold
        elif spikes[0].size >= WIDE and fixed:
            self._reset = self._silence

    def __call__(self) -> None:
        """Fill `states` and `spikes`."""
        self.run(slice(None))
        self.finish()

    def run(self, rows: slice) -> None:
        """The same for some of the timesteps; all of those before must have run."""
        # names of the function are found faster than those of the module
        multiply, trunc, add, greater = np.multiply, np.trunc, np.add, np.greater
        keep, threshold, bias, remembers = self._keep, self._threshold, self._bias, not self._first
        reset, to = self._reset, self._to
        resting = not self._kept and not rows.start
        for before, after, current, membrane, drive, fired, rounded in self._ticks[rows]:
            if resting:
                # from zero, both states become what arrives
                np.copyto(after, drive)
                resting = False
            else:
                multiply(before, keep, after)
                if rounded:
                    trunc(after, after)
                if remembers:
                    add(current, drive, current)
                    add(membrane, current, membrane)
                else:
                    add(membrane, drive, membrane)
            if bias is not None:
                add(membrane, bias, membrane)
            greater(membrane, threshold, fired)
            reset(membrane, fired, to)

    def finish(self) -> None:
        """Note what the currents were, where nothing else needs them."""
        if self._first:
            np.copyto(self._currents, self._drive)

    def _silence(self, membrane: Floats, fired: Bits, _: Floats) -> None:
        np.logical_not(fired, self._others)
        np.multiply(membrane, self._others, membrane)


def _subtract(membrane: Floats, fired: Bits, threshold: Floats) -> None:
    np.subtract(membrane, threshold, out=membrane, where=fired)
