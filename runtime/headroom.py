"""Headroom: the largest scale at which no register of the chip can overflow, whatever the spikes.

The widths count even where a reading of the chip does not model what happens beyond them.
"""

from dataclasses import replace

import numpy as np

from runtime.bounds import bounds
from runtime.chip import FixedPoint
from runtime.errors import RuleError
from runtime.program import Layer, Program
from runtime.quantisation import Quantisation
from runtime.quantize import quantise

# rounding may lift a bound a little over its register again; each round takes away what is over
ROUNDS = 50
SLACK = 1e-3


def with_headroom(
    program: Program,
    floats: list[Layer],
    fixed: FixedPoint,
    quantisation: Quantisation,
    timesteps: int | None,
) -> Program:
    """The program with layers that are quantised anew, so that nothing can overflow.

    floats: its layers before they were quantised.
    timesteps: T of an inference; None is a state that is never reset.
    """
    layers = (_proven(program, a, fixed, quantisation, timesteps) for a in floats)
    return replace(program, layers=tuple(layers))


def excess(program: Program, layer: Layer, fixed: FixedPoint, timesteps: int | None) -> float:
    """How many times the largest that fits its register a number of the layer can become."""
    worst = bounds(program, layer, fixed, timesteps)
    push = worst.current + float(np.abs(layer.voltage_bias).max(initial=0))
    return max(
        worst.drive / fixed.accumulator.limit,
        worst.current / fixed.current.limit,
        push / fixed.push.limit,
        worst.above / fixed.membrane.limit,
        worst.below / fixed.membrane.limit,
    )


def _proven(
    program: Program,
    layer: Layer,
    fixed: FixedPoint,
    quantisation: Quantisation,
    timesteps: int | None,
) -> Layer:
    each = quantisation.granularity == "channel"
    share = np.ones(layer.size if each else 1)
    for _ in range(ROUNDS):
        quantised = quantise(layer, fixed, quantisation, share if each else float(share[0]))
        parts = [_alone(quantised, n) for n in range(layer.size)] if each else [quantised]
        over = np.array([excess(program, part, fixed, timesteps) for part in parts])
        if (over <= 1).all():
            return quantised
        if not np.isfinite(over).all():
            break
        share = np.where(over > 1, share / over * (1 - SLACK), share)
    raise RuleError(
        f"rule headroom: layer {layer.name!r}: no scale keeps its membranes from overflowing for "
        "ever, since they do not leak. Choose headroom 'none', or calibrate it on recorded inputs."
    )


def _alone(layer: Layer, n: int) -> Layer:
    """The layer with one of its neurons."""
    return replace(
        layer,
        synapses=tuple(replace(s, weight=s.weight[:, n : n + 1]) for s in layer.synapses),
        **{
            name: getattr(layer, name)[n : n + 1]
            for name in ("bias", "voltage_bias", "threshold", "current_keep", "membrane_keep")
        },
    )
