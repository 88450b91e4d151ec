"""Bounds on the numbers of a layer, whatever the spikes, and scales at which none overflows.

Bounds prove that fast arithmetic is exact. Headroom is the largest scale at which no register of
the chip can overflow; widths count even where a model of the chip does not say what happens beyond
them.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, Network
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.chips.registers import Register, magnitude
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters
from spikedeploy.runtime.families.cuba.quantise import quantise

Floats = NDArray[np.float64]

# largest magnitude for which float64 decays exactly: 2**53 less 12 decay bits, with one to spare
_EXACT = 1 << 40

# every whole number up to this is held by float32
_SINGLE = 1 << 24

# [timesteps] longer windows are treated as unbounded
_LONG = 100


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


def register_limit(register: Register) -> int:
    """Largest magnitude that a register holds, and that float64 decays exactly."""
    limitless = register.overflow == "none" and register.between is None
    return _EXACT if limitless else register.limit


def bounds(
    network: Network, layer: Layer, registers: CubaRegisters, timesteps: int | None
) -> Bounds:
    """Bounds of a layer that starts from 0; timesteps None is a state that is never reset."""
    one = float(1 << registers.mantissa_shift)
    weights = [s.weight.astype(np.int64) for s in layer.synapses]
    positive = sum((w.clip(min=0).sum(axis=0) for w in weights), layer.bias.clip(min=0))
    negative = sum((-w.clip(max=0).sum(axis=0) for w in weights), -layer.bias.clip(max=0))
    raised, above = _leaky(layer, registers, positive * one, layer.voltage_bias, timesteps)
    lowered, below = _leaky(layer, registers, negative * one, -layer.voltage_bias, timesteps)
    if network.convention.reset == "zero":
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


def spikes_without_overflow(
    layer: Layer, registers: CubaRegisters, timesteps: int, most: int
) -> int:
    """Spikes in a window of T timesteps from zero that can take no state beyond `most`.

    Each adds at most the largest weight to the sum of the magnitudes that arrive, and no state
    exceeds that sum times the peak that follows a single arrival.
    """
    one = 1 << registers.mantissa_shift
    steady = _largest(layer.bias) * one + _largest(layer.voltage_bias)
    left = most / _peak(layer, registers, timesteps) - timesteps * steady
    largest = max(_largest(synapses.weight) for synapses in layer.synapses) * one
    return max(-1, int(left // largest)) if largest else -1


def single(layer: Layer, registers: CubaRegisters) -> int:
    """Largest state that float32 decays exactly, and holds even if another is added to it."""
    thresholds = layer.threshold.astype(np.int64)
    if _largest(thresholds) >= _SINGLE or _largest(layer.voltage_bias) >= _SINGLE:
        return 0
    factors = np.concatenate([layer.current_decay, layer.membrane_decay]).astype(np.int64)
    # the odd part of a decay is what makes a product longer
    odd = factors // np.maximum(factors & -factors, 1)
    return _SINGLE // int(odd.max(initial=2))


def exact_ticks(layer: Layer, registers: CubaRegisters) -> int:
    """Decays after a reset that leave nothing to round, whatever the spikes.

    All that is added to the states is a multiple of 2**shift, and each decay divides it by as many
    powers of two as its factor has fractional bits. PopSAN's decay factors of 1/2 and 3/4 have up
    to two, and Loihi's states are multiples of 2**6: three decays round nothing.
    """
    added = [1 << registers.mantissa_shift, *layer.voltage_bias.tolist(), *layer.threshold.tolist()]
    shift = min(_trailing(int(value)) for value in added)
    factors = [*layer.current_decay.tolist(), *layer.membrane_decay.tolist()]
    bits = max(max(registers.decay_bits - _trailing(int(factor)), 0) for factor in factors)
    return shift // bits if bits else _LONG


def _trailing(value: int) -> int:
    """Zeros at the end of a binary number; for 0, _LONG."""
    return (value & -value).bit_length() - 1 if value else _LONG


def _peak(layer: Layer, registers: CubaRegisters, timesteps: int) -> float:
    """Largest current or membrane in a window after a single arrival of 1, without rounding."""
    current_factor = layer.current_decay / float(registers.decay_one)
    membrane_factor = layer.membrane_decay / float(registers.decay_one)
    current, membrane = np.ones(layer.size), np.ones(layer.size)
    peak = 1.0
    for _ in range(timesteps):
        current = current_factor * current
        membrane = membrane_factor * membrane + current
        peak = max(peak, float(membrane.max()))
    return peak


def _largest(values: NDArray[Any]) -> int:
    return int(magnitude(values.astype(np.int64)))


def _leaky(
    layer: Layer, registers: CubaRegisters, drive: Floats, bias: NDArray[Any], timesteps: int | None
) -> tuple[Floats, Floats]:
    """Largest current and membrane (N,) when so much arrives in every timestep."""
    current_factor = layer.current_decay / float(registers.decay_one)
    membrane_factor = layer.membrane_decay / float(registers.decay_one)
    push = bias.clip(min=0).astype(np.float64)
    if timesteps is None or timesteps > _LONG:
        current = _unbounded(drive, current_factor)
        return current, _unbounded(current + push, membrane_factor)
    current = membrane = np.zeros(layer.size)
    for _ in range(timesteps):
        current = current_factor * current + drive
        membrane = membrane_factor * membrane + current + push
    return current, membrane


def _unbounded(drive: Floats, factor: Floats) -> Floats:
    """Limit of x = factor x + drive: drive / (1 - factor), and infinite without a leak."""
    unbounded = np.where(drive > 0, np.inf, 0.0)
    return np.divide(drive, 1 - factor, out=unbounded, where=factor < 1)


# rounding may lift a bound a little over its register again; each round takes away the excess
_ROUNDS = 50
_SLACK = 1e-3


def with_headroom(
    registers: CubaRegisters, network: Network, quantisation: Quantisation, timesteps: int | None
) -> list[Layer]:
    """The float layers of a network, quantised so that nothing can overflow.

    timesteps: T of an inference; None is a state that is never reset.
    """
    return [_proven(network, a, registers, quantisation, timesteps) for a in network.layers]


def _overflow_ratio(
    network: Network, layer: Layer, registers: CubaRegisters, timesteps: int | None
) -> float:
    """How many times the largest that fits its register a number of the layer can become."""
    worst = bounds(network, layer, registers, timesteps)
    push = worst.current + magnitude(layer.voltage_bias)
    return max(
        worst.drive / registers.accumulator.limit,
        worst.current / registers.current.limit,
        push / registers.push.limit,
        worst.above / registers.membrane.limit,
        worst.below / registers.membrane.limit,
    )


def _proven(
    network: Network,
    layer: Layer,
    registers: CubaRegisters,
    quantisation: Quantisation,
    timesteps: int | None,
) -> Layer:
    each = quantisation.granularity == "channel"
    share = np.ones(layer.size if each else 1)
    for _ in range(_ROUNDS):
        quantised = quantise(layer, registers, quantisation, share if each else float(share[0]))
        parts = [_alone(quantised, n) for n in range(layer.size)] if each else [quantised]
        over = np.array([_overflow_ratio(network, part, registers, timesteps) for part in parts])
        if (over <= 1).all():
            return quantised
        if not np.isfinite(over).all():
            break
        share = np.where(over > 1, share / over * (1 - _SLACK), share)
    raise RuleError(
        f"rule headroom: layer {layer.name!r}: no scale keeps its membranes from overflowing for "
        "ever, since they do not leak. Choose headroom 'none', or calibrate it on recorded inputs."
    )


def _alone(layer: Layer, n: int) -> Layer:
    """The layer with one of its neurons."""
    return replace(
        layer,
        synapses=tuple(replace(s, weight=s.weight[:, n : n + 1]) for s in layer.synapses),
        **{
            name: getattr(layer, name)[n : n + 1]
            for name in ("bias", "voltage_bias", "threshold", "current_decay", "membrane_decay")
        },
    )
