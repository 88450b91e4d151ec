"""Quantisation for chips with whole weights and states in float32."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.float_point import FloatPoint
from runtime.program import Layer
from runtime.rounding import Rounding, rounded


def quantise_floats(layer: Layer, point: FloatPoint, rounding: Rounding = "nearest") -> Layer:
    """The layer with whole weights; its states and thresholds grow as the weights do."""
    # w_scale = weight_max / max|w| over all synapses into the population
    largest = max(float(np.abs(s.weight).max(initial=0.0)) for s in layer.synapses)
    scale = point.weight_max / largest if largest > 0 else 1.0
    return replace(
        layer,
        synapses=tuple(
            replace(s, weight=rounded(s.weight * scale, rounding).astype(np.int16))
            for s in layer.synapses
        ),
        bias=_single(layer.bias * scale),
        voltage_bias=_single(layer.voltage_bias * scale),
        threshold=_single(layer.threshold * scale),
        current_keep=_single(layer.current_keep),
        membrane_keep=_single(layer.membrane_keep),
        scale=layer.scale / scale,
    )


def _single(values: NDArray[Any]) -> NDArray[np.float32]:
    return values.astype(np.float32)
