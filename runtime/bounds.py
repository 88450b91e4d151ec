"""Bounds: how large the numbers of a layer can get, so that fast arithmetic is proven exact."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.chip import FixedPoint
from runtime.fixed import Register
from runtime.program import Layer, Program

Floats = NDArray[np.float64]

# largest magnitude for which float64 decays exactly: 2**53 less 12 decay bits, with one to spare
EXACT = 1 << 40

# from here on a window is as good as endless
LONG = 100


@dataclass(frozen=True)
class Bounds:
    """Largest magnitudes over the neurons of a layer, whatever the spikes.

    partial: of any partial sum of weights, in any order.
    drive: of what arrives in a timestep [state units].
    current: [state units].
    above: of a membrane before its reset, where it is positive [state units].
    below: of a membrane where it is negative [state units].
    """

    partial: int
    drive: float
    current: float
    above: float
    below: float


def room(register: Register) -> int:
    """Largest magnitude that a register holds, and that float64 decays exactly."""
    unbounded = register.overflow == "none" and register.between is None
    return EXACT if unbounded else register.limit


def bounds(program: Program, layer: Layer, fixed: FixedPoint, timesteps: int | None) -> Bounds:
    """Bounds of a layer that starts from 0; timesteps None is a state that is never reset."""
    one = float(1 << fixed.mantissa_shift)
    weights = [s.weight.astype(np.int64) for s in layer.synapses]
    positive = sum((w.clip(min=0).sum(axis=0) for w in weights), layer.bias.clip(min=0))
    negative = sum((-w.clip(max=0).sum(axis=0) for w in weights), -layer.bias.clip(max=0))
    raised, above = _leaky(layer, fixed, positive * one, layer.voltage_bias, timesteps)
    lowered, below = _leaky(layer, fixed, negative * one, -layer.voltage_bias, timesteps)
    if program.convention.reset == "zero":
        # no membrane stays above its threshold
        above = np.minimum(above, layer.threshold + raised + layer.voltage_bias.clip(min=0))
    partial = np.maximum(positive, negative).max()
    return Bounds(
        partial=int(partial),
        drive=float(partial * one),
        current=float(np.maximum(raised, lowered).max()),
        above=float(above.max()),
        below=float(below.max()),
    )


def _leaky(
    layer: Layer, fixed: FixedPoint, drive: Floats, bias: NDArray[Any], timesteps: int | None
) -> tuple[Floats, Floats]:
    """Largest current and membrane (N,) when so much arrives in every timestep."""
    keep_current = layer.current_keep / float(fixed.decay_one)
    keep_membrane = layer.membrane_keep / float(fixed.decay_one)
    push = bias.clip(min=0).astype(np.float64)
    if timesteps is None or timesteps > LONG:
        current = _endless(drive, keep_current)
        return current, _endless(current + push, keep_membrane)
    current = membrane = np.zeros(layer.size)
    for _ in range(timesteps):
        current = keep_current * current + drive
        membrane = keep_membrane * membrane + current + push
    return current, membrane


def _endless(drive: Floats, keep: Floats) -> Floats:
    """Limit of x = keep x + drive: drive / (1 - keep), and endless without a leak."""
    endless = np.where(drive > 0, np.inf, 0.0)
    return np.divide(drive, 1 - keep, out=endless, where=keep < 1)
