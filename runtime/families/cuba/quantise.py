"""Quantisation: a layer in floats becomes the integers that a chip can hold.

The scale of a layer is how many mantissas stand for a float unit. The largest weight or bias
becomes the chip's largest weight (Tang et al. 2020, PopSAN), unless the threshold or the voltage
bias would not fit then. Spikes are unit events, so layers and neurons can be scaled independently:
threshold, bias and membrane follow the scale.

A neuron that has a scale of its own has a threshold of its own, and a core stores only so many.
Scales may shrink a little, so that neurons share thresholds; nothing else has to follow.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import NEVER, Layer, Synapses
from spikedeploy.runtime.chips.quantisation import PLAIN, Granularity, Quantisation
from spikedeploy.runtime.chips.registers import Rounding, magnitude, rounded
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters
from spikedeploy.runtime.families.cuba.readouts import exponent_and_share

Floats = NDArray[np.float64]

# (), one for a layer, or (N,), one for each of its neurons
Scale: TypeAlias = float | Floats


def _mantissas_per_unit(
    layer: Layer, registers: CubaRegisters, granularity: Granularity, clip_ratio: float = 1.0
) -> Scale:
    """As many as the weights, the threshold and the bias allow.

    clip_ratio: as in Tuning.
    """
    widest_bias = (
        registers.bias_mantissa_max << registers.bias_exponent_max >> registers.mantissa_shift
    )
    limits = (
        (
            registers.weight_max * max(clip_ratio, 1.0),
            [*(s.weight for s in layer.synapses), layer.bias],
        ),
        (registers.threshold_max, [layer.threshold if layer.spiking else 0 * layer.bias]),
        (widest_bias, [layer.voltage_bias]),
    )
    scale = np.full(layer.size, np.inf)
    for limit, arrays in limits:
        found = _largest(arrays)
        found = found if granularity == "channel" else np.full(layer.size, magnitude(found))
        scale = np.minimum(scale, np.divide(limit, found, out=scale.copy(), where=found > 0))
    # a neuron of zeros has no largest number
    scale = np.where(np.isfinite(scale), scale, 1.0) * min(clip_ratio, 1.0)
    return scale if granularity == "channel" else float(scale.min(initial=np.inf))


def _largest(arrays: Sequence[Floats]) -> Floats:
    """Largest magnitude of each neuron (N,)."""
    columns = [np.abs(np.atleast_2d(array)).max(axis=0, initial=0.0) for array in arrays]
    return np.asarray(np.max(columns, axis=0))


_ROUNDS = 60


def levelled(scale: Floats, thresholds: Floats, most: int) -> Floats:
    """Scales (N,), at most as large, at which so many distinct threshold mantissas are enough.

    The scale that loses most loses as little as possible.

    thresholds: (N,) [float units].
    """
    whole = np.floor(scale * thresholds)
    used = np.unique(whole[whole > 0])
    # a threshold of 0 is one of them
    limit = max(most - int((whole <= 0).any()), 1)
    starts = used if len(used) <= limit else _starts(used, _least_ratio(used, limit))
    if not len(starts):
        return scale
    level = starts[np.searchsorted(starts, whole, "right") - 1]
    return np.asarray(np.divide(level, thresholds, out=scale.copy(), where=whole > 0))


def _least_ratio(used: Floats, most: int) -> float:
    """Smallest ratio of the largest to the smallest of a group with which so many groups do."""
    low, high = 1.0, float(used[-1] / used[0]) * (1 + 1e-9)
    for _ in range(_ROUNDS):
        middle = (low * high) ** 0.5
        low, high = (low, middle) if len(_starts(used, middle)) <= most else (middle, high)
    return high


def _starts(used: Floats, ratio: float) -> Floats:
    """The smallest of each group, whose others are at most so many times as large."""
    starts: list[float] = []
    for value in used.tolist():
        if not starts or value > starts[-1] * ratio:
            starts.append(value)
    return np.array(starts)


Integers = NDArray[np.int64]


def quantise(
    layer: Layer, registers: CubaRegisters, quantisation: Quantisation = PLAIN, share: Scale = 1.0
) -> Layer:
    """The float layer as the chip's integers.

    share: () or (N,) part of the largest scale that is used; headroom may ask for less than 1.
    """
    _check_bias(layer, registers)
    tuning, rounding = quantisation.of(layer.name), quantisation.rounding or "nearest"
    tuned = replace(layer, threshold=layer.threshold * tuning.threshold)
    scale = (
        _mantissas_per_unit(tuned, registers, quantisation.granularity, tuning.clip_ratio) * share
    )
    exponent = 0
    if not layer.spiking:
        untuned = scale / share / min(tuning.clip_ratio, 1.0)
        exponent, part = exponent_and_share(layer, registers, untuned)
        scale = scale * part
    elif quantisation.thresholds is not None:
        scale = levelled(np.asarray(scale), tuned.threshold, quantisation.thresholds)
    one = 1 << (registers.mantissa_shift + exponent)
    quantised = replace(
        layer,
        synapses=tuple(_synapses(s, scale, registers, rounding, exponent) for s in layer.synapses),
        bias=_weights(layer.bias, scale, registers, rounding) << exponent,
        voltage_bias=_voltage_bias(layer.voltage_bias * scale * one, registers, rounding),
        threshold=_thresholds(tuned, scale, registers, rounding, one),
        current_decay=_decay_factor(layer, "current", registers, rounding),
        membrane_decay=_decay_factor(layer, "membrane", registers, rounding),
        scale=layer.scale / (scale * one),
    )
    _check_alive(layer, quantised, registers)
    return quantised


def stored(weights: NDArray[Any], registers: CubaRegisters, exponent: int = 0) -> NDArray[np.int16]:
    """What the chip stores of whole weights when it drops the bits below its weight step.

    exponent: each weight then counts 2**this times, rounded down.
    """
    whole = weights.astype(np.int64)
    if registers.sign_mode == "mixed" and registers.step_rounding == "floor":
        steps = whole // registers.weight_step
    else:
        steps = np.sign(whole) * (np.abs(whole) // registers.weight_step)
    held = steps * registers.weight_step
    held = held << exponent if exponent > 0 else held >> -exponent
    if registers.exponents == "weight":  # brian2_loihi clips what a weight adds to the accumulator
        limit = registers.accumulator.limit >> registers.mantissa_shift
        held = np.clip(held, -limit, limit)
    return np.asarray(held, np.int16)


def _check_bias(layer: Layer, registers: CubaRegisters) -> None:
    if not registers.bias_mantissa_max and layer.voltage_bias.any():
        raise RuleError(
            f"rule bias: layer {layer.name!r}: a voltage bias of "
            f"{magnitude(layer.voltage_bias):g}; the chip's neurons have none. Set v_leak to 0, "
            "or take another model of the chip."
        )


def _synapses(
    synapses: Synapses, scale: Scale, registers: CubaRegisters, rounding: Rounding, exponent: int
) -> Synapses:
    weight = _weights(synapses.weight, scale, registers, rounding) << exponent
    return replace(synapses, weight=weight.astype(np.int16))


def _weights(
    weights: Floats, scale: Scale, registers: CubaRegisters, rounding: Rounding
) -> Integers:
    """Multiples of the chip's weight step; what a clip ratio above 1 sends further is clipped."""
    steps = rounded(weights * scale / registers.weight_step, rounding)
    return np.clip(steps * registers.weight_step, -registers.weight_max, registers.weight_max)


def _thresholds(
    layer: Layer, scale: Scale, registers: CubaRegisters, rounding: Rounding, one: int
) -> Integers:
    """Thresholds [state units], of which mantissas are `one` apart."""
    if not layer.spiking:
        return np.full(layer.size, NEVER)
    if layer.graded:  # a state of the neuron's program, not a mantissa
        return np.maximum(rounded(layer.threshold * scale * one, rounding), 1)
    return _threshold(layer, scale, registers, rounding) * one


def _threshold(
    layer: Layer, scale: Scale, registers: CubaRegisters, rounding: Rounding
) -> Integers:
    if (layer.threshold < 0).any():
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold {layer.threshold.min():g} is "
            "below 0; the chip's thresholds are unsigned. Train with positive thresholds."
        )
    exact = layer.threshold * scale
    mantissa = rounded(exact, rounding)
    lost = (mantissa == 0) & (layer.threshold > 0)
    if lost.any():
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold "
            f"{layer.threshold[lost].min():g} is {exact[lost].min():.2g} of the smallest that the "
            "chip can hold beside the largest weight. Clip the weights, or raise the threshold."
        )
    return np.minimum(mantissa, registers.threshold_max)


def _voltage_bias(values: Floats, registers: CubaRegisters, rounding: Rounding) -> Integers:
    """Biases as mantissa * 2**exponent, with the smallest exponent that holds each value."""
    over = np.maximum(np.abs(values) / max(registers.bias_mantissa_max, 1), 1.0)
    exponent = np.ceil(np.log2(over)).astype(np.int64)
    exponent = np.minimum(exponent, registers.bias_exponent_max)
    mantissa = rounded(values / 2.0**exponent, rounding)
    limit = registers.bias_mantissa_max
    return np.clip(mantissa, -limit, limit) << exponent


def _decay_factor(layer: Layer, of: str, registers: CubaRegisters, rounding: Rounding) -> Integers:
    """What is left after a timestep, of 2**decay_bits, as near as the decay's register allows."""
    factor = layer.current_decay if of == "current" else layer.membrane_decay
    offset = registers.current_decay_offset if of == "current" else registers.membrane_decay_offset
    least, most = offset, registers.decay_max + offset
    if (least > 0 and (factor == 1).any()) or (most < registers.decay_one and (factor == 0).any()):
        raise RuleError(
            f"rule decay-range: layer {layer.name!r}: a {of} that keeps "
            f"{'all' if least else 'nothing'} of itself is not possible; the chip takes away "
            f"{least} to {most} of {registers.decay_one} in each timestep. Choose another time "
            "constant."
        )
    decays = rounded((1 - factor) * registers.decay_one, rounding)
    return registers.decay_one - np.clip(decays, least, most)


def _check_alive(layer: Layer, quantised: Layer, registers: CubaRegisters) -> None:
    """A layer with weights must not lose all of them to the range of its threshold or bias."""
    before = max(magnitude(s.weight) for s in layer.synapses)
    if before > 0 and not any(s.fan_out.any() for s in quantised.synapses):
        if not layer.spiking:
            raise RuleError(
                f"rule weight-bits: layer {layer.name!r}: every weight becomes 0. The largest, "
                f"{before:g}, is too small beside its bias, or beside what its registers would "
                "have to hold. Choose a faster leak, or headroom 'none'."
            )
        raise RuleError(
            f"rule weight-bits: layer {layer.name!r}: every weight becomes 0. The largest, "
            f"{before:g}, is too small beside its threshold ({magnitude(layer.threshold):g}, of "
            f"at most {registers.threshold_max} mantissas) or bias. Scale the weights up, or the "
            "others down."
        )
