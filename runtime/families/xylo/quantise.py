"""Quantisation for Xylo: 8-bit weights, and thresholds and biases that follow their scale.

As in rockpool's `global_quantize` and `channel_quantize`: a scale makes the largest weight or bias
of a population, or the largest weight of a neuron, 127; where a threshold then does not fit 16
bits, the scale is what makes it fit. Hidden and output neurons have scales of their own.

Three things of rockpool 3.1.0 are not taken over: `global_quantize` scales the biases of outputs by
the hidden scale, and recurrent weights once more where the outputs' thresholds do not fit;
`channel_quantize` leaves biases unscaled where neurons have one synapse.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.registers import Rounding, rounded
from spikedeploy.runtime.compiler.program import Layer, Program, Synapses
from spikedeploy.runtime.compiler.quantisation import PLAIN, Granularity, Quantisation
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.xylo.arithmetic import XyloArithmetic

Floats: TypeAlias = NDArray[np.float64]


def quantise_xylo(
    program: Program,
    point: XyloArithmetic,
    quantisation: Quantisation = PLAIN,
) -> Program:
    """The float layers of the program as Xylo's integers.

    quantisation: "layer" is one scale for all hidden neurons and one for all outputs, "channel" one
        for each neuron, which a spike without size allows; rounding is to the nearest by itself.
    """
    quantisation.only(program.chip.name, "granularity", "rounding")
    weight_shift = quantisation.weight_shift
    if not 0 <= weight_shift <= point.shift_max:
        raise ConfigError(f"weight_shift is {weight_shift}; choose 0 to {point.shift_max} bits.")
    scales = _scales(program, point, quantisation.granularity, 1 << weight_shift)
    rounding = quantisation.rounding or "nearest"
    layers = (
        _layer(layer, scales[layer.name], point, rounding, 1 << weight_shift)
        for layer in program.layers
    )
    return replace(program, layers=tuple(layers))


def _scales(
    program: Program, point: XyloArithmetic, granularity: Granularity, one: int
) -> dict[str, Floats]:
    """Weights per float unit (N,) of each layer; a weight of 1 is worth so many state units."""
    biases_too = granularity == "layer"
    each = {layer.name: _fitting(layer, point, one, biases_too) for layer in program.layers}
    if granularity == "channel":
        return each
    outputs = {program.output} if program.output_apart else set()
    common: dict[str, Floats] = {}
    for population in (each.keys() - outputs, outputs):
        least = min((each[name].min() for name in population), default=1.0)
        common |= {name: np.full(each[name].shape, least) for name in population}
    return common


def _fitting(layer: Layer, point: XyloArithmetic, one: int, biases_too: bool) -> Floats:
    """(N,) largest scale at which the weights, the bias and the threshold of each neuron fit.

    biases_too: whether biases, which have 16 bits, are to be no larger than weights all the same.
    """
    _check_thresholds(layer)
    bias = np.abs(layer.voltage_bias)
    weight = np.concatenate([np.abs(s.weight) for s in layer.synapses]).max(axis=0, initial=0.0)
    largest = np.maximum(weight, bias) if biases_too else weight
    wide = point.state.limit / one
    with np.errstate(divide="ignore"):
        scales = point.weight_max / largest, wide / layer.threshold, wide / bias
    return np.asarray(np.min(scales, axis=0))


def _check_thresholds(layer: Layer) -> None:
    if layer.threshold.min() <= 0:
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold {layer.threshold.min():g}; a "
            "membrane of Xylo at rest would spike without end. Train with positive thresholds."
        )


def _layer(
    layer: Layer, scale: Floats, point: XyloArithmetic, rounding: Rounding, one: int
) -> Layer:
    synapses = tuple(_synapses(s, scale, point, rounding, one) for s in layer.synapses)
    states = scale * one
    threshold = rounded(layer.threshold * states, rounding)
    if (lost := threshold < 1).any():
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold "
            f"{layer.threshold[lost].min():g} becomes 0 beside the largest weight or bias, and a "
            "membrane at rest would spike without end. Clip the weights, raise the threshold, or "
            "give each channel a scale."
        )
    _check_alive(layer, synapses)
    return replace(
        layer,
        synapses=synapses,
        bias=np.zeros(layer.size, np.int64),
        voltage_bias=rounded(layer.voltage_bias * states, rounding),
        threshold=threshold,
        scale=layer.scale / (states[0] if np.ptp(states) == 0 else states),
    )


def _synapses(
    synapses: Synapses, scale: Floats, point: XyloArithmetic, rounding: Rounding, one: int
) -> Synapses:
    most = point.weight_max
    weight = rounded(synapses.weight * scale, rounding).clip(-most, most)
    return replace(synapses, weight=(weight * one).astype(np.int32))


def _check_alive(layer: Layer, quantised: Sequence[Synapses]) -> None:
    """A layer with weights must not lose all of them to its threshold or to another layer."""
    before = max(np.abs(s.weight).max(initial=0.0) for s in layer.synapses)
    if before > 0 and not any(s.weight.any() for s in quantised):
        raise RuleError(
            f"rule weight-bits: layer {layer.name!r}: every weight becomes 0. The largest, "
            f"{before:g}, is too small beside a threshold, a bias or the weights of another layer. "
            "Give each channel a scale, or scale the weights up."
        )
