"""Batch-1 latency: a policy on an emulated chip against snnTorch's loop of the same weights.

    python -m lab latency [FILE.nir] [--chip loihi1] [--rounds 15] [--json]

Both take an observation and give an action, encoder and decoder included, with one thread. They
take turns in one process, round by round, on observations of the policy's own walk, and the medians
of their inferences are compared: a ratio is the peer's time over ours. snnTorch counts nothing, so
ours is compared without its ledger; with it, as closed loops run, is a row of its own. The peer's
actions are compared with the float twin's too, so that both are seen to compute the same policy.
"""

from functools import partial
from pathlib import Path
from typing import Any

import nir
import numpy as np
import torch
from numpy.typing import NDArray
from snntorch import Synaptic
from torch import Tensor, nn

import spikedeploy.zoo
from lab.bench.turns import medians, parser_of, report
from spikedeploy import envs
from spikedeploy.envs.rollout import rollout
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.codec import Codec, PopulationEncoder
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.discretisation import discretise

SHIPPED = Path(spikedeploy.zoo.__file__).parent / "hexapod" / "popsan.nir"
STEPS = 200  # of the walk, and inferences in each round
SEED = 5_000  # of the walk; evaluation begins at 10,000

Numbers = NDArray[np.float64]


class SnnTorchLoop(nn.Module):
    """A policy as snnTorch runs one: a module for each layer, called once in every timestep."""

    def __init__(self, artifact: Artifact, codec: Codec) -> None:
        super().__init__()
        if not isinstance(codec.encoder, PopulationEncoder):
            raise ArtifactError(f"the loop has no encoder of kind {codec.encoder.kind!r}")
        nodes = artifact.graph.nodes
        layers = range(1, sum(isinstance(node, nir.CubaLIF) for node in nodes.values()) + 1)
        self.dense = nn.ModuleList(linear(nodes[f"fc{k}"]) for k in layers)
        self.spiking = [synaptic(artifact, f"lif{k}") for k in layers]
        self.readout = linear(nodes["readout"])
        self.timesteps, self.threshold = codec.timesteps, codec.encoder.threshold
        self.clip = codec.normaliser.clip
        self.mean, self.std = single(codec.normaliser.mean), single(codec.normaliser.std)
        self.centre, self.width = single(codec.encoder.mean), single(codec.encoder.std)

    def forward(self, observation: Tensor) -> Tensor:
        """Return the action (1, act) for an observation (1, obs)."""
        drive = self._drive(observation)
        membrane, rate = torch.zeros_like(drive), torch.zeros(())
        states = [layer.reset_mem() for layer in self.spiking]
        for _ in range(self.timesteps):
            membrane = membrane + drive
            spikes = (membrane > self.threshold).float()
            membrane = membrane - self.threshold * spikes
            for k, (dense, layer) in enumerate(zip(self.dense, self.spiking, strict=True)):
                spikes, *states[k] = layer(dense(spikes), *states[k])
            rate = rate + spikes / self.timesteps
        return torch.tanh(self.readout(rate))

    def _drive(self, observation: Tensor) -> Tensor:
        x = ((observation - self.mean) / self.std).clamp(-self.clip, self.clip)
        return torch.exp(-0.5 * ((x[:, :, None] - self.centre) / self.width).square()).flatten(1)


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = parser_of(__doc__)
    parser.add_argument("file", nargs="?", type=Path, default=SHIPPED, help="a PopSAN's .nir")
    parser.add_argument("--chip", default="loihi1")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    artifact = load(arguments.file)
    if artifact.codec is None or artifact.provenance is None:
        raise ArtifactError(
            f"{arguments.file} was not exported by spikedeploy: no codec, no origin"
        )
    network, emulated = SnnTorchLoop(artifact, artifact.codec), chip(arguments.chip)

    @torch.no_grad()
    def peer(observation: Numbers) -> Any:  # noqa: ANN401
        return network(torch.from_numpy(observation).float()).numpy()

    actors = {
        "ours": SpikingController(artifact, emulated, ledger="none").act_batch,
        "ours_counting": SpikingController(artifact, emulated, ledger="total").act_batch,
        "snntorch": peer,
    }
    env = envs.make(artifact.provenance.env)
    observations = rollout(env, SpikingController(artifact), SEED).observation[:STEPS]
    rows = observations[:, None]
    calls = {name: [partial(act, row) for row in rows] for name, act in actors.items()}
    median = medians(calls, arguments.rounds)
    # within 1e-4; float32 moves a spike now and then, so not on all observations
    apart = np.concatenate(list(map(peer, rows))) - SpikingController(artifact).act_batch(
        observations
    )
    result = {
        "file": "/".join(arguments.file.parts[-2:]),
        "chip": arguments.chip,
        "median_us": median,
        "ratios": {"snntorch": median["snntorch"] / median["ours"]},
        "ratios_counting": {"snntorch": median["snntorch"] / median["ours_counting"]},
        "snntorch_equals_float_twin": float((np.abs(apart).max(axis=1) < 1e-4).mean()),
    }
    report(result, arguments)


def linear(node: nir.Affine) -> nn.Linear:
    """Return an affine node as a torch layer."""
    layer = nn.Linear(node.weight.shape[1], node.weight.shape[0])
    layer.load_state_dict({"weight": single(node.weight), "bias": single(node.bias)})
    return layer


def synaptic(artifact: Artifact, name: str) -> Synaptic:
    """Return CuBa-LIF neurons as snnTorch's module; all of a layer are alike."""
    neuron = discretise(name, artifact.graph.nodes[name], artifact.convention)
    constants = (neuron.current_decay, neuron.membrane_decay, neuron.threshold)
    alpha, beta, threshold = (float(values[0]) for values in constants if values is not None)
    return Synaptic(alpha, beta, threshold, reset_mechanism="zero", reset_delay=False)


def single(array: NDArray[np.floating]) -> Tensor:
    """Return an array as a float32 tensor."""
    return torch.from_numpy(array).float()
