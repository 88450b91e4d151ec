"""A spiking policy as one `.nir` file: a standard NIR graph, with codec and convention as metadata.

    input (M) -> fc1 -> lif1 -> ... -> fcL -> lifL -> readout -> output (act)

Event-driven policies have the graphs of trainers.policies.delta_policy.

The nodes are built with nir directly: exporters of training libraries lose the reset, the
population code and the loop over timesteps, and choose their own dt.
"""

from copy import deepcopy
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from spikedeploy.runtime.artifact.artifact import Artifact, save
from spikedeploy.runtime.convention import Convention, State
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies import (
    DeltaSnnPolicy,
    NetworkPolicy,
    Policy,
    PopsanPolicy,
    SpikingMlpPolicy,
)
from spikedeploy.trainers.policies.chip_network import codec_of
from spikedeploy.trainers.policies.delta_policy import delta_artifact
from spikedeploy.trainers.policies.spiking import CodedPolicy

SpikingPolicy: TypeAlias = PopsanPolicy | CodedPolicy
_Layered: TypeAlias = PopsanPolicy | SpikingMlpPolicy

_DT = 1e-3  # [s] one timestep; the policy has no unit of time, and chips run near this value

Array = NDArray[np.float64]


def to_nir(
    policy: Policy,
    origin: Provenance,
    path: str | Path,
    dt: float = _DT,
    state: State | None = None,
) -> Path:
    """Write the policy to `path` and return it.

    state: "reset" or "kept" between inferences; None as the policy was trained: kept by a
        DeltaSnnPolicy, which always keeps its states, and reset by all others.
    """
    path = Path(path)
    save(artifact(policy, origin, dt, state), path)
    return path


def artifact(
    policy: Policy, origin: Provenance, dt: float = _DT, state: State | None = None
) -> Artifact:
    """Return the policy as an artifact, every number in float64."""
    if isinstance(policy, NetworkPolicy):
        _only_reset(policy, state)
        return deepcopy(policy).double().artifact(origin, dt)
    if isinstance(policy, DeltaSnnPolicy):
        if state == "reset":
            raise ConfigError(
                f"state reset: a policy of kind {policy.kind!r} keeps its states through an "
                "episode, in which it remembers what it has seen; leave the option out"
            )
        return delta_artifact(policy, origin, dt)
    # the file holds the float32 weights exactly; arithmetic on them is float64 from here on
    precise = deepcopy(_spiking(policy)).double()
    convention = Convention(dt=dt, source="as trained")
    if state is not None and state != convention.state:
        convention = convention.with_options({"state": state})
    return Artifact(_graph(precise, dt), codec_of(precise), convention, origin)


def _only_reset(policy: Policy, state: State | None) -> None:
    if state == "kept":
        raise ConfigError(
            f"state kept: a policy of kind {policy.kind!r} was trained from states of 0 in each "
            "inference; leave the option out"
        )


def _spiking(policy: Policy) -> _Layered:
    """Return the policy if it spikes."""
    if not isinstance(policy, _Layered):
        raise ConfigError(
            f"a policy of kind {policy.kind!r} has no spikes, and NIR describes spiking networks: "
            "export it with --to onnx"
        )
    return policy


def _graph(policy: _Layered, dt: float) -> nir.NIRGraph:
    layers = [_affine(layer) for layer in policy.layers]
    width = layers[0].weight.shape[1]
    nodes: dict[str, nir.NIRNode] = {"input": nir.Input({"input": np.array([width])})}
    for number, layer in enumerate(layers, start=1):
        nodes[f"fc{number}"] = layer
        nodes[f"lif{number}"] = _neurons(policy, layer.bias.size, dt)
    nodes["readout"] = _readout(policy)
    nodes["output"] = nir.Output({"output": np.array([policy.actions])})
    return nir.NIRGraph(nodes, list(pairwise(nodes)))


def _affine(layer: nn.Module) -> nir.Affine:
    return nir.Affine(_array(layer.get_parameter("weight")), _array(layer.get_parameter("bias")))


def _neurons(policy: _Layered, size: int, dt: float) -> nir.CubaLIF | nir.LIF:
    """Return neurons whose gains are 1, so that dt can be inferred from them."""
    # tau = dt / (1 - decay) ; r = tau_mem / dt ; w_in = tau_syn / dt
    tau_mem = dt / (1.0 - _below_one("beta", policy.beta))
    membrane = {
        "r": np.full(size, tau_mem / dt),
        "v_leak": np.zeros(size),
        "v_reset": np.zeros(size),
        "v_threshold": np.full(size, policy.threshold),
    }
    if isinstance(policy, SpikingMlpPolicy):
        return nir.LIF(tau=np.full(size, tau_mem), **membrane)
    tau_syn = dt / (1.0 - _below_one("alpha", policy.alpha))
    return nir.CubaLIF(
        tau_syn=np.full(size, tau_syn),
        tau_mem=np.full(size, tau_mem),
        w_in=np.full(size, tau_syn / dt),
        **membrane,
    )


def _readout(policy: _Layered) -> nir.Affine:
    """Return the decoder as an affine map; of a PopSAN block-diagonal, a population per action."""
    if isinstance(policy, SpikingMlpPolicy):
        return _affine(policy.readout)
    actions, populations = policy.decoder_weight.shape
    weight = np.zeros((actions, actions, populations))
    weight[np.arange(actions), np.arange(actions)] = _array(policy.decoder_weight)
    return nir.Affine(weight.reshape(actions, -1), _array(policy.decoder_bias))


def _below_one(name: str, decay: float) -> float:
    if not 0.0 <= decay < 1.0:
        raise ConfigError(
            f"{name} is {decay}: NIR has time constants only for decays in [0, 1); "
            "train with a decay in that range"
        )
    return decay


def _array(tensor: Tensor) -> Array:
    return tensor.detach().cpu().numpy().astype(np.float64)
