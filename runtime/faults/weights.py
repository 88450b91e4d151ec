"""Weights that are stuck at 0 or at their largest magnitude, or have one flipped bit.

Only stored weights are hit, those that are not 0. A weight is held in `weight_bits` of the chip, in
two's complement where it has a sign of its own; the last bit is what the chip's step leaves.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults.fault import Fault, drawn

Integers = NDArray[np.int64]
# stored weights (k,) in steps of the chip, bits, whether one is the sign, generator -> new ones
_New = Callable[[Integers, int, bool, np.random.Generator], Integers]


def _hurt(new: _New) -> Callable[..., tuple[Sequence[Layer], int, int]]:
    """A fault that replaces a share of the stored weights."""

    def hurt(
        program: Program, number: float, rng: np.random.Generator
    ) -> tuple[Sequence[Layer], int, int]:
        _check_own_weights(program)
        every = [s for layer in program.layers for s in layer.synapses]
        counts = [int(np.count_nonzero(s.weight)) for s in every]
        hit = drawn(sum(counts), number, rng)
        parts = iter(np.split(hit, np.cumsum(counts)[:-1]))
        layers = [
            replace(
                a, synapses=tuple(_replaced(s, next(parts), program, new, rng) for s in a.synapses)
            )
            for a in program.layers
        ]
        return layers, int(hit.sum()), sum(counts)

    return hurt


def _replaced(
    synapses: Synapses,
    hit: NDArray[np.bool_],
    program: Program,
    new: _New,
    rng: np.random.Generator,
) -> Synapses:
    """The synapses with new weights where stored ones are hit."""
    if not hit.any():
        return synapses
    arithmetic = program.chip.arithmetic
    flat = synapses.weight.astype(np.int64).ravel()
    places = np.flatnonzero(flat)[hit]
    step = _step(flat)
    flat[places] = step * new(
        flat[places] // step, arithmetic.weight_bits, arithmetic.weights_have_signs, rng
    )
    weight = flat.reshape(synapses.weight.shape).astype(synapses.weight.dtype)
    return replace(synapses, weight=weight)


def _step(weights: Integers) -> int:
    """The step of weights: the largest power of two that divides all of them."""
    together = int(np.bitwise_or.reduce(np.abs(weights)))
    return together & -together


def _zero(steps: Integers, bits: int, signed: bool, rng: np.random.Generator) -> Integers:
    return np.zeros_like(steps)


def _largest(steps: Integers, bits: int, signed: bool, rng: np.random.Generator) -> Integers:
    """The largest magnitude, with the sign that each has."""
    return np.asarray(np.sign(steps) * ((1 << (bits - signed)) - 1))


def _flipped(steps: Integers, bits: int, signed: bool, rng: np.random.Generator) -> Integers:
    """One bit of each flipped, drawn; of the magnitude alone where something else has the sign."""
    bit = np.int64(1) << rng.integers(bits, size=steps.shape)
    if not signed:
        return np.asarray(np.sign(steps) * (np.abs(steps) ^ bit))
    stored = (steps & ((1 << bits) - 1)) ^ bit
    return np.asarray(np.where(stored >> (bits - 1), stored - (1 << bits), stored))


def _check_own_weights(program: Program) -> None:
    if not program.chip.arithmetic.own_weights:
        raise ConfigError(
            f"--fault: on {program.chip.name} a neuron has one weight for all axons of a type, so "
            "no synapse has one that could fail by itself. Choose a fault of neurons or spikes."
        )


STUCK_ZERO = Fault(
    meaning="weights that are stuck at 0",
    unit="share of the stored weights",
    levels=(0.01, 0.05, 0.1),
    bounds=(0.0, 1.0),
    what="weights",
    source="about a tenth of the cells of a resistive memory were stuck (Chen et al. 2015)",
    hurt=_hurt(_zero),
)
STUCK_MAX = Fault(
    meaning="weights that are stuck at the largest magnitude, with the sign that they have",
    unit="share of the stored weights",
    levels=(0.001, 0.005, 0.02),
    bounds=(0.0, 1.0),
    what="weights",
    source="chosen: fewer than those at 0, since each does more",
    hurt=_hurt(_largest),
)
WEIGHT_FLIPS = Fault(
    meaning="weights with one flipped bit, the sign's too where a weight has one",
    unit="share of the stored weights",
    levels=(0.001, 0.005, 0.02),
    bounds=(0.0, 1.0),
    what="weights",
    source="chosen: bit error rates of SRAM of 1e-4 to 3e-3 at 8 bits, as at low voltages",
    hurt=_hurt(_flipped),
)
