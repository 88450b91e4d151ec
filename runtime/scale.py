"""The scale of a layer: how many mantissas stand for a float unit.

The largest weight or bias becomes the chip's largest weight (Tang et al. 2020, PopSAN), unless the
threshold or the voltage bias would not fit then. A spike has no size, so scales never meet, neither
those of layers nor those of neurons of a layer: threshold, bias and membrane follow the scale.
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from runtime.chip import FixedPoint
from runtime.program import Layer
from runtime.quantisation import Granularity

Floats = NDArray[np.float64]

# (), one for a layer, or (N,), one for each of its neurons
Scale: TypeAlias = float | Floats


def mantissas_per_unit(
    layer: Layer, fixed: FixedPoint, granularity: Granularity, reach: float = 1.0
) -> Scale:
    """As many as the weights, the threshold and the bias allow.

    reach: as in Tuning.
    """
    widest_bias = fixed.bias_mantissa_max << fixed.bias_exponent_max >> fixed.mantissa_shift
    limits = (
        (fixed.weight_max * max(reach, 1.0), [*(s.weight for s in layer.synapses), layer.bias]),
        (fixed.threshold_max, [layer.threshold]),
        (widest_bias, [layer.voltage_bias]),
    )
    scale = np.full(layer.size, np.inf)
    for limit, arrays in limits:
        found = _largest(arrays)
        found = found if granularity == "channel" else np.full(layer.size, found.max(initial=0.0))
        scale = np.minimum(scale, np.divide(limit, found, out=scale.copy(), where=found > 0))
    # a neuron of zeros has no largest number
    scale = np.where(np.isfinite(scale), scale, 1.0) * min(reach, 1.0)
    return scale if granularity == "channel" else float(scale.min(initial=np.inf))


def _largest(arrays: Sequence[Floats]) -> Floats:
    """Largest magnitude of each neuron (N,)."""
    columns = [np.abs(np.atleast_2d(array)).max(axis=0, initial=0.0) for array in arrays]
    return np.asarray(np.max(columns, axis=0))
