"""Ablation: a network on its way to the chip, one kind of rounding after another.

Each rung is computed in float64, on the chip's scale, so that what differs between two rungs is the
one thing that was rounded. The last rung is the chip.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from runtime.chip import FixedPoint, chip
from runtime.program import Layer, Program

RUNGS = ("weights", "thresholds", "decays", "states")


def rungs(floats: Program, program: Program) -> Iterator[tuple[str, Program]]:
    """The programs from rounded weights to the chip; none where the arithmetic is not Loihi's.

    floats: the same network on the ideal chip.
    """
    fixed = program.chip.fixed
    if fixed is None:
        return
    # delays are the chip's on every rung
    ideal = replace(chip("ideal"), delay_max=program.chip.delay_max)
    for rung in RUNGS[:-1]:
        layers = tuple(_rounded(floats.layer(a.name), a, fixed, rung) for a in program.layers)
        yield rung, replace(program, chip=ideal, layers=layers)
    yield RUNGS[-1], program


def _rounded(before: Layer, after: Layer, fixed: FixedPoint, rung: str) -> Layer:
    """The layer in float64 and state units, rounded as far as the rung."""
    units, one = 1.0 / after.scale, float(1 << fixed.mantissa_shift)
    thresholds, decays = rung != "weights", rung == "decays"
    return replace(
        after,
        synapses=tuple(
            replace(s, weight=s.weight.astype(np.float64) * one) for s in after.synapses
        ),
        bias=after.bias * one,
        threshold=after.threshold.astype(np.float64) if thresholds else before.threshold * units,
        voltage_bias=after.voltage_bias * 1.0 if thresholds else before.voltage_bias * units,
        current_keep=after.current_keep / fixed.decay_one if decays else before.current_keep,
        membrane_keep=after.membrane_keep / fixed.decay_one if decays else before.membrane_keep,
    )
