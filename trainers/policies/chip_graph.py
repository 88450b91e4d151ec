"""The network of a ChipSnnPolicy as a NIR graph with its codec: exported, and compiled to learn.

    input (M) -> fc1 -> lif1 -> ... -> fcL -> lifL -> readout -> output (act)

The neurons are those that the chip computes natively: IF, LIF or CubaLIF, with gains of 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import nir
import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.codec.codec import (
    Codec,
    Encoder,
    Normaliser,
    PopulationEncoder,
    RateEncoder,
)
from spikedeploy.runtime.convention import Convention, Floor, Reset, Spikes
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies.encoders import TorchPopulationEncoder, TorchRateEncoder
from spikedeploy.trainers.policies.popsan import PopsanPolicy
from spikedeploy.trainers.policies.spiking_mlp import SpikingMlpPolicy

THRESHOLD = 1.0  # of every neuron; the compiler scales it with the weights
DT = 1e-3  # [s] one timestep; the policy has no unit of time, and chips run near this value

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChipNeurons:
    """The neurons of a chip, all alike, with a threshold of THRESHOLD and gains of 1.

    target: the chip
    alpha, beta: decay factors of current and membrane in a timestep; 0 is no current, 1 no leak
    dt: [s] one timestep
    """

    target: Chip
    alpha: float
    beta: float
    dt: float = DT

    def node(self, size: int) -> nir.IF | nir.LIF | nir.CubaLIF:
        """Return so many of them."""
        dt, zeros, threshold = self.dt, np.zeros(size), np.full(size, THRESHOLD)
        if self.beta == 1:
            return nir.IF(r=np.full(size, 1 / dt), v_threshold=threshold, v_reset=zeros)
        # tau = dt / (1 - decay) ; r = tau_mem / dt ; w_in = tau_syn / dt
        per_step = 1 / (1 - self.beta)
        tau, gain = np.full(size, dt * per_step), np.full(size, per_step)
        if not self.alpha:
            return nir.LIF(tau=tau, r=gain, v_leak=zeros, v_reset=zeros, v_threshold=threshold)
        synaptic = 1 / (1 - self.alpha)
        return nir.CubaLIF(
            tau_syn=np.full(size, dt * synaptic),
            w_in=np.full(size, synaptic),
            tau_mem=tau,
            r=gain,
            v_leak=zeros,
            v_reset=zeros,
            v_threshold=threshold,
        )


def chip_artifact(
    neurons: ChipNeurons,
    weights: Sequence[Array],
    readout: nir.Affine,
    codec: Codec,
    origin: Provenance | None = None,
) -> Artifact:
    """Return a chain of layers with these weights (N, M) as an artifact; its states are reset."""
    width = weights[0].shape[1]
    nodes: dict[str, nir.NIRNode] = {"input": nir.Input({"input": np.array([width])})}
    for number, weight in enumerate(weights, start=1):
        nodes[f"fc{number}"] = nir.Linear(weight)
        nodes[f"lif{number}"] = neurons.node(len(weight))
    nodes["readout"] = readout
    nodes["output"] = nir.Output({"output": np.array([len(readout.weight)])})
    graph = nir.NIRGraph(nodes, list(pairwise(nodes)))
    return Artifact(graph, codec, chip_convention(neurons.target, neurons.dt), origin)


def chip_convention(target: Chip, dt: float = DT) -> Convention:
    """Return what the chip's neurons do where they have no choice; else the threshold is taken off.

    Several spikes of a timestep are a convention only where the threshold is taken off for each.
    """
    arithmetic = target.arithmetic
    reset: Reset = "subtract" if "subtract" in target.resets else "zero"
    spikes: Spikes = "reached" if arithmetic.spikes_at_threshold else "above"
    if arithmetic.spikes_max > 1 and reset == "subtract":
        spikes = "many"
    floor: Floor = "zero" if getattr(arithmetic, "floor", None) == 0 else "none"
    return Convention(dt=dt, reset=reset, spikes=spikes, floor=floor, source="as trained")


def codec_of(policy: SpikingMlpPolicy | PopsanPolicy) -> Codec:
    """Return normaliser, encoder and decoder, as a file holds them."""
    normalizer = policy.normalizer
    return Codec(
        Normaliser(array(normalizer.mean), array(normalizer.std), normalizer.clip),
        _encoder(policy.encoder),
        policy.timesteps,
        "argmax" if policy.head == "discrete" else "tanh",
    )


def _encoder(encoder: nn.Module) -> Encoder:
    if isinstance(encoder, TorchRateEncoder):
        return RateEncoder(array(encoder.low), array(encoder.high), encoder.mode)
    if isinstance(encoder, TorchPopulationEncoder):
        return PopulationEncoder(array(encoder.mean), array(encoder.std), encoder.threshold)
    raise ConfigError(f"{type(encoder).__name__} has no form in a file; add it to {__name__}")


def array(tensor: Tensor) -> Array:
    """Return a tensor in float64."""
    numbers: Array = tensor.detach().cpu().numpy().astype(np.float64)
    return numbers
