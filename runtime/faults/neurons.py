"""Dead neurons, and neurons whose thresholds differ from what was compiled."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.faults.fault import Fault, drawn


def _each(program: Program, values: NDArray[np.generic]) -> dict[str, NDArray[np.generic]]:
    """What belongs to each spiking layer of an array over all their neurons."""
    ends = np.cumsum([layer.size for layer in program.spiking])[:-1]
    parts = np.split(values, ends)
    return {layer.name: part for layer, part in zip(program.spiking, parts, strict=True)}


def _neurons(program: Program) -> int:
    return sum(layer.size for layer in program.spiking)


def _dead(
    program: Program, number: float, rng: np.random.Generator
) -> tuple[Sequence[Layer], int, int]:
    of = _neurons(program)
    hit = drawn(of, number, rng) if of else np.zeros(0, np.bool_)
    alive = _each(program, ~hit)
    layers = [_silenced(a, alive[a.name]) if a.name in alive else a for a in program.layers]
    return layers, int(hit.sum()), of


def _silenced(layer: Layer, alive: NDArray[np.generic]) -> Layer:
    """The layer with neurons that nothing reaches, so that their membranes stay at 0."""
    keep = alive.astype(np.bool_)
    return replace(
        layer,
        synapses=tuple(
            replace(s, weight=np.where(keep, s.weight, 0).astype(s.weight.dtype))
            for s in layer.synapses
        ),
        bias=layer.bias * keep,
        voltage_bias=layer.voltage_bias * keep,
        # a threshold of 0 may count as reached
        threshold=np.where(keep, layer.threshold, np.maximum(layer.threshold, 1)),
    )


def _mismatched(
    program: Program, number: float, rng: np.random.Generator
) -> tuple[Sequence[Layer], int, int]:
    factors = _each(program, 1.0 + number * rng.standard_normal(_neurons(program)))
    step, largest = program.chip.arithmetic.threshold_range
    layers, hit = [], 0
    for layer in program.layers:
        if layer.name not in factors:
            layers.append(layer)
            continue
        whole = np.rint(layer.threshold * factors[layer.name].astype(np.float64) / step)
        threshold = np.clip(whole, 1, largest // step).astype(layer.threshold.dtype) * step
        hit += int(np.count_nonzero(threshold != layer.threshold))
        layers.append(replace(layer, threshold=threshold))
    return layers, hit, _neurons(program)


DEAD_NEURONS = Fault(
    meaning="neurons that never spike; readouts, which are actuators' own, are spared",
    unit="share of the neurons",
    levels=(0.02, 0.05, 0.1),
    bounds=(0.0, 1.0),
    what="neurons",
    source="chosen, as in fault-injection studies of SNNs (Spyrou et al. 2021)",
    hurt=_dead,
)
THRESHOLD_MISMATCH = Fault(
    meaning="thresholds that differ from neuron to neuron",
    unit="standard deviation, share of a threshold",
    levels=(0.05, 0.1, 0.2),
    bounds=(0.0, 1.0),
    what="neurons",
    source="device mismatch of mixed-signal neurons is about 0.2 (Zendrikov et al. 2023); digital "
    "chips have none",
    hurt=_mismatched,
)
