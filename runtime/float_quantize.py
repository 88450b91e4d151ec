"""Quantisation for chips with whole weights and states in float32."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from runtime.errors import RuleError
from runtime.float_point import FloatPoint
from runtime.program import Layer
from runtime.rounding import Rounding, rounded

LARGEST = float(np.finfo(np.float32).max)


def quantise_floats(layer: Layer, point: FloatPoint, rounding: Rounding = "nearest") -> Layer:
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
        current_keep=layer.current_keep.astype(np.float32),
        membrane_keep=layer.membrane_keep.astype(np.float32),
        scale=layer.scale / scale,
    )


def _scale(layer: Layer, point: FloatPoint) -> float:
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
