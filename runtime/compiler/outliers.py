"""Outliers: layers in which one large number leaves few bits of the chip for all others.

The scale of a layer makes its largest weight, bias or threshold the largest that fits. Where one
neuron, or the synapses of one source neuron, have numbers many times those of the others, these are
rounded to a few steps, or to nothing. The test is a trial: the layer is quantised once more as the
remedy would have it, and named only if its weights then lose much less.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.arithmetic import Arithmetic
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.errors import SpikedeployError

Floats = NDArray[np.float64]
# the layers of a network, of which one may be another, as the chip's integers
Quantiser = Callable[[Sequence[Layer], Quantisation], Sequence[Layer]]

# part of itself that rounding changes in the median weight, from which a layer is looked at
_COARSE = 0.05
# times less that it has to be with the remedy
_BETTER = 3.0
# times the median of the others from which a number is large
_LARGE = 10.0


class _Candidate(NamedTuple):
    """A large number, and the layer and choices as its remedy would have them."""

    found: str
    remedy: str
    layer: Layer
    quantisation: Quantisation


def outlier_remarks(
    arithmetic: Arithmetic,
    before: Sequence[Layer],
    after: Sequence[Layer],
    quantisation: Quantisation,
    quantise: Quantiser,
) -> list[str]:
    """A sentence on each layer that one large number makes coarse, with what would help.

    before, after: the layers in floats, and as quantised.
    """
    found: list[str] = []
    for place, (floats, integers) in enumerate(zip(before, after, strict=True)):
        coarse = _median_error(arithmetic, floats, integers) if arithmetic.rounds else 0.0
        for each in _candidates(arithmetic, floats, quantisation) if coarse >= _COARSE else ():
            try:
                tried = [*before[:place], each.layer, *before[place + 1 :]]
                rounded = quantise(tried, each.quantisation)[place]
            except SpikedeployError:
                continue
            if _median_error(arithmetic, each.layer, rounded) * _BETTER <= coarse:
                found.append(
                    f"layer {floats.name!r}: {each.found}, so that rounding changes half of its "
                    f"weights by {min(coarse, 1):.0%} and more: {each.remedy}"
                )
                break
    return found


def _candidates(
    arithmetic: Arithmetic, layer: Layer, quantisation: Quantisation
) -> Iterator[_Candidate]:
    """The neuron with large numbers, and source neurons with large weights."""
    fills = _fills(arithmetic, layer)
    reach = np.max(list(fills.values()), axis=0)
    if quantisation.granularity == "layer" and (large := _largest(reach)):
        (neuron, times), largest = large, max(fills, key=lambda what: float(fills[what].max()))
        found = f"the largest {largest} is {times:.3g} x the others', in neuron {neuron}"
        if "granularity" in arithmetic.choices:
            channel = replace(quantisation, granularity="channel")
            yield _Candidate(found, "--quantise channel", layer, channel)
        else:
            remedy = (
                f"divide the neuron's weights, bias and threshold by {times:.3g}, which changes "
                "nothing in float"
            )
            yield _Candidate(found, remedy, _divided(layer, reach), quantisation)
    for k, synapses in enumerate(layer.synapses):
        kernel = synapses.window is not None
        reach = np.abs(synapses.weight).max(axis=(0, 2, 3) if kernel else 1)
        if (large := _largest(reach)) is None:
            continue
        usual = float(np.median(reach[reach > 0]))
        factors = np.where(reach > _LARGE * usual, usual / np.maximum(reach, usual), 1.0)
        shape = (1, -1, 1, 1) if kernel else (-1, 1)
        less = replace(synapses, weight=synapses.weight * factors.reshape(shape))
        others = (*layer.synapses[:k], less, *layer.synapses[k + 1 :])
        source = f"from {synapses.source!r} {'channel' if kernel else 'number'} {large[0]}"
        yield _Candidate(
            f"the largest weight is {large[1]:.3g} x the others', {source}",
            "make its weights smaller and its spikes more, or give it several inputs; no scale of "
            "the chip helps all of its targets",
            replace(layer, synapses=others),
            quantisation,
        )


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
    most = float((1 << arithmetic.weight_bits) - 1)
    # of a Loihi, whose biases are wider than its weights
    mantissa = getattr(arithmetic, "bias_mantissa_max", 0)
    wide = (mantissa << getattr(arithmetic, "bias_exponent_max", 0)) >> shift
    weights = [s.over_axons(np.abs(s.weight), np.maximum) for s in layer.synapses]
    found = {
        "weight": np.max(weights, axis=0) / most,
        "bias": np.maximum(np.abs(layer.bias) / most, np.abs(layer.voltage_bias) / (wide or most)),
    }
    if layer.spiking:
        held = max(arithmetic.threshold_range[1] >> shift, 1)
        found["threshold"] = np.abs(layer.threshold) / held
    channels = {len(s.weight) for s in layer.synapses if s.window is not None}
    for of in channels:  # neurons that share a kernel share a scale
        found = {
            what: np.repeat(each.reshape(of, -1).max(axis=1), layer.size // of)
            for what, each in found.items()
        }
    return found


def _divided(layer: Layer, reach: Floats) -> Layer:
    """Return the layer with all neurons scaled to one size, which changes nothing in float."""
    with np.errstate(over="ignore"):  # what is so small that no float is its factor is as 0
        factors = np.divide(reach.max(), reach, out=np.ones(layer.size), where=reach > 0)
    factors[np.isinf(factors)] = 1.0
    return replace(
        layer,
        synapses=tuple(s.scaled(factors) for s in layer.synapses),
        **{n: getattr(layer, n) * factors for n in ("bias", "voltage_bias", "threshold")},
    )


def _median_error(arithmetic: Arithmetic, before: Layer, after: Layer) -> float:
    """Return the median relative error that rounding causes in the non-zero weights."""
    # state units of a weight's unit, where the chip has a register of a finer kind for states
    unit = float(1 << getattr(arithmetic, "mantissa_shift", 0))
    parts = []
    for exact, rounded in zip(before.synapses, after.synapses, strict=True):
        scale = exact.by_weight(after.scale) if exact.weight.shape == rounded.weight.shape else None
        if scale is None:  # the chip stores the synapses otherwise
            return 0.0
        held = rounded.weight * unit * scale
        used = exact.weight != 0
        parts.append((np.abs(held - exact.weight)[used] / np.abs(exact.weight[used])).ravel())
    errors = np.concatenate(parts) if parts else np.zeros(0)
    return float(np.median(errors)) if errors.size else 0.0
