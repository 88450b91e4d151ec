"""Outliers: layers in which one large number leaves few bits of the chip for all others.

The scale of a layer makes its largest weight, bias or threshold the largest that fits. Where one
neuron, or the synapses of one source neuron, have numbers many times those of the others, these are
rounded to a few steps, or to nothing.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.arithmetic import Arithmetic
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.quantisation import Quantisation

Floats = NDArray[np.float64]

_COARSE = 0.05  # part of itself that rounding changes in the median weight, from which it is said
_LARGE = 10.0  # times the median of the others from which a number is large


def outlier_remarks(
    arithmetic: Arithmetic,
    before: tuple[Layer, ...],
    after: tuple[Layer, ...],
    quantisation: Quantisation,
) -> Iterator[str]:
    """Sentences on layers that one large number makes coarse, with what would help.

    before, after: the layers in floats, and as quantised
    """
    for floats, integers in zip(before, after, strict=True) if arithmetic.is_rounded else ():
        coarse = _median_error(arithmetic, floats, integers)
        cause = _cause(arithmetic, floats, quantisation) if coarse >= _COARSE else ""
        if cause:
            yield (
                f"layer {floats.name!r}: rounding changes half of its weights by "
                f"{min(coarse, 1):.0%} and more, as the largest {cause}"
            )


def _cause(arithmetic: Arithmetic, layer: Layer, quantisation: Quantisation) -> str:
    """The neuron, else the source neuron, with large numbers, and the remedy; empty of neither."""
    fills = _fills(arithmetic, layer)
    kind = max(fills, key=lambda each: float(fills[each].max()))
    large = _largest(np.max(list(fills.values()), axis=0))
    if quantisation.granularity == "layer" and large:
        neuron, times = large
        remedy = (
            "--quantise channel may help"
            if "granularity" in arithmetic.choices
            else f"divide the neuron's weights, bias and threshold by {times:.3g}, which changes "
            "nothing in float"
        )
        return f"{kind} is {times:.3g} x the others', in neuron {neuron}: {remedy}"
    for synapses in layer.synapses:
        channels = synapses.window is not None
        large = _largest(np.abs(synapses.weight).max(axis=(0, 2, 3) if channels else 1))
        if large:
            source = f"{synapses.source!r} {'channel' if channels else 'number'} {large[0]}"
            return (
                f"weight is {large[1]:.3g} x the others', from {source}: make its weights smaller "
                "and its spikes more, or give it several inputs"
            )
    return ""


def _largest(reach: Floats) -> tuple[int, float] | None:
    """Place of a number that is many times the median of the others but 0, and how many."""
    place = int(reach.argmax())
    others = np.delete(reach, place)
    others = others[others > 0]
    if not others.size or reach[place] < _LARGE * (usual := float(np.median(others))):
        return None
    return place, float(reach[place]) / usual


def _fills(arithmetic: Arithmetic, layer: Layer) -> dict[str, Floats]:
    """(N,) weights, biases and thresholds of each neuron, over what the chip holds of each."""
    shift = getattr(arithmetic, "mantissa_shift", 0)
    most = float(arithmetic.weight_max)
    # of a Loihi, whose biases are wider than its weights
    mantissa = getattr(arithmetic, "bias_mantissa_max", 0)
    wide = (mantissa << getattr(arithmetic, "bias_exponent_max", 0)) >> shift
    weights = [s.over_axons(np.abs(s.weight), np.maximum) for s in layer.synapses]
    found = {
        "weight": np.max(weights, axis=0) / most,
        "bias": np.maximum(np.abs(layer.bias) / most, np.abs(layer.voltage_bias) / (wide or most)),
    }
    if layer.spiking:
        found["threshold"] = np.abs(layer.threshold) / max(
            arithmetic.threshold_range[1] >> shift, 1
        )
    for channels in {len(s.weight) for s in layer.synapses if s.window is not None}:
        # neurons that share a kernel share a scale
        found = {
            kind: np.repeat(each.reshape(channels, -1).max(axis=1), layer.size // channels)
            for kind, each in found.items()
        }
    return found


def _median_error(arithmetic: Arithmetic, before: Layer, after: Layer) -> float:
    """Return the median relative error that rounding causes in the non-zero weights."""
    # state units of a weight's unit, where the chip has a register of a finer kind for states
    unit = float(1 << getattr(arithmetic, "mantissa_shift", 0))
    parts = [np.zeros(0)]
    for exact, rounded in zip(before.synapses, after.synapses, strict=True):
        scale = exact.by_weight(after.scale) if exact.weight.shape == rounded.weight.shape else None
        if scale is None:  # the chip stores the synapses otherwise
            return 0.0
        used = exact.weight != 0
        apart = np.abs(rounded.weight * unit * scale - exact.weight)[used]
        parts.append((apart / np.abs(exact.weight[used])).ravel())
    errors = np.concatenate(parts)
    return float(np.median(errors)) if errors.size else 0.0
