"""Quantisation for chips without a synaptic current.

All numbers of a layer are multiplied by one scale: as large as weights, biases and the threshold
allow.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from runtime.chip import Chip
from runtime.errors import RuleError
from runtime.program import Layer
from runtime.rounding import Rounding, rounded
from runtime.step_point import StepPoint
from runtime.step_rules import check_neurons

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# the shift of a membrane that does not leak
NO_LEAK = -1


def quantise_steps(
    layer: Layer, chip: Chip, point: StepPoint, rounding: Rounding | None, limits: bool
) -> Layer:
    """The float layer as the chip's integers.

    rounding: None is the chip's own.
    limits: False emulates a leak that the chip has not by the nearest that it has.
    """
    check_neurons(layer, chip, point, limits)
    rounding = rounding or point.rounding
    bias = layer.bias + layer.voltage_bias
    scale = _scale(layer, bias, point)
    low, high = point.weight_range
    whole_bias = np.clip(rounded(bias * scale, rounding), *point.bias_range)
    nothing = np.zeros_like(whole_bias)
    quantised = replace(
        layer,
        synapses=tuple(
            replace(s, weight=_clipped(rounded(s.weight * scale, rounding), low, high))
            for s in layer.synapses
        ),
        bias=nothing if point.bias_bits else whole_bias,
        voltage_bias=whole_bias if point.bias_bits else nothing,
        threshold=_threshold(layer, chip, scale, point, rounding, limits),
        current_keep=nothing,
        membrane_keep=_leak(layer, point, scale, rounding),
        scale=layer.scale / scale,
    )
    _check_alive(layer, quantised, chip)
    return quantised


def _scale(layer: Layer, bias: Floats, point: StepPoint) -> float:
    """What makes the largest weight, bias or threshold the largest that fits."""
    ranges = (
        *((s.weight, point.weight_range) for s in layer.synapses),
        (bias, point.bias_range),
        (layer.threshold, (0, point.threshold_max)),
    )
    scale = min(_room(values, *between) for values, between in ranges)
    if not np.isfinite(scale):
        return 1.0
    return float(2.0 ** np.floor(np.log2(scale))) if point.scaling == "binary" else scale


def _room(values: Floats, low: int, high: int) -> float:
    top, bottom = float(values.max(initial=0.0)), float(values.min(initial=0.0))
    above = high / top if top > 0 else np.inf
    below = low / bottom if bottom < 0 and low < 0 else np.inf
    return float(min(above, below))


def _clipped(weights: Integers, low: int, high: int) -> NDArray[np.int16]:
    # only catches a last bit of the scale
    return np.clip(weights, low, high).astype(np.int16)


def _threshold(
    layer: Layer, chip: Chip, scale: float, point: StepPoint, rounding: Rounding, limits: bool
) -> Integers:
    if layer.threshold.min(initial=0.0) < 0:
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold {layer.threshold.min():g} is "
            f"below 0; {chip.name} is emulated with thresholds of 0 and above. Train with those."
        )
    whole = np.minimum(rounded(layer.threshold * scale, rounding), point.threshold_max)
    lost = (whole == 0) & (layer.threshold > 0)
    if lost.any() and limits:
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold "
            f"{layer.threshold[lost].min():g} becomes 0 beside the largest weight, which has "
            f"{point.weight_bits} bits on {chip.name}. Clip the weights, raise the threshold, or "
            "compile with limits off."
        )
    return np.where(lost, 1, whole)


def _leak(layer: Layer, point: StepPoint, scale: float, rounding: Rounding) -> Integers:
    """(N,) amounts, or shifts."""
    lost = 1 - layer.membrane_keep
    if point.leak == "shift":
        with np.errstate(divide="ignore"):
            # shift = int(|log2(1 - beta)|)
            shift = np.where(lost > 0, np.abs(np.log2(lost)), 0.0)
        return np.where(lost > 0, np.minimum(np.trunc(shift), point.leak_max), NO_LEAK).astype(int)
    # leak = (1 - beta) threshold / 2
    amount = rounded(lost * layer.threshold * scale / 2, rounding)
    return np.minimum(amount, point.leak_max)


def _check_alive(layer: Layer, quantised: Layer, chip: Chip) -> None:
    before = max(float(np.abs(s.weight).max(initial=0.0)) for s in layer.synapses)
    if before > 0 and not any(s.fan_out.any() for s in quantised.synapses):
        raise RuleError(
            f"rule weight-bits: layer {layer.name!r}: every weight becomes 0. The largest, "
            f"{before:g}, is too small on {chip.name} beside its threshold, "
            f"{layer.threshold.max():g}, or its bias. Scale the weights up, or the others down."
        )
