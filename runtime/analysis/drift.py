"""Drift: how far a chip is from the float twin, where that begins, and what causes it.

The cause is found by ablation: the network is rounded step by step, one kind of number after
another. Each step is computed in float64, on the chip's scale, so that what differs between two
steps is the one thing that was rounded. The last step is the chip.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.analysis.activity import Activity, activity, trains_of
from spikedeploy.runtime.analysis.diagnosis import Divergence, Finding, diagnose, first
from spikedeploy.runtime.analysis.readout_drift import ReadoutDrift, readout_drifts
from spikedeploy.runtime.analysis.spike_distance import TAU, mean_distance
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ObservationError


def ablation_programs(floats: Program, program: Program) -> Iterator[tuple[str, Program]]:
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


Floats = NDArray[np.float64]


@dataclass(frozen=True)
class _LayerDrift:
    """How a layer's spikes differ from the float twin's.

    name: of the node.
    neurons: N.
    float_rate, chip_rate: spikes for each neuron and timestep.
    differing: part of neuron-timesteps in which the number of spikes differs.
    distance: of van Rossum, mean over inferences and neurons; a spike too many is 1/2.
    lost, woken: neurons that spike in float and never on the chip, and the other way round.
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
class OutputDrift:
    """How far the outputs are apart.

    kind: "action", after the codec; "choice", where the codec chooses one of several; "output", of
        the readout in each timestep, or spikes.
    rms: root of the mean square of the differences; of choices the part that differs.
    largest: difference; of choices 1 where any differs.
    """

    kind: Literal["action", "choice", "output"]
    rms: float
    largest: float


@dataclass(frozen=True)
class _AblationStep:
    """The network with some of the chip's roundings.

    name: of the rounding that was added last.
    distance: layer -> of van Rossum, as in LayerDrift.
    output: against the float twin.
    """

    name: str
    distance: Mapping[str, float]
    output: OutputDrift


@dataclass(frozen=True)
class Drift:
    """A chip against the float twin on a raster.

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
    readouts: tuple[ReadoutDrift, ...] = ()

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
    _check(artifact, raster, episodes)
    program = compile_program(artifact, on, quantisation, limits=limits)
    clock = program.clock
    staged = bool(on.arithmetic.ablation_steps)
    floats = compile_program(artifact, chip("ideal"), clock=clock) if staged else None
    twin, trains = activity(artifact, None, raster, episodes), trains_of(artifact, raster, episodes)
    steps = ablation_programs(floats, program) if floats else [("chip", program)]
    if floats and artifact.convention.state == "kept" and clock != own_clock(artifact.convention):
        steps = [("clock", floats), *steps]
    runs = {name: activity(artifact, step, raster, episodes) for name, step in steps}
    seen = list(runs.values())[-1]
    names = [layer.name for layer in program.spiking]
    return Drift(
        chip=on.name,
        quantisation=quantisation.describe(),
        inferences=raster.shape[0],
        timesteps=raster.shape[1],
        tau=tau,
        layers=tuple(_layer(name, twin, seen, tau, trains) for name in names),
        diverged=_diverged(twin, seen, names),
        first=first(twin, seen, names),
        output=_output_drift(artifact, twin.output, seen.output),
        ablation=tuple(_step(artifact, name, twin, ran, tau, trains) for name, ran in runs.items())
        if floats
        else (),
        findings=tuple(diagnose(floats, program, raster, twin, runs)),
        readouts=readout_drifts(twin, seen),
    )


def _output_drift(artifact: Artifact, before: Floats, after: Floats) -> OutputDrift:
    """How far the outputs (B, T, act) of the float twin and of a chip are apart."""
    codec = artifact.codec
    if codec is None or codec.timesteps != before.shape[1]:
        return _apart("output", after - before)
    actions = codec.decode(before), codec.decode(after)
    if codec.chooses:
        share = float((actions[0] != actions[1]).mean())
        return OutputDrift("choice", share, float(share > 0))
    return _apart("action", actions[1] - actions[0])


def _check(artifact: Artifact, raster: NDArray[Any], episodes: Sequence[int]) -> None:
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


def _apart(kind: Literal["action", "output"], difference: Floats) -> OutputDrift:
    return OutputDrift(
        kind, float(np.sqrt(np.mean(difference**2))), float(np.abs(difference).max())
    )


def _layer(
    name: str, twin: Activity, seen: Activity, tau: float, trains: Sequence[int]
) -> _LayerDrift:
    before, after = twin.spikes[name], seen.spikes[name]
    spiked, spikes = before.any(axis=(0, 1)), after.any(axis=(0, 1))
    different = np.argwhere(before != after)
    return _LayerDrift(
        name=name,
        neurons=before.shape[2],
        float_rate=float(before.mean()),
        chip_rate=float(after.mean()),
        differing=len(different) / before.size,
        distance=mean_distance(before, after, tau, trains),
        lost=int((spiked & ~spikes).sum()),
        woken=int((spikes & ~spiked).sum()),
        saturations=seen.saturations[name],
        first=(int(different[0][0]), int(different[0][1]), int(different[0][2]))
        if len(different)
        else None,
        filled=seen.filled.get(name),
    )


def _diverged(twin: Activity, seen: Activity, names: list[str]) -> int:
    if not names:
        return 0
    differ = [(twin.spikes[name] != seen.spikes[name]).any(axis=(1, 2)) for name in names]
    return int(np.any(differ, axis=0).sum())


def _step(
    artifact: Artifact,
    name: str,
    twin: Activity,
    ran: Activity,
    tau: float,
    trains: Sequence[int],
) -> _AblationStep:
    distances = {
        layer: mean_distance(twin.spikes[layer], spikes, tau, trains)
        for layer, spikes in ran.spikes.items()
    }
    return _AblationStep(name, distances, _output_drift(artifact, twin.output, ran.output))
