"""Writes a spiking policy as one `.nir` file: a standard NIR graph, and in its metadata the rest.

    input (M) -> fc1 -> lif1 -> ... -> fcL -> lifL -> readout -> output (act)

The nodes are built with nir itself. Exporters of training libraries lose the reset, the population
code and the loop over timesteps, and fix a dt of their own.
"""

from copy import deepcopy
from itertools import pairwise
from pathlib import Path

import nir
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from runtime.artifact import Artifact, save
from runtime.codec import Codec, Normaliser, PopulationEncoder
from runtime.convention import Convention
from runtime.errors import ConfigError
from runtime.origin import Origin
from trainers.policies import Policy, PopsanPolicy

DT = 1e-3  # [s] one timestep; the policy knows no seconds, chips of today run near this one

Array = NDArray[np.float64]


def to_nir(policy: Policy, origin: Origin, path: str | Path, dt: float = DT) -> Path:
    """Write the policy to `path` and return it."""
    path = Path(path)
    save(artifact(policy, origin, dt), path)
    return path


def artifact(policy: Policy, origin: Origin, dt: float = DT) -> Artifact:
    """Return the policy as an artifact, every number in float64."""
    if not isinstance(policy, PopsanPolicy):
        raise ConfigError(
            f"a policy of kind {policy.kind!r} has no spikes, and NIR describes spiking networks: "
            "export it with --to onnx"
        )
    # deployment computes what the float32 weights mean, not what float32 arithmetic makes of them
    precise = deepcopy(policy).double()
    convention = Convention(dt=dt, source="as trained")
    return Artifact(_graph(precise, dt), _codec(precise), convention, origin)


def _graph(policy: PopsanPolicy, dt: float) -> nir.NIRGraph:
    width = policy.observations * policy.populations
    nodes: dict[str, nir.NIRNode] = {"input": nir.Input({"input": np.array([width])})}
    for number, layer in enumerate(policy.layers, start=1):
        bias = _array(layer.get_parameter("bias"))
        nodes[f"fc{number}"] = nir.Affine(_array(layer.get_parameter("weight")), bias)
        nodes[f"lif{number}"] = _neurons(policy, bias.size, dt)
    nodes["readout"] = _readout(policy)
    nodes["output"] = nir.Output({"output": np.array([policy.actions])})
    return nir.NIRGraph(nodes, list(pairwise(nodes)))


def _neurons(policy: PopsanPolicy, size: int, dt: float) -> nir.CubaLIF:
    """Return CuBa-LIF neurons whose gains are one, so that dt can be read from them."""
    # tau = dt / (1 - decay) ; w_in = tau_syn / dt ; r = tau_mem / dt
    tau_syn = dt / (1.0 - _below_one("alpha", policy.alpha))
    tau_mem = dt / (1.0 - _below_one("beta", policy.beta))
    return nir.CubaLIF(
        tau_syn=np.full(size, tau_syn),
        tau_mem=np.full(size, tau_mem),
        r=np.full(size, tau_mem / dt),
        w_in=np.full(size, tau_syn / dt),
        v_leak=np.zeros(size),
        v_reset=np.zeros(size),
        v_threshold=np.full(size, policy.threshold),
    )


def _readout(policy: PopsanPolicy) -> nir.Affine:
    """Return the decoder as an affine map in which every action hears its own population only."""
    actions, populations = policy.decoder_weight.shape
    weight = np.zeros((actions, actions, populations))
    weight[np.arange(actions), np.arange(actions)] = _array(policy.decoder_weight)
    return nir.Affine(weight.reshape(actions, -1), _array(policy.decoder_bias))


def _codec(policy: PopsanPolicy) -> Codec:
    normalizer, encoder = policy.normalizer, policy.encoder
    return Codec(
        Normaliser(_array(normalizer.mean), _array(normalizer.std), normalizer.clip),
        PopulationEncoder(_array(encoder.mean), _array(encoder.std), encoder.threshold),
        policy.timesteps,
        "tanh",
    )


def _below_one(name: str, decay: float) -> float:
    if not 0.0 <= decay < 1.0:
        raise ConfigError(
            f"{name} is {decay}: NIR has a time constant for decays from 0 to below 1 only; "
            "train with a decay in that range"
        )
    return decay


def _array(tensor: Tensor) -> Array:
    return tensor.detach().cpu().numpy().astype(np.float64)
