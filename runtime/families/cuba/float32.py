"""Quantisation for chips with whole weights and states in float32."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.registers import Rounding, rounded
from spikedeploy.runtime.compiler.program import Layer
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.cuba.spinnaker2 import CubaFloat32

LARGEST = float(np.finfo(np.float32).max)


def quantise_floats(layer: Layer, point: CubaFloat32, rounding: Rounding = "nearest") -> Layer:
    """The layer with whole weights; its states and thresholds grow as the weights do."""
    scale = _scale(layer, point)
    return replace(
        layer,
        synapses=tuple(
            replace(s, weight=rounded(s.weight * scale, rounding).astype(np.int16))
            for s in layer.synapses
        ),
        bias=_single(layer, "bias", scale),
        voltage_bias=_single(layer, "voltage_bias", scale),
        threshold=_single(layer, "threshold", scale),
        current_decay=layer.current_decay.astype(np.float32),
        membrane_decay=layer.membrane_decay.astype(np.float32),
        scale=layer.scale / scale,
    )


def _scale(layer: Layer, point: CubaFloat32) -> float:
    """w_scale = weight_max / max|w| over all synapses into the population."""
    largest = max(float(np.abs(s.weight).max(initial=0.0)) for s in layer.synapses)
    scale = point.weight_max / largest if largest > 0 else 1.0
    if not np.isfinite(scale):
        raise RuleError(
            f"rule weight-bits: layer {layer.name!r}: the largest weight is {largest:g}; nothing "
            f"that small can be scaled to {point.weight_max}. Scale the weights up, or leave the "
            "layer out."
        )
    return scale


def _single(layer: Layer, name: str, scale: float) -> NDArray[np.float32]:
    """(N,) the layer's numbers of that name, scaled, in float32."""
    values = np.asarray(getattr(layer, name), np.float64)
    largest = float(np.abs(values).max(initial=0.0))
    if largest * scale > LARGEST:
        rule = "threshold-range" if name == "threshold" else "bias"
        raise RuleError(
            f"rule {rule}: layer {layer.name!r}: {name} {largest:g} is {largest * scale:g} beside "
            f"weights that are whole; float32 holds {LARGEST:.3g}. Rescale the layer."
        )
    return (values * scale).astype(np.float32)
