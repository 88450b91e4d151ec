"""Drift: how far a chip is from the float twin, where that begins, and what causes it.

The cause is found by ablation: the network is rounded step by step, one kind of number after
another. Each step is computed in float64, on the chip's scale, so that what differs between two
steps is the one thing that was rounded. The last step is the chip.

Layers that never spike, or nearly always do, are findings: each has its likely cause.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.analysis.activity import TAU, Activity, activity, mean_distance, trains_of
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ObservationError

Floats: TypeAlias = NDArray[np.float64]
Health = Literal["dead", "saturated", ""]
# of the cause of a dead or saturated layer, an ablation step
_DETAILS = {
    "clock": "layers run on in the timesteps of the chip",
    "weights": "weights round to few steps or to 0: more bits, or a scale for each channel",
    "thresholds": "thresholds and biases round beside the largest weight: a scale for each channel",
    "decays": "decays are rounded: choose time constants that the chip has",
    "states": "currents and membranes lose their fractions in every timestep: scale up",
    "rounding": "numbers are rounded; which of them decides is known for Loihi's arithmetic only",
}

# [spikes for each neuron and timestep] beyond it a rate carries little information
_SATURATED = 0.9


@dataclass(frozen=True)
class _LayerDrift:
    """Differences of a layer's spikes from the float twin's.

    name: of the node.
    neurons: N.
    float_rate, chip_rate: spikes for each neuron and timestep.
    differing: part of neuron-timesteps in which the number of spikes differs.
    distance: of van Rossum, mean over inferences and neurons; a spike too many is 1/2.
    lost, woken: neurons that spike in float but never on the chip, and vice versa.
    saturations: numbers that did not fit a register.
    first: (inference, timestep, neuron) of the first difference, or None.
    filled: largest part of its register that a current took; None where that is not known.
    """

    name: str
    neurons: int
    float_rate: float
    chip_rate: float
    differing: float
    distance: float
    lost: int
    woken: int
    saturations: int
    first: tuple[int, int, int] | None
    filled: float | None = None


@dataclass(frozen=True)
class _ReadoutDrift:
    """Differences of a readout layer's membranes from the float twin's.

    name: of the node.
    neurons: N.
    rms: root of the mean square of the differences [float units].
    range: largest magnitude in float [float units].
    filled: largest part of a register that a current or membrane took on these inputs; None where
        states are floats.
    saturations: numbers that did not fit a register.
    """

    name: str
    neurons: int
    rms: float
    range: float
    filled: float | None
    saturations: int


@dataclass(frozen=True)
class OutputDrift:
    """Distances of the outputs of chip and float twin.

    kind: "action", after the codec; "choice", where the codec chooses one of several; "output", of
        the readout in each timestep, or spikes.
    rms: root of the mean square of the differences; of choices the part that differs.
    largest: difference; of choices 1 where any differs.
    """

    kind: Literal["action", "choice", "output"]
    rms: float
    largest: float


@dataclass(frozen=True)
class Divergence:
    """A timestep at which spikes of a neuron differ, its membranes before any reset [float units].

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

    def describe(self) -> str:
        """Describe the divergence in words."""
        membranes = [
            "not known before its reset" if np.isnan(membrane) else f"{membrane:.6g}"
            for membrane in (self.chip_membrane, self.float_membrane)
        ]
        return (
            f"inference {self.inference}, timestep {self.timestep}, layer {self.layer!r}, neuron "
            f"{self.neuron}; spikes on the chip: {self.chip_spikes} (membrane {membranes[0]}, "
            f"threshold {self.chip_threshold:.6g}), in float: {self.float_spikes} ({membranes[1]}, "
            f"{self.float_threshold:.6g})"
        )


@dataclass(frozen=True)
class _AblationStep:
    """The network with some of the chip's roundings.

    name: of the rounding that was added last.
    distance: layer -> of van Rossum, as in _LayerDrift.
    output: against the float twin.
    """

    name: str
    distance: Mapping[str, float]
    output: OutputDrift


@dataclass(frozen=True)
class Finding:
    """A layer that is dead or saturated on the chip.

    layer: name.
    health: "dead", not a spike; "saturated", more than 0.9 spikes for each neuron and timestep.
    cause: "policy", it is so in float too; "input", nothing arrives; "counts", neurons send several
        spikes in a timestep, and in float one; a rounding step, the first after which it is
        so; "rounding", of a chip without ablation steps.
    detail: what happens, and what helps, in words.
    """

    layer: str
    health: Health
    cause: str
    detail: str


@dataclass(frozen=True)
class Drift:
    """Comparison of a chip with the float twin on a raster.

    chip: its name.
    quantisation: in words.
    inferences, timesteps: B and T of the raster.
    tau: [timesteps] of the distance.
    layers: in the order of the spikes.
    diverged: inferences in which any spike differs.
    first: difference, None where there is none.
    output: of the whole network.
    ablation: from rounded weights to the chip; empty where the arithmetic has none.
    findings: layers that are dead or saturated.
    readouts: layers on the chip whose membranes leave it.
    remarks: on layers that one large number makes coarse (runtime.compiler.outliers).
    """

    chip: str
    quantisation: str
    inferences: int
    timesteps: int
    tau: float
    layers: tuple[_LayerDrift, ...]
    diverged: int
    first: Divergence | None
    output: OutputDrift
    ablation: tuple[_AblationStep, ...]
    findings: tuple[Finding, ...]
    readouts: tuple[_ReadoutDrift, ...] = ()
    remarks: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The fields, plain; the ablation is called rungs there."""
        return {"rungs" if key == "ablation" else key: value for key, value in asdict(self).items()}


def drift(
    artifact: Artifact,
    on: Chip,
    raster: NDArray[np.uint8],
    quantisation: Quantisation = PLAIN,
    tau: float = TAU,
    limits: bool = True,
    episodes: Sequence[int] = (),
) -> Drift:
    """Compare the chip with the float twin on the raster (B, T, M).

    limits: refuse what breaks a design rule of the chip.
    episodes: inferences of each episode in the raster; empty where it is a single one.

    Where the convention keeps states, the inferences of an episode follow one another; else each
    begins anew.
    """
    _check_raster(artifact, raster, episodes)
    program = compile_program(artifact, on, quantisation, limits=limits)
    floats, steps = None, [("chip", program)]
    if on.arithmetic.ablation_steps:
        floats = compile_program(artifact, chip("ideal"), clock=program.clock)
        steps = list(_ablation_programs(floats, program))
        own = program.clock == own_clock(artifact.convention)
        if artifact.convention.state == "kept" and not own:
            steps = [("clock", floats), *steps]
    trains = trains_of(artifact, raster, episodes)
    twin = activity(artifact, None, raster, episodes)
    runs = {name: activity(artifact, step, raster, episodes) for name, step in steps}
    seen = runs[steps[-1][0]]
    names = [layer.name for layer in program.spiking]
    differ = [(twin.spikes[name] != seen.spikes[name]).any(axis=(1, 2)) for name in names]
    ablation = [
        _AblationStep(
            name,
            {n: mean_distance(twin.spikes[n], rows, tau, trains) for n, rows in run.spikes.items()},
            _output_drift(artifact, twin.output, run.output),
        )
        for name, run in (runs.items() if floats else ())
    ]
    return Drift(
        chip=on.name,
        quantisation=quantisation.describe(),
        inferences=raster.shape[0],
        timesteps=raster.shape[1],
        tau=tau,
        layers=tuple(_layer_drift(name, twin, seen, tau, trains) for name in names),
        diverged=int(np.any(differ, axis=0).sum()) if names else 0,
        first=first_divergence(twin, seen, names),
        output=_output_drift(artifact, twin.output, seen.output),
        ablation=tuple(ablation),
        findings=tuple(diagnose(program, raster, twin, runs)),
        readouts=tuple(_readout_drift(name, twin, seen) for name in seen.membranes),
        remarks=program.outliers,
    )


def _check_raster(artifact: Artifact, raster: NDArray[Any], episodes: Sequence[int]) -> None:
    width = int(np.prod(next(iter(artifact.graph.inputs.values())).input_type["input"]))
    if raster.ndim == 3 and raster.size and raster.shape[2] != width:
        raise ObservationError(
            f"the raster is {raster.shape[2]} wide; the network takes {width} spike trains side by "
            "side. Give the raster of this network."
        )
    if raster.ndim != 3 or not raster.size:
        raise ObservationError(
            f"the raster has shape {raster.shape}; the network takes (B, T, {width}), with at "
            "least one timestep. Give the raster of this network."
        )
    if episodes and (min(episodes) < 1 or sum(episodes) != len(raster)):
        raise ObservationError(
            f"the episodes have {', '.join(map(str, episodes))} inferences, the raster has "
            f"{len(raster)}. Give the inferences of every episode, at least one each."
        )


def _ablation_programs(floats: Program, program: Program) -> Iterator[tuple[str, Program]]:
    """The programs from rounded weights to the chip, one kind of rounding after another.

    floats: the same network on the ideal chip.
    """
    arithmetic = program.chip.arithmetic
    # delays are the chip's in every step
    ideal = replace(chip("ideal"), delay_max=program.chip.delay_max)
    *steps, last = arithmetic.ablation_steps
    for step in steps:
        layers = tuple(
            arithmetic.partly_rounded(floats.layer(layer.name), layer, step)
            for layer in program.layers
        )
        yield step, replace(program, chip=ideal, layers=layers)
    yield last, program


def _layer_drift(
    name: str, twin: Activity, seen: Activity, tau: float, trains: Sequence[int]
) -> _LayerDrift:
    before, after = twin.spikes[name], seen.spikes[name]
    spiked, spikes = before.any(axis=(0, 1)), after.any(axis=(0, 1))
    return _LayerDrift(
        name=name,
        neurons=before.shape[2],
        float_rate=float(before.mean()),
        chip_rate=float(after.mean()),
        differing=int(np.count_nonzero(before != after)) / before.size,
        distance=mean_distance(before, after, tau, trains),
        lost=int((spiked & ~spikes).sum()),
        woken=int((spikes & ~spiked).sum()),
        saturations=seen.saturations[name],
        first=_first_difference(twin, seen, name),
        filled=seen.filled.get(name),
    )


def _readout_drift(name: str, twin: Activity, seen: Activity) -> _ReadoutDrift:
    before, after = twin.membranes[name], seen.membranes[name]
    return _ReadoutDrift(
        name=name,
        neurons=before.shape[2],
        rms=float(np.sqrt(np.mean((after - before) ** 2))),
        range=float(np.abs(before).max()),
        filled=seen.filled.get(name),
        saturations=seen.saturations[name],
    )


def _output_drift(artifact: Artifact, before: Floats, after: Floats) -> OutputDrift:
    """Distances of the outputs (B, T, act) of the float twin and of a chip."""
    codec = artifact.codec
    kind: Literal["action", "output"] = "output"
    if codec is not None and codec.timesteps == before.shape[1]:
        kind, before, after = "action", codec.decode(before), codec.decode(after)
        if codec.chooses:
            share = float((before != after).mean())
            return OutputDrift("choice", share, float(share > 0))
    apart = after - before
    return OutputDrift(kind, float(np.sqrt(np.mean(apart**2))), float(np.abs(apart).max()))


def _first_difference(twin: Activity, seen: Activity, name: str) -> tuple[int, int, int] | None:
    """(inference, timestep, neuron) of the first spike of a layer that differs, if one does."""
    different = np.argwhere(twin.spikes[name] != seen.spikes[name])[:1].tolist()
    return (different[0][0], different[0][1], different[0][2]) if different else None


def first_divergence(twin: Activity, seen: Activity, layers: Iterable[str]) -> Divergence | None:
    """The earliest of the first inference that differs; of one timestep the first layer's.

    twin, seen: of the float twin and of the chip.
    layers: in the order of the spikes.
    """
    found = [
        (here[:2], place, name, here)
        for place, name in enumerate(layers)
        if (here := _first_difference(twin, seen, name))
    ]
    if not found:
        return None
    _, _, name, here = min(found)
    return Divergence(
        inference=here[0],
        timestep=here[1],
        layer=name,
        neuron=here[2],
        float_spikes=int(twin.spikes[name][here]),
        chip_spikes=int(seen.spikes[name][here]),
        float_membrane=float(twin.reached[name][here]),
        chip_membrane=float(seen.reached[name][here]),
        float_threshold=float(twin.thresholds[name][here[2]]),
        chip_threshold=float(seen.thresholds[name][here[2]]),
    )


# dead and saturated layers


def diagnose(
    program: Program,
    raster: NDArray[Any],
    twin: Activity,
    steps: Mapping[str, Activity],
) -> list[Finding]:
    """Findings of all layers of the program that can spike.

    twin: of the float twin on the raster.
    steps: of each ablation step, the last of them the chip itself.
    """
    seen = list(steps.values())[-1]
    spikes = {program.input: raster, **seen.spikes}
    return [
        Finding(layer.name, health, *_cause(layer, health, spikes, twin, steps))
        for layer in program.spiking
        if (health := _health(seen.spikes[layer.name]))
    ]


def _health(spikes: NDArray[Any]) -> Health:
    rate = spikes.mean()
    return "dead" if rate == 0 else "saturated" if rate > _SATURATED else ""


def _cause(
    layer: Layer,
    health: Health,
    spikes: Mapping[str, NDArray[Any]],
    twin: Activity,
    steps: Mapping[str, Activity],
) -> tuple[str, str]:
    """The cause of a layer's health on the chip, and a sentence on it."""
    own = twin.spikes[layer.name]
    alike = _health(own) == health
    biased = bool(layer.bias.any() or layer.voltage_bias.any())
    if health == "dead" and not (biased or any(spikes[s.source].any() for s in layer.synapses)):
        of = ", ".join(repr(s.source) for s in layer.synapses)
        also = ", in float too" if alike else ""
        return "input", f"nothing arrives: {of} is silent and there is no bias{also}"
    if alike:
        return "policy", "it is so in float too: the policy itself, not the chip"
    most, in_float = spikes[layer.name].max(), max(1, own.max())
    if health == "saturated" and most > in_float:
        return "counts", f"neurons send up to {most} spikes in a timestep, in float {in_float}"
    cause = "rounding"
    if len(steps) > 1:
        cause = next(
            name for name, run in steps.items() if _health(run.spikes[layer.name]) == health
        )
    overflows = list(steps.values())[-1].saturations[layer.name]
    if overflows and cause in ("states", "rounding"):
        remedy = "let states decay faster, or fewer spikes arrive at once"
        return cause, f"{overflows} numbers overflow their registers: {remedy}"
    return cause, _DETAILS[cause]
