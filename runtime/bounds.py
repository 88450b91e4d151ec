"""Bounds: how large the numbers of a layer can get, so that fast arithmetic is proven exact."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.chip import FixedPoint
from runtime.fixed import Register
from runtime.program import Layer

# largest magnitude for which float64 decays exactly: 2**53 less 12 decay bits, with one to spare
EXACT = 1 << 40

# timesteps of a state that is never reset, in a number that can be multiplied by 0
FOREVER = 1e18


@dataclass(frozen=True)
class Bounds:
    """Largest magnitudes over the neurons of a layer, whatever the spikes.

    partial: of any partial sum of weights, in any order.
    drive: of the weights that arrive in a timestep [state units].
    current: [state units].
    membrane: [state units].
    """

    partial: int
    drive: float
    current: float
    membrane: float

    def fit(self, fixed: FixedPoint) -> bool:
        """Whether no register of the chip can overflow."""
        return (
            self.drive <= room(fixed.accumulator)
            and self.current <= room(fixed.current)
            and self.membrane <= room(fixed.membrane)
        )


def room(register: Register) -> int:
    """Largest magnitude that a register holds, and that float64 decays exactly."""
    return EXACT if register.overflow == "none" else register.limit


def bounds(layer: Layer, fixed: FixedPoint, timesteps: float) -> Bounds:
    """Bounds of a layer that starts from 0 and runs so many timesteps, or FOREVER."""
    reach = sum((_reach(s.weight) for s in layer.synapses), np.abs(layer.bias))
    one = float(fixed.decay_one)
    # |u| <= A (1 + k + k^2 + ...)      |v| <= (|u| + |bias|) (1 + k + k^2 + ...)
    drive = reach * float(1 << fixed.mantissa_shift)
    current = drive * _series(layer.current_keep / one, timesteps)
    membrane = (current + np.abs(layer.voltage_bias)) * _series(
        layer.membrane_keep / one, timesteps
    )
    return Bounds(int(reach.max()), drive.max(), current.max(), membrane.max())


def _reach(weight: NDArray[Any]) -> NDArray[np.int64]:
    """(N,) the larger of all positive and all negative weights of each neuron."""
    whole = weight.astype(np.int64)
    return np.asarray(np.maximum(whole.clip(min=0).sum(axis=0), -whole.clip(max=0).sum(axis=0)))


def _series(keep: NDArray[np.float64], terms: float) -> NDArray[np.float64]:
    """1 + k + k^2 + ... with so many terms."""
    leak = np.where(keep < 1, 1 - keep, 1.0)
    return np.where(keep < 1, (1 - keep**terms) / leak, terms)
