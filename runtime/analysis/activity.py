"""The activity of a network: spikes and membranes of every layer in float units; spike distances.

The float twin and chips are recorded in the same form, so that they can be compared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.layer import Recording
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.float_model import FloatGraph, FloatNeurons

Floats = NDArray[np.float64]

# [timesteps] time constant of the distance of van Rossum
TAU = 5.0


@dataclass(frozen=True, eq=False)
class Activity:
    """Spikes and membranes of a network on a raster; layers are those that can spike.

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

    def split(self, batch: int) -> "Activity":
        """Return the activity with its timesteps split into B successive inferences."""

        def part(rows: NDArray[Any]) -> NDArray[Any]:
            return rows.reshape(batch, -1, rows.shape[2])

        return replace(
            self,
            spikes={name: part(rows) for name, rows in self.spikes.items()},
            reached={name: part(rows) for name, rows in self.reached.items()},
            membranes={name: part(rows) for name, rows in self.membranes.items()},
            output=part(self.output),
        )


def _concatenate(parts: Sequence[Activity]) -> Activity:
    def join(field: str) -> dict[str, NDArray[Any]]:
        rows = [getattr(part, field) for part in parts]
        return {name: np.concatenate([each[name] for each in rows]) for name in rows[0]}

    first = parts[0]
    return replace(
        first,
        spikes=join("spikes"),
        reached=join("reached"),
        output=np.concatenate([part.output for part in parts]),
        saturations={n: sum(part.saturations[n] for part in parts) for n in first.saturations},
        membranes=join("membranes"),
        filled={name: max(part.filled[name] for part in parts) for name in first.filled},
    )


def activity(
    artifact: Artifact,
    program: Program | None,
    raster: NDArray[np.uint8],
    episodes: Sequence[int] = (),
) -> Activity:
    """Run a program, or without one the float twin, on the raster (B, T, M).

    Inferences begin anew or follow one another, as the convention says.

    episodes: inferences of each episode in the raster; empty where it is a single one.
    """

    def run(rows: NDArray[np.uint8]) -> Activity:
        return chip_activity(program, rows) if program else float_activity(artifact, rows)

    if artifact.sigma_delta:
        raise ConfigError(
            f"node {min(artifact.sigma_delta)!r}: drift compares trains of spikes that are all or "
            "nothing, and sigma-delta neurons send graded ones. Compare actions and returns with "
            "`spikedeploy compare`."
        )
    trains = trains_of(artifact, raster, episodes)
    if not trains:
        return run(raster)
    parts = zip(in_trains(raster, trains), trains, strict=True)
    return _concatenate([run(part).split(inferences) for part, inferences in parts])


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
    """The activity of the float twin on the raster (B, T, M), from zero states."""
    # one timestep after another, so that the membranes between them can be read
    kept = artifact.with_convention(replace(artifact.convention, state="kept"))
    graph = FloatGraph(kept)
    shape = next(iter(artifact.graph.inputs.values())).input_type["input"]
    x = raster.reshape(*raster.shape[:2], *map(int, shape))
    neurons = {n: node for n, node in graph.nodes.items() if isinstance(node, FloatNeurons)}
    nodes = {name: node for name, node in neurons.items() if name in graph.spiking}
    readouts = {name: node for name, node in neurons.items() if node.threshold is None}
    before: dict[str, NDArray[Any] | None] = dict.fromkeys(nodes)
    steps, reached, membranes = [], [], []
    for t in range(x.shape[1]):
        steps.append(graph.run(x[:, t : t + 1]))
        reached.append({name: _reached(node, before[name]) for name, node in nodes.items()})
        before = {name: node.membrane for name, node in nodes.items()}
        membranes.append({name: np.asarray(node.membrane) for name, node in readouts.items()})
    return Activity(
        spikes={name: _stack([step[name][:, 0] for step in steps]) for name in nodes},
        reached={name: _stack([step[name] for step in reached]) for name in nodes},
        thresholds={name: np.asarray(node.threshold).ravel() for name, node in nodes.items()},
        output=_stack([step["output"][:, 0] for step in steps]).astype(np.float64),
        saturations=dict.fromkeys((*nodes, *readouts), 0),
        membranes={name: _stack([step[name] for step in membranes]) for name in readouts},
    )


def chip_activity(program: Program, raster: NDArray[Any]) -> Activity:
    """The activity of the program on the raster (B, T, M), from zero states."""
    machine = Machine(program, len(raster), "total", trace=True)
    output, seen = machine.infer(raster), machine.recordings
    readouts = [layer for layer in program.layers if not layer.spiking]
    return Activity(
        spikes={layer.name: seen[layer.name].spikes for layer in program.spiking},
        reached={
            layer.name: layer.scale
            * program.chip.arithmetic.before_reset(layer, program.convention, each)
            for layer in program.spiking
            for each in [seen[layer.name]]
        },
        thresholds={layer.name: layer.threshold * layer.scale for layer in program.spiking},
        output=output,
        saturations=machine.ledger.by_layer("saturation"),
        membranes={layer.name: layer.scale * seen[layer.name].membrane for layer in readouts},
        filled=_register_fill(program, seen),
    )


def _register_fill(program: Program, seen: Mapping[str, Recording]) -> dict[str, float]:
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
    # V = b V + I + leak
    kept = node.leak if before is None else node.b * before + node.leak
    return np.asarray(node.current + kept)


def _stack(rows: list[NDArray[Any]]) -> NDArray[Any]:
    """Rows (B, T, N) of the timesteps (B, *N)."""
    return np.stack([row.reshape(len(row), -1) for row in rows], axis=1)


# distances of spike trains, those of van Rossum, exact for spikes on a grid


def van_rossum(one: NDArray[Any], other: NDArray[Any], tau: float = TAU) -> Floats:
    """Distance D**2 (B, N) of spike trains (B, T, N), by (van Rossum 2001, eq. 3).

        f(t) = sum over spikes of H(t - t_i) exp(-(t - t_i) / tau)
        D**2 = 1/tau integral from 0 to infinity of (f(t) - g(t))**2 dt

    A spike more or less is 1/2; two that are far apart are 1; as tau vanishes, D**2 is half the
    number of spikes that differ.

    tau: [timesteps].
    """
    more = one.astype(np.float64) - other.astype(np.float64)
    decay_factor = np.exp(-1.0 / tau)
    apart = np.zeros(more[:, 0].shape)
    total = np.zeros_like(apart)
    for t in range(more.shape[1]):
        # e = e exp(-1/tau) + difference     D^2 += e^2 (1 - exp(-2/tau)) / 2
        apart = decay_factor * apart + more[:, t]
        total += apart**2 * (1 - decay_factor**2) / 2
    # what is left decays for ever: e^2 exp(-2/tau) / 2
    return np.asarray(total + apart**2 * decay_factor**2 / 2)


def mean_distance(
    one: NDArray[Any], other: NDArray[Any], tau: float = TAU, trains: Sequence[int] = ()
) -> float:
    """Mean over inferences and neurons of the distance of spike trains (B, T, N).

    trains: numbers of successive inferences that are one train; empty where each is its own.
    """
    if not trains:
        return float(van_rossum(one, other, tau).mean())
    parts = zip(in_trains(one, trains), in_trains(other, trains), strict=True)
    # a train of several inferences has the sum of their distances
    total = sum(van_rossum(*part, tau).sum() for part in parts)
    return float(total / (one.shape[0] * one.shape[2]))
