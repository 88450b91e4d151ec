"""Diagnosis: layers that never spike or nearly always do, and the likely cause."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from runtime.activity import Activity
from runtime.chip import FixedPoint
from runtime.program import Layer, Program

Health = Literal["dead", "saturated", ""]
Cause = Literal[
    "policy", "input", "counts", "weights", "thresholds", "decays", "states", "rounding"
]

# a rate from which on a neuron says little more than that it is there
SATURATED = 0.9


@dataclass(frozen=True)
class Finding:
    """What is wrong with a layer on the chip.

    layer: name.
    health: "dead", not a spike; "saturated", more than 0.9 spikes for each neuron and timestep.
    cause: "policy", it is so in float too; "input", nothing arrives; "counts", neurons send several
        spikes in a timestep, and in float one; a rung of runtime.ablation, the first on which it is
        so; "rounding", of a chip that has no rungs.
    detail: the same with numbers.
    """

    layer: str
    health: Health
    cause: Cause
    detail: str


def health(spikes: NDArray[Any]) -> Health:
    """Of a layer with these spikes (B, T, N)."""
    rate = spikes.mean()
    return "dead" if rate == 0 else "saturated" if rate > SATURATED else ""


def diagnose(
    floats: Program | None,
    program: Program,
    raster: NDArray[Any],
    twin: Activity,
    rungs: Mapping[str, Activity],
) -> list[Finding]:
    """Findings of all layers of the program.

    floats: the network on the ideal chip; None where there are no rungs but the chip.
    twin: what the float twin does with the raster.
    rungs: what the rungs do, the last of them the chip itself.
    """
    return [
        Finding(layer.name, found, *_cause(floats, program, layer, raster, twin, rungs))
        for layer in program.layers
        if (found := health(_last(rungs).spikes[layer.name]))
    ]


def _cause(
    floats: Program | None,
    program: Program,
    layer: Layer,
    raster: NDArray[Any],
    twin: Activity,
    rungs: Mapping[str, Activity],
) -> tuple[Cause, str]:
    name, seen = layer.name, _last(rungs)
    found = health(seen.spikes[name])
    alike = health(twin.spikes[name]) == found
    if found == "dead" and not _driven(layer, {program.input: raster, **seen.spikes}):
        of = ", ".join(repr(s.source) for s in layer.synapses)
        also = ", in float too" if alike else ""
        return "input", f"nothing arrives: {of} is silent and there is no bias{also}"
    if alike:
        return "policy", "it is so in float too: the policy itself, not the chip"
    most, at_most = seen.spikes[name].max(), max(1, twin.spikes[name].max())
    if found == "saturated" and most > at_most:
        return "counts", f"neurons send up to {most} spikes in a timestep, in float {at_most}"
    if floats is None or program.chip.fixed is None:
        return "rounding", _unexplained(seen.saturations[name])
    rung = next(rung for rung, ran in rungs.items() if health(ran.spikes[name]) == found)
    return _detailed(rung, floats.layer(name), layer, program.chip.fixed, seen)


def _last(rungs: Mapping[str, Activity]) -> Activity:
    return list(rungs.values())[-1]


def _driven(layer: Layer, spikes: Mapping[str, NDArray[Any]]) -> bool:
    """Whether anything can arrive: spikes over a synapse, or a bias."""
    biased = layer.bias.any() or layer.voltage_bias.any()
    return bool(biased or any(spikes[s.source].any() for s in layer.synapses))


def _unexplained(saturations: int) -> str:
    if saturations:
        return f"{saturations} numbers overflow their registers: quantise with headroom"
    return "numbers are rounded; which of them decides is known for Loihi's arithmetic only"


def _detailed(
    rung: str, before: Layer, after: Layer, fixed: FixedPoint, seen: Activity
) -> tuple[Cause, str]:
    if rung == "weights":
        return "weights", _weights(before, after)
    if rung == "thresholds":
        return "thresholds", _thresholds(before, after)
    if rung == "decays":
        return "decays", _decays(before, after, fixed)
    saturations = seen.saturations[after.name]
    if saturations:
        return "states", f"{saturations} numbers overflow their registers: quantise with headroom"
    return "states", "currents and membranes lose their fractions in every timestep: scale up"


def _weights(before: Layer, after: Layer) -> str:
    held = np.concatenate([np.abs(s.weight) for s in before.synapses])
    kept = np.concatenate([s.weight for s in after.synapses])
    lost = (kept == 0) & (held > 0)
    share = held[lost].sum() / held.sum()
    return (
        f"{lost.sum()} of {(held > 0).sum()} weights round to 0, {share:.0%} of all that they "
        "weigh: more bits, or a scale for each channel"
    )


def _thresholds(before: Layer, after: Layer) -> str:
    held = np.where(before.threshold > 0, before.threshold, 1.0)
    off = after.threshold * after.scale - before.threshold
    n = int(np.argmax(np.abs(off) / held))
    push = np.abs(after.voltage_bias * after.scale - before.voltage_bias).max()
    return (
        f"neuron {n}: the threshold {before.threshold[n]:.4g} becomes "
        f"{(after.threshold * after.scale)[n]:.4g} beside the largest weight; biases move by up to "
        f"{push:.4g}: a scale for each channel, or smaller weights"
    )


def _decays(before: Layer, after: Layer, fixed: FixedPoint) -> str:
    kinds = {"current": "current_keep", "membrane": "membrane_keep"}
    worst = {
        kind: np.abs(getattr(after, field) / fixed.decay_one - getattr(before, field)).max()
        for kind, field in kinds.items()
    }
    kind = max(worst, key=lambda each: worst[each])
    held, kept = getattr(before, kinds[kind]), getattr(after, kinds[kind]) / fixed.decay_one
    n = int(np.argmax(np.abs(kept - held)))
    return (
        f"neuron {n}: the {kind} keeps {kept[n]:.6g} of itself, in float {held[n]:.6g}: choose a "
        f"time constant that is a multiple of 1/{fixed.decay_one}"
    )
