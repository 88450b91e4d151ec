"""Parity of a NIR file: torch, NumPy and the compiled program must spike alike, in float64.

    torch policy  =  NumPy float of the file  =  its program on the chip `ideal`

With float32 arithmetic, which training uses, a few spikes fall on the other side of a threshold;
how many is reported, not judged.
"""

from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from exporters.check import Check, Gap, SpikeTally, batches
from runtime.artifact import Artifact, load
from runtime.chip import chip
from runtime.codec import Codec
from runtime.compile import compile as compiled
from runtime.errors import ArtifactError, ConfigError
from runtime.float_graph import FloatGraph
from runtime.machine import Machine
from runtime.program import Program
from trainers.policies import Policy, PopsanPolicy

TOLERANCE = 1e-9  # of an action in [-1, 1]: float64 sums in another order

Spikes = dict[str, NDArray[np.uint8]]
Actions = NDArray[np.float64]


@dataclass
class _Rung:
    """One implementation compared with another: every spike, and the actions."""

    spikes: SpikeTally = field(default_factory=SpikeTally)
    actions: Gap = field(default_factory=Gap)

    def add(self, one: tuple[Spikes, Actions], other: tuple[Spikes, Actions]) -> None:
        self.spikes.add(one[0], other[0])
        self.actions.add(one[1], other[1])

    def checks(self, name: str) -> list[Check]:
        gap = f"largest difference {self.actions.largest:.1e}, limit {TOLERANCE:.0e}"
        return [
            Check(f"spikes: {name}", not self.spikes.differing, str(self.spikes)),
            Check(f"actions: {name}", self.actions.within(TOLERANCE), gap),
        ]


def nir_checks(policy: Policy, path: Path, observations: NDArray[np.float64]) -> list[Check]:
    """Return the checks of the file on observations (n, obs)."""
    if not isinstance(policy, PopsanPolicy):
        raise ConfigError(f"{path}: a policy of kind {policy.kind!r} has no spikes to compare")
    artifact = load(path)
    codec = _codec(artifact, path)
    graph, program = FloatGraph(artifact), compiled(artifact, chip("ideal"))
    double, single = deepcopy(policy).double(), deepcopy(policy).float()
    to_numpy, to_ideal, to_single = _Rung(), _Rung(), _Rung()
    for batch in batches(observations):
        raster = codec.encode(batch)
        by_numpy = _by_numpy(graph, codec, raster)
        to_numpy.add(_by_torch(double, torch.from_numpy(batch)), by_numpy)
        to_ideal.add(by_numpy, _by_machine(program, codec, raster))
        to_single.add(_by_torch(single, torch.from_numpy(batch).float()), by_numpy)
    return [
        *to_numpy.checks("torch = NumPy, float64"),
        *to_ideal.checks("NumPy = compiled for `ideal`, float64"),
        _report(to_single),
    ]


def _report(rung: _Rung) -> Check:
    """Say how far float32 is away; nothing that it must reach."""
    detail = f"{rung.spikes}; largest difference of an action {rung.actions.largest:.1e}"
    return Check("for information: torch float32 against NumPy float64", True, detail)


def _codec(artifact: Artifact, path: Path) -> Codec:
    if artifact.codec is None:
        raise ArtifactError(f"{path} has no codec: it was written by another tool. Export again.")
    return artifact.codec


@torch.no_grad()
def _by_torch(policy: PopsanPolicy, observation: torch.Tensor) -> tuple[Spikes, Actions]:
    trace = {name: value.numpy() for name, value in policy.trace(observation).items()}
    action = trace.pop("action").astype(np.float64)
    return trace, action


def _by_numpy(graph: FloatGraph, codec: Codec, raster: NDArray[np.uint8]) -> tuple[Spikes, Actions]:
    values = graph.run(raster)
    spikes = {name: values[name].astype(np.uint8) for name in graph.spiking}
    return {"input": raster, **spikes}, _decoded(codec, values["output"])


def _by_machine(
    program: Program, codec: Codec, raster: NDArray[np.uint8]
) -> tuple[Spikes, Actions]:
    machine = Machine(program, len(raster), ledger="none", trace=True)
    output = machine.infer(raster)
    spikes = {name: recording.spikes for name, recording in machine.recordings.items()}
    return {"input": raster, **spikes}, _decoded(codec, output)


def _decoded(codec: Codec, output: NDArray[np.generic]) -> Actions:
    return codec.decode(output.astype(np.float64)).astype(np.float64)
