"""Quantisation: a layer in floats becomes the integers that a chip can hold."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.chip import FixedPoint
from runtime.errors import RuleError
from runtime.program import Layer, Synapses
from runtime.quantisation import PLAIN, Quantisation
from runtime.rounding import Rounding, rounded
from runtime.scale import Scale, mantissas_per_unit
from runtime.threshold_levels import levelled

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def quantise(
    layer: Layer, fixed: FixedPoint, quantisation: Quantisation = PLAIN, share: Scale = 1.0
) -> Layer:
    """The float layer as the chip's integers.

    share: () or (N,) part of the largest scale that is used; runtime.headroom finds it.
    """
    _check_bias(layer, fixed)
    tuning, rounding = quantisation.of(layer.name), quantisation.rounding or "nearest"
    tuned = replace(layer, threshold=layer.threshold * tuning.threshold)
    scale = mantissas_per_unit(tuned, fixed, quantisation.granularity, tuning.reach) * share
    if quantisation.thresholds is not None:
        scale = levelled(np.asarray(scale), tuned.threshold, quantisation.thresholds)
    one = 1 << fixed.mantissa_shift
    quantised = replace(
        layer,
        synapses=tuple(_synapses(s, scale, fixed, rounding) for s in layer.synapses),
        bias=_weights(layer.bias, scale, fixed, rounding),
        voltage_bias=_voltage_bias(layer.voltage_bias * scale * one, fixed, rounding),
        threshold=_threshold(tuned, scale, fixed, rounding) * one,
        current_keep=_keep(layer, "current", fixed, rounding),
        membrane_keep=_keep(layer, "membrane", fixed, rounding),
        scale=layer.scale / (scale * one),
    )
    _check_alive(layer, quantised, fixed)
    return quantised


def stored(weights: NDArray[Any], fixed: FixedPoint, exponent: int = 0) -> NDArray[np.int16]:
    """What the chip keeps of whole weights when it drops the bits below its weight step.

    exponent: each weight then counts 2**this times, rounded down.
    """
    whole = weights.astype(np.int64)
    if fixed.sign_mode == "mixed" and fixed.step_rounding == "floor":
        steps = whole // fixed.weight_step
    else:
        steps = np.sign(whole) * (np.abs(whole) // fixed.weight_step)
    kept = steps * fixed.weight_step
    kept = kept << exponent if exponent > 0 else kept >> -exponent
    if fixed.exponents == "weight":  # brian2_loihi clips what a weight adds to the accumulator
        limit = fixed.accumulator.limit >> fixed.mantissa_shift
        kept = np.clip(kept, -limit, limit)
    return np.asarray(kept, np.int16)


def _check_bias(layer: Layer, fixed: FixedPoint) -> None:
    if not fixed.bias_mantissa_max and layer.voltage_bias.any():
        raise RuleError(
            f"rule bias: layer {layer.name!r}: a voltage bias of "
            f"{_magnitude(layer.voltage_bias):g}; the chip's neurons have none. Set v_leak to 0, "
            "or take another reading of the chip."
        )


def _magnitude(values: Floats) -> float:
    return float(np.abs(values).max(initial=0.0))


def _synapses(synapses: Synapses, scale: Scale, fixed: FixedPoint, rounding: Rounding) -> Synapses:
    weight = _weights(synapses.weight, scale, fixed, rounding).astype(np.int16)
    return replace(synapses, weight=weight)


def _weights(weights: Floats, scale: Scale, fixed: FixedPoint, rounding: Rounding) -> Integers:
    """Multiples of the chip's weight step; what a reach above 1 sends further is clipped."""
    steps = rounded(weights * scale / fixed.weight_step, rounding)
    return np.clip(steps * fixed.weight_step, -fixed.weight_max, fixed.weight_max)


def _threshold(layer: Layer, scale: Scale, fixed: FixedPoint, rounding: Rounding) -> Integers:
    if layer.threshold.min(initial=0.0) < 0:
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
    return np.minimum(mantissa, fixed.threshold_max)


def _voltage_bias(values: Floats, fixed: FixedPoint, rounding: Rounding) -> Integers:
    """Biases as mantissa * 2**exponent, with the smallest exponent that holds each value."""
    over = np.maximum(np.abs(values) / max(fixed.bias_mantissa_max, 1), 1.0)
    exponent = np.ceil(np.log2(over)).astype(np.int64)
    exponent = np.minimum(exponent, fixed.bias_exponent_max)
    mantissa = rounded(values / 2.0**exponent, rounding)
    limit = fixed.bias_mantissa_max
    return np.clip(mantissa, -limit, limit) << exponent


def _keep(layer: Layer, of: str, fixed: FixedPoint, rounding: Rounding) -> Integers:
    """What is left after a timestep, of 2**decay_bits, as near as the decay's register allows."""
    keep = layer.current_keep if of == "current" else layer.membrane_keep
    offset = fixed.current_decay_offset if of == "current" else fixed.membrane_decay_offset
    least, most = offset, fixed.decay_max + offset
    if (least > 0 and (keep == 1).any()) or (most < fixed.decay_one and (keep == 0).any()):
        raise RuleError(
            f"rule decay-range: layer {layer.name!r}: a {of} that keeps "
            f"{'all' if least else 'nothing'} of itself is not possible; the chip takes away "
            f"{least} to {most} of {fixed.decay_one} in each timestep. Choose another time "
            "constant."
        )
    decays = rounded((1 - keep) * fixed.decay_one, rounding)
    return fixed.decay_one - np.clip(decays, least, most)


def _check_alive(layer: Layer, quantised: Layer, fixed: FixedPoint) -> None:
    """A layer with weights must not lose all of them to the range of its threshold or bias."""
    before = max(_magnitude(s.weight) for s in layer.synapses)
    if before > 0 and not any(s.fan_out.any() for s in quantised.synapses):
        raise RuleError(
            f"rule weight-bits: layer {layer.name!r}: every weight becomes 0. The largest, "
            f"{before:g}, is too small beside its threshold ({_magnitude(layer.threshold):g}, of "
            f"at most {fixed.threshold_max} mantissas) or bias. Scale the weights up, or the "
            "others down."
        )
