"""Diagnosis: dead and saturated layers with the likely cause, and the first spike that differs."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.analysis.activity import Activity
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program

Health = Literal["dead", "saturated", ""]
Cause = Literal[
    "policy", "input", "counts", "weights", "thresholds", "decays", "states", "rounding"
]

# [spikes for each neuron and timestep] beyond it a rate carries little information
_SATURATED = 0.9


@dataclass(frozen=True)
class Finding:
    """What is wrong with a layer on the chip.

    layer: name.
    health: "dead", not a spike; "saturated", more than 0.9 spikes for each neuron and timestep.
    cause: "policy", it is so in float too; "input", nothing arrives; "counts", neurons send several
        spikes in a timestep, and in float one; a rounding step, the first after which it is
        so; "rounding", of a chip without ablation steps.
    detail: the same with numbers.
    """

    layer: str
    health: Health
    cause: Cause
    detail: str


def health(spikes: NDArray[Any]) -> Health:
    """Of a layer with these spikes (B, T, N)."""
    rate = spikes.mean()
    return "dead" if rate == 0 else "saturated" if rate > _SATURATED else ""


def diagnose(
    floats: Program | None,
    program: Program,
    raster: NDArray[Any],
    twin: Activity,
    steps: Mapping[str, Activity],
) -> list[Finding]:
    """Findings of all layers of the program that can spike.

    floats: the network on the ideal chip; None where there are no ablation steps but the chip.
    twin: what the float twin does with the raster.
    steps: what each ablation step does, the last of them the chip itself.
    """
    return [
        Finding(layer.name, found, *_cause(floats, program, layer, raster, twin, steps))
        for layer in program.spiking
        if (found := health(_last(steps).spikes[layer.name]))
    ]


def _cause(
    floats: Program | None,
    program: Program,
    layer: Layer,
    raster: NDArray[Any],
    twin: Activity,
    steps: Mapping[str, Activity],
) -> tuple[Cause, str]:
    name, seen = layer.name, _last(steps)
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
    if floats is None:
        return "rounding", _unexplained(seen.saturations[name])
    step = next(step for step, ran in steps.items() if health(ran.spikes[name]) == found)
    return _detailed(step, floats.layer(name), layer, program.chip.arithmetic.decay_one, seen)


def _last(steps: Mapping[str, Activity]) -> Activity:
    return list(steps.values())[-1]


def _driven(layer: Layer, spikes: Mapping[str, NDArray[Any]]) -> bool:
    """Whether anything can arrive: spikes over a synapse, or a bias."""
    biased = layer.bias.any() or layer.voltage_bias.any()
    return bool(biased or any(spikes[s.source].any() for s in layer.synapses))


def _unexplained(saturations: int) -> str:
    if saturations:
        return f"{saturations} numbers overflow their registers: quantise with headroom"
    return "numbers are rounded; which of them decides is known for Loihi's arithmetic only"


def _detailed(
    step: str, before: Layer, after: Layer, decay_one: int, seen: Activity
) -> tuple[Cause, str]:
    if step == "weights":
        return "weights", _weights(before, after)
    if step == "thresholds":
        return "thresholds", _thresholds(before, after)
    if step == "decays":
        return "decays", _decays(before, after, decay_one)
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


def _decays(before: Layer, after: Layer, decay_one: int) -> str:
    kinds = {"current": "current_decay", "membrane": "membrane_decay"}
    worst = {
        kind: np.abs(getattr(after, field) / decay_one - getattr(before, field)).max()
        for kind, field in kinds.items()
    }
    kind = max(worst, key=lambda each: worst[each])
    held, kept = getattr(before, kinds[kind]), getattr(after, kinds[kind]) / decay_one
    n = int(np.argmax(np.abs(kept - held)))
    return (
        f"neuron {n}: the {kind} keeps {kept[n]:.6g} of itself, in float {held[n]:.6g}: choose a "
        f"time constant that is a multiple of 1/{decay_one}"
    )


@dataclass(frozen=True)
class Divergence:
    """Where a neuron's spikes differ, and its membranes before any reset [float units].

    inference, timestep, neuron: counted from 0.
    layer: name of the node.
    float_spikes, chip_spikes: of the neuron in the timestep.
    float_membrane, chip_membrane: NaN where a recording cannot tell.
    float_threshold, chip_threshold: above which the neuron spikes.
    """

    inference: int
    timestep: int
    layer: str
    neuron: int
    float_spikes: int
    chip_spikes: int
    float_membrane: float
    chip_membrane: float
    float_threshold: float
    chip_threshold: float

    def as_json(self) -> dict[str, Any]:
        """The fields."""
        return asdict(self)

    def describe(self) -> str:
        """The same in words."""
        return (
            f"inference {self.inference}, timestep {self.timestep}, layer {self.layer!r}, neuron "
            f"{self.neuron}; spikes on the chip: {self.chip_spikes} (membrane "
            f"{_shown(self.chip_membrane)}, threshold {self.chip_threshold:.6g}), in float: "
            f"{self.float_spikes} ({_shown(self.float_membrane)}, {self.float_threshold:.6g})"
        )


def _shown(membrane: float) -> str:
    return "not known before its reset" if np.isnan(membrane) else f"{membrane:.6g}"


def first(twin: Activity, seen: Activity, layers: Iterable[str]) -> Divergence | None:
    """The earliest of the first inference that differs; of one timestep the first layer's.

    twin, seen: of the float twin and of the chip.
    layers: in the order of the spikes.
    """
    found = [
        (inference, timestep, place, neuron, name)
        for place, name in enumerate(layers)
        for inference, timestep, neuron in _first(twin, seen, name)
    ]
    if not found:
        return None
    inference, timestep, _, neuron, name = min(found)
    here = (inference, timestep, neuron)
    return Divergence(
        inference=inference,
        timestep=timestep,
        layer=name,
        neuron=neuron,
        float_spikes=int(twin.spikes[name][here]),
        chip_spikes=int(seen.spikes[name][here]),
        float_membrane=float(twin.reached[name][here]),
        chip_membrane=float(seen.reached[name][here]),
        float_threshold=float(twin.thresholds[name][neuron]),
        chip_threshold=float(seen.thresholds[name][neuron]),
    )


def _first(twin: Activity, seen: Activity, name: str) -> list[tuple[int, int, int]]:
    """(inference, timestep, neuron) of a layer's first difference, if there is one."""
    different = np.argwhere(twin.spikes[name] != seen.spikes[name])[:1]
    return [(int(b), int(t), int(n)) for b, t, n in different]
