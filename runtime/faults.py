"""Faults of chips: parts of a program that are broken, and upsets while it runs.

`inject(program, faults(["dead-neurons:2"]))` is the program on a faulty chip. Which parts are hit
is drawn from the specimen, a number: another specimen is another chip with as many faults. Broken
parts are in the program's numbers; upsets are left to the interpreter. A new fault is a table in
faults.toml, and a function where it breaks parts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.damage import Damage, Upset, Upsets
from spikedeploy.runtime.chips.layer import NEVER, Layer, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_toml
from spikedeploy.runtime.requests import Request, Scale, parse_requests

Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
# a program, a number and a generator -> its layers with the fault, how many were hit, of how many
Hit: TypeAlias = tuple[Sequence[Layer], int, int]
Break = Callable[[Program, float, np.random.Generator], Hit]
# stored weights (k,) in steps of the chip, bits, whether one is the sign, generator -> new ones
ChangeWeights = Callable[[Integers, int, bool, np.random.Generator], Integers]


@dataclass(frozen=True)
class Fault(Scale):
    """A kind of fault; without `damage_layers` it comes and goes while the chip runs.

    meaning: what is wrong, in a clause.
    what: the parts that are counted.
    source: where the levels come from.
    damage_layers: returns the layers of a program with the fault; how many parts it hit, of how
        many.
    """

    meaning: str
    what: str
    source: str
    damage_layers: Break | None = None


@dataclass(frozen=True)
class Faults:
    """All faults of a chip.

    each: in the order in which they were given.
    specimen: which chip of its kind it is: it decides which parts are hit.
    """

    each: tuple[Request, ...] = ()
    specimen: int = 0

    def __bool__(self) -> bool:
        return bool(self.each)


NONE = Faults()


def faults(texts: Sequence[str], specimen: int = 0) -> Faults:
    """The faults of texts such as `name:level` and `name=number`; those of 0 are left out."""
    try:
        found = parse_requests(texts, "--fault", "a chip", FAULTS)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return Faults(tuple(each for each in found if each.number), specimen)


def inject(program: Program, faults: Faults) -> Program:
    """The program with the faults; its `damage` says what they hit."""
    if faults and any(layer.threshold.dtype.kind == "f" for layer in program.layers):
        raise ConfigError(
            f"--fault: chip {program.chip.name!r} computes in floats, and faults are modelled in "
            "the integers of a chip. Choose another chip, such as loihi1."
        )
    upsets: list[Upset] = []
    for each in faults.each:
        kind = FAULTS[each.name]
        if kind.damage_layers is None:
            upsets.append(Upset(each.text, each.name, each.number, kind.what))
            continue
        rng = np.random.default_rng([faults.specimen, crc32(each.name.encode())])
        layers, hit, of = kind.damage_layers(program, each.number, rng)
        damage = Damage(each.text, each.name, each.number, hit, of, kind.what)
        program = replace(program, layers=tuple(layers), damage=(*program.damage, damage))
    return replace(program, upsets=Upsets(tuple(upsets), faults.specimen)) if upsets else program


def _draw_hits(size: int, share: float, rng: np.random.Generator) -> Mask:
    """Draw a mask (size,) of hits: this share, at least one; a larger share includes these."""
    hit = np.zeros(size, np.bool_)
    hit[rng.permutation(size)[: max(1, round(share * size)) if share else 0]] = True
    return hit


# neurons: those of all spiking layers are drawn together


def _split_by_layer(program: Program, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    ends = np.cumsum([layer.size for layer in program.spiking])[:-1]
    parts = np.split(values, ends)
    return {layer.name: part for layer, part in zip(program.spiking, parts, strict=True)}


def _kill_neurons(program: Program, number: float, rng: np.random.Generator) -> Hit:
    of = sum(layer.size for layer in program.spiking)
    hit = _draw_hits(of, number, rng) if of else np.zeros(0, np.bool_)
    alive = _split_by_layer(program, ~hit)
    layers = [_silence(a, alive[a.name]) if a.name in alive else a for a in program.layers]
    return layers, int(hit.sum()), of


def _silence(layer: Layer, keep: Mask) -> Layer:
    """The layer with neurons that nothing reaches, so that their membranes stay at 0.

    What shares a kernel is reached all the same, and never spikes.
    """
    # a threshold of 0 may count as reached
    dead = np.maximum(layer.threshold, 1)
    if any(s.window is not None for s in layer.synapses):
        dead = np.full_like(layer.threshold, np.inf if layer.threshold.dtype.kind == "f" else NEVER)
    return replace(
        layer,
        synapses=tuple(
            s
            if s.window is not None
            else replace(s, weight=np.where(keep, s.weight, 0).astype(s.weight.dtype))
            for s in layer.synapses
        ),
        bias=layer.bias * keep,
        voltage_bias=layer.voltage_bias * keep,
        threshold=np.where(keep, layer.threshold, dead),
    )


def _vary_thresholds(program: Program, number: float, rng: np.random.Generator) -> Hit:
    of = sum(layer.size for layer in program.spiking)
    factors = _split_by_layer(program, 1.0 + number * rng.standard_normal(of))
    step, largest = program.chip.arithmetic.threshold_range
    layers, hit = [], 0
    for layer in program.layers:
        threshold = layer.threshold
        if layer.name in factors:
            steps = np.rint(threshold * factors[layer.name] / step)
            varied = np.clip(steps, 1, largest // step).astype(threshold.dtype) * step
            # what is dead stays so
            threshold = np.where(threshold < NEVER, varied, threshold)
        hit += int(np.count_nonzero(threshold != layer.threshold))
        layers.append(replace(layer, threshold=threshold))
    return layers, hit, of


# weights: only stored ones are hit, those that are not 0. A weight is held in `weight_bits` of the
# chip, in two's complement where it has a sign of its own; the last bit is what its step leaves


def _change_weights(change: ChangeWeights) -> Break:
    def damage_layers(program: Program, number: float, rng: np.random.Generator) -> Hit:
        if not program.chip.arithmetic.own_weights:
            raise ConfigError(
                f"--fault: on {program.chip.name} a neuron has one weight for all axons of a type, "
                "so no synapse has one that could fail by itself. Choose a fault of neurons or "
                "spikes."
            )
        every = [s for layer in program.layers for s in layer.synapses]
        counts = [int(np.count_nonzero(s.weight)) for s in every]
        hit = _draw_hits(sum(counts), number, rng)
        parts = iter(np.split(hit, np.cumsum(counts)[:-1]))
        layers = []
        for layer in program.layers:
            hit_ones = (_replace_hit(s, next(parts), program, change, rng) for s in layer.synapses)
            layers.append(replace(layer, synapses=tuple(hit_ones)))
        return layers, int(hit.sum()), sum(counts)

    return damage_layers


def _replace_hit(
    synapses: Synapses,
    hit: Mask,
    program: Program,
    change: ChangeWeights,
    rng: np.random.Generator,
) -> Synapses:
    """The synapses with new weights where stored ones are hit."""
    if not hit.any():
        return synapses
    arithmetic = program.chip.arithmetic
    flat = synapses.weight.astype(np.int64).ravel()
    places = np.flatnonzero(flat)[hit]
    # the step of the chip: the largest power of two that divides all weights
    together = int(np.bitwise_or.reduce(np.abs(flat)))
    step = together & -together
    flat[places] = step * change(
        flat[places] // step, arithmetic.weight_bits, arithmetic.weights_have_signs, rng
    )
    weight = flat.reshape(synapses.weight.shape).astype(synapses.weight.dtype)
    return replace(synapses, weight=weight)


def _zeros(steps: Integers, bits: int, signed: bool, rng: np.random.Generator) -> Integers:
    return np.zeros_like(steps)


def _largest(steps: Integers, bits: int, signed: bool, rng: np.random.Generator) -> Integers:
    return np.asarray(np.sign(steps) * ((1 << (bits - signed)) - 1))


def _flip_bits(steps: Integers, bits: int, signed: bool, rng: np.random.Generator) -> Integers:
    """Flip one random bit of each number; of the magnitude only, where the sign is elsewhere."""
    bit = np.int64(1) << rng.integers(bits, size=steps.shape)
    if not signed:
        return np.asarray(np.sign(steps) * (np.abs(steps) ^ bit))
    stored = (steps & ((1 << bits) - 1)) ^ bit
    return np.asarray(np.where(stored >> (bits - 1), stored - (1 << bits), stored))


_DAMAGE: dict[str, Break] = {
    "dead-neurons": _kill_neurons,
    "threshold-mismatch": _vary_thresholds,
    "stuck-zero": _change_weights(_zeros),
    "stuck-max": _change_weights(_largest),
    "weight-flips": _change_weights(_flip_bits),
}
_GIVEN: dict[str, dict[str, Any]] = read_toml(Path(__file__).with_suffix(".toml"))
FAULTS = {name: Fault(**given, damage_layers=_DAMAGE.get(name)) for name, given in _GIVEN.items()}
