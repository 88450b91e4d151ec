"""Quantisation for chips without a synaptic current.

All numbers of a layer are multiplied by one scale: as large as weights, biases and the threshold
allow. What a network has that these neurons do not is refused.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.registers import Rounding, magnitude, rounded
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.integrate_and_fire.rules import IntegrateAndFireRules

_LINEAR = (
    "{chip} takes the same amount away in each timestep. Train with IF neurons, or compile with "
    "limits off, which takes away what is lost half-way to the threshold."
)
# remedies where neurons do not leak as the chip's do
_REMEDIES = {
    "none": "{chip} has no leak. Train with IF neurons.",
    "linear": _LINEAR,
    "crossing": _LINEAR,
    "shift": "every neuron on {chip} leaks by a shift; none without was found. Train with LIF "
    "neurons, or compile with limits off.",
}


def _check_neurons(
    layer: Layer, chip_name: str, rules: IntegrateAndFireRules, limits: bool
) -> None:
    """Refuse neurons with a current, or with another leak than the chip's, in floats.

    limits: False lets a leak pass that the chip has something near for.
    """
    _check_current(layer, chip_name)
    _check_leak(layer, chip_name, rules, limits)


def check_axons(layers: Sequence[Layer], chip_name: str, rules: IntegrateAndFireRules) -> None:
    """Refuse weights that the chip's axons cannot carry, however many bits they have."""
    if rules.signs == "axon":
        _check_signs(layers, chip_name)
    if rules.axon_types:
        for layer in layers:
            _check_types(layer, chip_name, rules.axon_types)


def axon_types(weight: NDArray[Any]) -> int:
    """Types of axons that the weights (M, N) need, each axon put into the first that it fits.

    Axons fit together where every neuron that both reach gives them the same weight. First-fit may
    find more types than the best choice would.
    """
    types: list[NDArray[Any]] = []
    for row in weight:
        for held in types:
            if not ((row != 0) & (held != 0) & (row != held)).any():
                np.copyto(held, row, where=held == 0)
                break
        else:
            types.append(row.copy())
    return len(types)


def _check_current(layer: Layer, chip_name: str) -> None:
    if layer.current_decay.any():
        raise RuleError(
            f"rule primitive: layer {layer.name!r} has a synaptic current that keeps "
            f"{layer.current_decay.max():.3g} of itself; {chip_name} adds spikes to the membrane. "
            "Train with LIF or IF neurons."
        )


def _check_leak(layer: Layer, chip_name: str, rules: IntegrateAndFireRules, limits: bool) -> None:
    other = (layer.membrane_decay == 1) == (rules.leak == "shift")
    if not other.any() or (rules.leak != "none" and not limits):
        return
    found = f"{layer.membrane_decay[other].min():.3g}"
    remedy = _REMEDIES[rules.leak].format(chip=chip_name)
    raise RuleError(
        f"rule decay-range: layer {layer.name!r} keeps {found} of its membrane; {remedy}"
    )


def _check_signs(layers: Sequence[Layer], chip_name: str) -> None:
    """A neuron excites or inhibits all that it projects to, in whichever layer."""
    signs: dict[str, tuple[Any, Any]] = {}
    for layer in layers:
        for synapses in layer.synapses:
            up, down = (synapses.weight > 0).any(axis=1), (synapses.weight < 0).any(axis=1)
            before = signs.get(synapses.source, (False, False))
            signs[synapses.source] = up, down = before[0] | up, before[1] | down
            if (both := np.flatnonzero(up & down)).size:
                raise RuleError(
                    f"rule sign: layer {layer.name!r}: {both.size} of {up.size} axons from "
                    f"{synapses.source!r} have weights of both signs, the first is axon {both[0]}; "
                    f"on {chip_name} an axon has one. Train with signed axons, or compile with "
                    "limits off."
                )


def _check_types(layer: Layer, chip_name: str, most: int) -> None:
    found = axon_types(np.concatenate([s.weight for s in layer.synapses]))
    if found > most:
        raise RuleError(
            f"rule axon-types: layer {layer.name!r}: its weights need {found} types of axons, put "
            f"into the first that fits; {chip_name} has {most}, and each neuron one weight for "
            "each. Train with fewer different weights, or compile with limits off."
        )


Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# the shift of a membrane that does not leak
_NO_LEAK = -1


def quantise(
    layer: Layer,
    chip_name: str,
    rules: IntegrateAndFireRules,
    rounding: Rounding | None,
    limits: bool,
) -> Layer:
    """The float layer as the chip's integers.

    rounding: None is the chip's own.
    limits: False emulates a leak that the chip has not by the nearest that it has.
    """
    _check_neurons(layer, chip_name, rules, limits)
    rounding = rounding or rules.rounding
    bias = layer.bias + layer.voltage_bias
    scale = _scale(layer, bias, rules)
    low, high = rules.weight_range
    whole_bias = np.clip(rounded(bias * scale, rounding), *rules.bias_range)
    nothing = np.zeros_like(whole_bias)
    quantised = replace(
        layer,
        synapses=tuple(
            replace(s, weight=_clipped(rounded(s.weight * scale, rounding), low, high))
            for s in layer.synapses
        ),
        bias=nothing if rules.bias_bits else whole_bias,
        voltage_bias=whole_bias if rules.bias_bits else nothing,
        threshold=_threshold(layer, chip_name, scale, rules, rounding, limits),
        current_decay=nothing,
        membrane_decay=_leak(layer, rules, scale, rounding),
        scale=layer.scale / scale,
    )
    _check_alive(layer, quantised, chip_name)
    return quantised


def _scale(layer: Layer, bias: Floats, rules: IntegrateAndFireRules) -> float:
    """What makes the largest weight, bias or threshold the largest that fits."""
    ranges = (
        *((s.weight, rules.weight_range) for s in layer.synapses),
        (bias, rules.bias_range),
        (layer.threshold, (0, rules.threshold_max)),
    )
    scale = min(_largest_scale(values, *between) for values, between in ranges)
    if not np.isfinite(scale):
        return 1.0
    return float(2.0 ** np.floor(np.log2(scale))) if rules.scaling == "binary" else scale


def _largest_scale(values: Floats, low: int, high: int) -> float:
    top, bottom = float(values.max(initial=0.0)), float(values.min(initial=0.0))
    above = high / top if top > 0 else np.inf
    below = low / bottom if bottom < 0 and low < 0 else np.inf
    return float(min(above, below))


def _clipped(weights: Integers, low: int, high: int) -> NDArray[np.int16]:
    # only catches a last bit of the scale
    return np.clip(weights, low, high).astype(np.int16)


def _threshold(
    layer: Layer,
    chip_name: str,
    scale: float,
    rules: IntegrateAndFireRules,
    rounding: Rounding,
    limits: bool,
) -> Integers:
    if (layer.threshold < 0).any():
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold {layer.threshold.min():g} is "
            f"below 0; {chip_name} is emulated with thresholds of 0 and above. Train with those."
        )
    whole = np.minimum(rounded(layer.threshold * scale, rounding), rules.threshold_max)
    lost = (whole == 0) & (layer.threshold > 0)
    if lost.any() and limits:
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold "
            f"{layer.threshold[lost].min():g} becomes 0 beside the largest weight, which has "
            f"{rules.weight_bits} bits on {chip_name}. Clip the weights, raise the threshold, or "
            "compile with limits off."
        )
    return np.where(lost, 1, whole)


def _leak(layer: Layer, rules: IntegrateAndFireRules, scale: float, rounding: Rounding) -> Integers:
    """(N,) amounts, or shifts."""
    lost = 1 - layer.membrane_decay
    if rules.leak == "shift":
        with np.errstate(divide="ignore"):
            # shift = int(|log2(1 - beta)|)
            shift = np.abs(np.log2(lost))
        return np.where(lost > 0, np.minimum(np.trunc(shift), rules.leak_max), _NO_LEAK).astype(int)
    # leak = (1 - beta) threshold / 2
    amount = rounded(lost * layer.threshold * scale / 2, rounding)
    return np.minimum(amount, rules.leak_max)


def _check_alive(layer: Layer, quantised: Layer, chip_name: str) -> None:
    before = max(magnitude(s.weight) for s in layer.synapses)
    if before > 0 and not any(s.fan_out.any() for s in quantised.synapses):
        raise RuleError(
            f"rule weight-bits: layer {layer.name!r}: every weight becomes 0. The largest, "
            f"{before:g}, is too small on {chip_name} beside its threshold, "
            f"{layer.threshold.max():g}, or its bias. Scale the weights up, or the others down."
        )
