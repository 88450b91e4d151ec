"""The network of a ChipSnnPolicy as a NIR graph with its codec: exported, and compiled to learn.

    input (M) -> fc1 -> lif1 -> ... -> fcL -> lifL -> readout -> output (act)

The neurons are those that the chip computes natively: IF, LIF or CubaLIF, with gains of 1.
"""

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
from spikedeploy.trainers.policies.chip_snn import THRESHOLD, ChipSnnPolicy
from spikedeploy.trainers.policies.encoders import TorchPopulationEncoder, TorchRateEncoder
from spikedeploy.trainers.policies.popsan import PopsanPolicy
from spikedeploy.trainers.policies.spiking_mlp import SpikingMlpPolicy

_DT = 1e-3  # [s] one timestep; the policy has no unit of time, and chips run near this value

Array = NDArray[np.float64]


def chip_artifact(
    policy: ChipSnnPolicy, origin: Provenance | None = None, dt: float = _DT
) -> Artifact:
    """Return the policy as an artifact, every number in float64; its states are reset."""
    return Artifact(
        _graph(policy, dt), codec_of(policy), chip_convention(policy.target, dt), origin
    )


def chip_convention(target: Chip, dt: float = _DT) -> Convention:
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
        Normaliser(_array(normalizer.mean), _array(normalizer.std), normalizer.clip),
        _encoder(policy.encoder),
        policy.timesteps,
        "argmax" if policy.head == "discrete" else "tanh",
    )


def _encoder(encoder: nn.Module) -> Encoder:
    if isinstance(encoder, TorchRateEncoder):
        return RateEncoder(_array(encoder.low), _array(encoder.high), encoder.mode)
    if isinstance(encoder, TorchPopulationEncoder):
        return PopulationEncoder(_array(encoder.mean), _array(encoder.std), encoder.threshold)
    raise ConfigError(f"{type(encoder).__name__} has no form in a file; add it to {__name__}")


def _graph(policy: ChipSnnPolicy, dt: float) -> nir.NIRGraph:
    weights = [_array(weight) for weight in policy.weights()]
    width = weights[0].shape[1]
    nodes: dict[str, nir.NIRNode] = {"input": nir.Input({"input": np.array([width])})}
    for number, weight in enumerate(weights, start=1):
        nodes[f"fc{number}"] = nir.Linear(weight)
        nodes[f"lif{number}"] = _neurons(policy, len(weight), dt)
    readout = policy.readout
    nodes["readout"] = nir.Affine(_array(readout.weight), _array(readout.bias))
    nodes["output"] = nir.Output({"output": np.array([policy.actions])})
    return nir.NIRGraph(nodes, list(pairwise(nodes)))


def _neurons(policy: ChipSnnPolicy, size: int, dt: float) -> nir.IF | nir.LIF | nir.CubaLIF:
    """Return neurons whose gains are 1."""
    zeros, threshold = np.zeros(size), np.full(size, THRESHOLD)
    if policy.beta == 1:
        return nir.IF(r=np.full(size, 1 / dt), v_threshold=threshold, v_reset=zeros)
    # tau = dt / (1 - decay) ; r = tau_mem / dt ; w_in = tau_syn / dt
    per_step = 1 / (1 - policy.beta)
    membrane = {"v_leak": zeros, "v_reset": zeros, "v_threshold": threshold}
    membrane |= {"tau": np.full(size, dt * per_step), "r": np.full(size, per_step)}
    if not policy.alpha:
        return nir.LIF(**membrane)
    synaptic = 1 / (1 - policy.alpha)
    membrane["tau_mem"] = membrane.pop("tau")
    tau_syn, w_in = np.full(size, dt * synaptic), np.full(size, synaptic)
    return nir.CubaLIF(tau_syn=tau_syn, w_in=w_in, **membrane)


def _array(tensor: Tensor) -> Array:
    array: Array = tensor.detach().cpu().numpy().astype(np.float64)
    return array
