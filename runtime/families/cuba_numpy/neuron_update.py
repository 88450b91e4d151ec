"""The neurons of a layer from timestep to timestep, in few NumPy calls."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.families.cuba.bounds import exact_ticks
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint

Floats = NDArray[np.floating]
Bits = NDArray[np.bool_]

# from so many neurons on two calls without a branch are faster than putmask
_WIDE = 4096


class NeuronUpdate:
    """The timesteps of a window, one after another.

    drive: (T, B, N) what arrives [state units].
    kept: whether there may be a state before the first timestep.
    subtract: whether a spike takes the threshold off the membrane, and does not set it to 0.
    """

    def __init__(
        self,
        layer: Layer,
        fixed: CubaFixedPoint | None,
        states: Floats,
        drive: Floats,
        spikes: Bits,
        kept: bool,
        subtract: bool,
    ) -> None:
        self._drive, self._currents, self._kept = drive, states[1:, 0], kept
        # where nothing stays of a current, it is what arrives, and only the membrane decays
        self._first = 0 if layer.current_decay.any() else 1
        # (2, 1, N): one multiplication decays currents and membranes
        factors = np.stack([layer.current_decay, layer.membrane_decay])[self._first :, None]
        one = float(fixed.decay_one if fixed else 1)
        self._decay = (factors / one).astype(states.dtype)
        # arrays of one shape take NumPy's shortest way; a (N,) beside a (1, N) costs half a us more
        shape = spikes[0].shape
        self._threshold = np.broadcast_to(layer.threshold.astype(states.dtype), shape).copy()
        bias = np.broadcast_to(layer.voltage_bias.astype(states.dtype), shape).copy()
        self._bias = bias if bias.any() else None
        of = slice(self._first, 2)
        exact = exact_ticks(layer, fixed) if fixed and not kept else -1
        self._timesteps = [
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
        if subtract:
            self._reset, self._to = _subtract, self._threshold
        elif spikes[0].size >= _WIDE and fixed:
            self._reset = self._silence

    def __call__(self) -> None:
        """Fill `states` and `spikes`."""
        self.run(slice(None))
        self.finish()

    def run(self, rows: slice) -> None:
        """The same for some of the timesteps; all of those before must have run."""
        # names of the function are found faster than those of the module
        multiply, trunc, add, greater = np.multiply, np.trunc, np.add, np.greater
        decay, threshold, bias = self._decay, self._threshold, self._bias
        reset, to, has_current = self._reset, self._to, not self._first
        resting = not self._kept and not rows.start
        for before, after, current, membrane, drive, spikes, rounded in self._timesteps[rows]:
            if resting:
                # from zero, both states become what arrives
                np.copyto(after, drive)
                resting = False
            else:
                multiply(before, decay, after)
                if rounded:
                    trunc(after, after)
                if has_current:
                    add(current, drive, current)
                    add(membrane, current, membrane)
                else:
                    add(membrane, drive, membrane)
            if bias is not None:
                add(membrane, bias, membrane)
            greater(membrane, threshold, spikes)
            reset(membrane, spikes, to)

    def finish(self) -> None:
        """Write the currents, where nothing needed them before."""
        if self._first:
            np.copyto(self._currents, self._drive)

    def _silence(self, membrane: Floats, spikes: Bits, _: Floats) -> None:
        np.logical_not(spikes, self._others)
        np.multiply(membrane, self._others, membrane)


def _subtract(membrane: Floats, spikes: Bits, threshold: Floats) -> None:
    np.subtract(membrane, threshold, out=membrane, where=spikes)
