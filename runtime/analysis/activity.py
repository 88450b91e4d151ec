"""The activity of a network: spikes and membranes of every layer, in the units of the float twin.

The float twin and chips are recorded in the same form, so that they can be compared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import Recording
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.float_model import FloatGraph, FloatNeurons

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Activity:
    """What a network did with a raster; layers are those that can spike.

    spikes: layer -> (B, T, N), of layers that can spike, as the next two.
    reached: layer -> (B, T, N) membranes before a spike resets them [float units]; NaN where the
        recording cannot tell, since they were reset to 0.
    thresholds: layer -> (N,) above which a membrane spikes [float units].
    output: (B, T, act) of the readout, or the spikes of the last layer.
    saturations: layer -> numbers that did not fit a register.
    membranes: readout layer -> (B, T, N) [float units].
    filled: layer -> largest part of its register that a current took, of readouts a membrane too;
        empty where there are no such registers.
    """

    spikes: Mapping[str, NDArray[Any]]
    reached: Mapping[str, Floats]
    thresholds: Mapping[str, Floats]
    output: Floats
    saturations: Mapping[str, int]
    membranes: Mapping[str, Floats] = field(default_factory=dict)
    filled: Mapping[str, float] = field(default_factory=dict)

    def parted(self, batch: int) -> "Activity":
        """The same with its timesteps as B inferences, one after another."""

        def part(rows: NDArray[Any]) -> NDArray[Any]:
            return rows.reshape(batch, -1, rows.shape[2])

        return replace(
            self,
            spikes={name: part(rows) for name, rows in self.spikes.items()},
            reached={name: part(rows) for name, rows in self.reached.items()},
            membranes={name: part(rows) for name, rows in self.membranes.items()},
            output=part(self.output),
        )


def _concatenated(parts: Sequence[Activity]) -> Activity:
    """The inferences of several activities of a network, one after another."""

    def join(rows: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
        return {name: np.concatenate([each[name] for each in rows]) for name in rows[0]}

    saturations = [part.saturations for part in parts]
    return replace(
        parts[0],
        spikes=join([part.spikes for part in parts]),
        reached=join([part.reached for part in parts]),
        output=np.concatenate([part.output for part in parts]),
        saturations={name: sum(lost[name] for lost in saturations) for name in saturations[0]},
        membranes=join([part.membranes for part in parts]),
        filled={name: max(part.filled[name] for part in parts) for name in parts[0].filled},
    )


def activity(
    artifact: Artifact,
    program: Program | None,
    raster: NDArray[np.uint8],
    episodes: Sequence[int] = (),
) -> Activity:
    """What a program, or without one the float twin, does with the raster (B, T, M).

    Inferences begin anew or follow one another, as the convention says.

    episodes: inferences of each episode in the raster; empty where it is a single one.
    """

    def ran(rows: NDArray[np.uint8]) -> Activity:
        return chip_activity(program, rows) if program else float_activity(artifact, rows)

    _refuse_graded(artifact)
    trains = trains_of(artifact, raster, episodes)
    if not trains:
        return ran(raster)
    parts = zip(in_trains(raster, trains), trains, strict=True)
    return _concatenated([ran(part).parted(inferences) for part, inferences in parts])


def _refuse_graded(artifact: Artifact) -> None:
    if artifact.sigma_delta:
        raise ConfigError(
            f"node {min(artifact.sigma_delta)!r}: drift compares trains of spikes that are all or "
            "nothing, and sigma-delta neurons send graded ones. Compare actions and returns with "
            "`spikedeploy compare`."
        )


def trains_of(artifact: Artifact, raster: NDArray[Any], episodes: Sequence[int]) -> Sequence[int]:
    """The numbers of inferences of a raster (B, T, M) that share a state; empty where none do.

    episodes: as in `activity`.
    """
    return (episodes or (len(raster),)) if artifact.convention.state == "kept" else ()


def in_trains(rows: NDArray[Any], lengths: Sequence[int]) -> list[NDArray[Any]]:
    """Rows (1, T, N) of each train, from the inferences (B, T, N) of all."""
    parts = np.split(rows, np.cumsum(lengths)[:-1])
    return [part.reshape(1, -1, part.shape[2]) for part in parts]


def float_activity(artifact: Artifact, raster: NDArray[Any]) -> Activity:
    """What the float twin does with the raster (B, T, M), from zero states."""
    # one timestep after another, so that the membranes between them can be read
    kept = replace(artifact, convention=replace(artifact.convention, state="kept"))
    graph = FloatGraph(kept)
    shape = next(iter(artifact.graph.inputs.values())).input_type["input"]
    x = raster.reshape(*raster.shape[:2], *map(int, shape))
    nodes = {
        name: node
        for name, node in graph.nodes.items()
        if isinstance(node, FloatNeurons) and name in graph.spiking
    }
    readouts = {
        name: node
        for name, node in graph.nodes.items()
        if isinstance(node, FloatNeurons) and node.threshold is None
    }
    before: dict[str, NDArray[Any] | None] = dict.fromkeys(nodes)
    steps, reached, membranes = [], [], []
    for t in range(x.shape[1]):
        steps.append(graph.run(x[:, t : t + 1]))
        reached.append({name: _reached(node, before[name]) for name, node in nodes.items()})
        before = {name: node.membrane for name, node in nodes.items()}
        membranes.append({name: np.asarray(node.membrane) for name, node in readouts.items()})
    return Activity(
        spikes={name: _joined([step[name][:, 0] for step in steps]) for name in nodes},
        reached={name: _joined([step[name] for step in reached]) for name in nodes},
        thresholds={name: np.asarray(node.threshold).ravel() for name, node in nodes.items()},
        output=_joined([step["output"][:, 0] for step in steps]).astype(np.float64),
        saturations=dict.fromkeys((*nodes, *readouts), 0),
        membranes={name: _joined([step[name] for step in membranes]) for name in readouts},
    )


def chip_activity(program: Program, raster: NDArray[Any]) -> Activity:
    """What the program does with the raster (B, T, M), from zero states."""
    machine = Machine(program, len(raster), "total", trace=True)
    output, seen = machine.infer(raster), machine.recordings
    readouts = [layer for layer in program.layers if not layer.spiking]
    return Activity(
        spikes={layer.name: seen[layer.name].spikes for layer in program.spiking},
        reached={
            layer.name: layer.scale * _before_reset(program, layer, seen[layer.name])
            for layer in program.spiking
        },
        thresholds={layer.name: layer.threshold * layer.scale for layer in program.spiking},
        output=output,
        saturations=machine.ledger.by_layer("saturation"),
        membranes={layer.name: layer.scale * seen[layer.name].membrane for layer in readouts},
        filled=_filled(program, seen),
    )


def _filled(program: Program, seen: Mapping[str, Recording]) -> dict[str, float]:
    """Layer -> largest part of its register that a current took, of readouts a membrane too."""
    bits = program.chip.arithmetic.state_bits
    if len(bits) < 2:  # no current
        return {}
    current, membrane = bits[0], bits[-1]
    found = {}
    for layer in program.layers:
        states = [(seen[layer.name].current, current)]
        if not layer.spiking:
            states.append((seen[layer.name].membrane, membrane))
        if all(state.dtype.kind == "i" for state, _ in states):
            found[layer.name] = max(_part(state, bits) for state, bits in states)
    return found


def _part(state: NDArray[Any], bits: int) -> float:
    return float(np.abs(state).max() / ((1 << (bits - 1)) - 1))


def _reached(node: FloatNeurons, before: NDArray[Any] | None) -> NDArray[Any]:
    """The membrane (B, *N) of the last timestep before its reset."""
    # V = b V + I + leak
    kept = node.leak if before is None else node.b * before + node.leak
    return np.asarray(node.current + kept)


def _joined(rows: list[NDArray[Any]]) -> NDArray[Any]:
    """Rows (B, T, N) of the timesteps (B, *N)."""
    return np.stack([row.reshape(len(row), -1) for row in rows], axis=1)


def _before_reset(program: Program, layer: Layer, seen: Recording) -> NDArray[Any]:
    """Membranes (B, T, N) before a spike reset them [state units]."""
    return program.chip.arithmetic.before_reset(
        layer, program.convention, seen.current, seen.membrane, seen.spikes
    )
