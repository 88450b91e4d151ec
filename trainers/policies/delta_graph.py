"""The network of an event-driven policy as a NIR graph with its codec: exported, and validated.

    input (M) -> fc1 -> lif1 -> fc2 -> readout -> action -> output (act)
    input (M) ------> skip ----------> readout, or integral -> action

`lif1` is a CubaLIF whose synaptic current hardly decays, `readout` and `integral` are LI, all with
gains of 1.
`action` adds the constant c to each readout. Channels of the encoder carry their own weights, so
event k of a one-hot code weighs k times as much.

Of a DeltaMlpPolicy the neurons are `sd1`, sigma-delta neurons (runtime.graph.neurons), and the
readout is an I. fc2 weighs each graded spike with the threshold that it counts.
"""

from copy import deepcopy

import nir
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.codec.codec import Codec, Normaliser
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.graph.neurons import SigmaDelta
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies.delta_mlp import DeltaMlpPolicy
from spikedeploy.trainers.policies.delta_snn import DeltaSnnPolicy

_DT = 1e-3  # [s] one timestep; the policy has no unit of time, and chips run near this value

Array = NDArray[np.float64]


def delta_artifact(
    policy: DeltaSnnPolicy, origin: Provenance | None = None, dt: float = _DT
) -> Artifact:
    """Return the policy as an artifact, every number in float64; its states are kept.

    Hidden neurons without synapses on one of their sides are left out.
    """
    precise = deepcopy(policy).double()
    convention = Convention(dt=dt, source="as trained", state="kept", clock=policy.clock)
    graph = _graph(precise, dt)
    graded = _sigma_delta(precise) if "sd1" in graph.nodes else {}
    return Artifact(graph, delta_codec(precise), convention, origin, graded)


def delta_codec(policy: DeltaSnnPolicy) -> Codec:
    """Return normaliser, encoder and decoder, as a file holds them."""
    normalizer = policy.normalizer
    return Codec(
        Normaliser(_array(normalizer.mean), _array(normalizer.std), normalizer.clip),
        delta_encoder(policy),
        policy.timesteps,
        "argmax" if policy.head == "discrete" else "tanh",
    )


def delta_encoder(policy: DeltaSnnPolicy) -> DeltaEncoder:
    """Return the encoder; observations that no synapse reads send nothing."""
    step = np.where(_used(policy).numpy(), _array(policy.step), np.inf)
    return DeltaEncoder(step, policy.most, policy.code, policy.events_above)


def live_neurons(policy: DeltaSnnPolicy) -> Tensor:
    """Return which hidden neurons (H,) have synapses on both sides: others change no action."""
    # a neuron without input may still spike by its bias, as a clock of its own
    active = policy.into.mask.any(1) | (policy.bias.detach() > 0)
    return active & policy.out.mask.any(0)


def channel_weights(policy: DeltaSnnPolicy, weight: Array) -> Array:
    """Return weights (N, M) of the encoder's channels, from those of the observation (N, obs)."""
    k = np.arange(1, policy.most + 1)
    each = k if policy.code == "one-hot" else np.ones_like(k)
    signed = np.concatenate([each, -each])  # the K channels of rising values, then of falling ones
    moved: Array = weight * _array(policy.step)
    return np.reshape(moved[:, :, None] * signed, (len(weight), -1))


def event_channels(policy: DeltaSnnPolicy, events: Array) -> NDArray[np.uint8]:
    """Return input spikes (S, M) of signed events (S, obs), those that some synapse reads."""
    k = np.arange(1, policy.most + 1)
    sign = np.array([[1], [-1]])
    signed = np.where(_used(policy).numpy(), events, 0)[:, :, None, None] * sign
    spikes = signed == k if policy.code == "one-hot" else signed >= k
    return np.reshape(spikes, (len(events), -1)).astype(np.uint8)


def _used(policy: DeltaSnnPolicy) -> Tensor:
    """Return which observations (obs,) some synapse reads."""
    used = policy.into.mask[live_neurons(policy)].any(0)
    return used | policy.past.mask.any(0) if policy.skip else used


def _graph(policy: DeltaSnnPolicy, dt: float) -> nir.NIRGraph:
    width = 2 * policy.most * policy.observations
    nodes: dict[str, nir.NIRNode] = {"input": nir.Input({"input": np.array([width])})}
    edges: list[tuple[str, str]] = []
    live = live_neurons(policy)
    if bool(live.any()):
        into = channel_weights(policy, _array(policy.into()[live]))
        name = hidden_node(policy)
        nodes["fc1"] = nir.Linear(into)
        nodes[name] = _neurons(policy, live, dt)
        nodes["fc2"] = nir.Linear(_array((policy.out() * _spike(policy))[:, live]))
        edges += [("input", "fc1"), ("fc1", name), (name, "fc2"), ("fc2", "readout")]
    integral = np.full(policy.actions, policy.current_decay)
    past = policy.past() if policy.skip else policy.step.new_zeros(policy.actions, len(policy.step))
    if not edges or bool(past.any()):  # the input is read, if only with weights of 0
        nodes["skip"] = nir.Linear(channel_weights(policy, _array(past)))
        edges.append(("input", "skip"))
        if policy.integrated and "lif1" in nodes:
            nodes["integral"] = _readout(policy, integral, dt)
            edges += [("skip", "integral"), ("integral", "action")]
        else:
            edges.append(("skip", "readout"))
    alone = policy.integrated and "lif1" not in nodes  # the readout is then the integral
    nodes["readout"] = _readout(policy, integral if alone else _array(policy.gamma), dt)
    nodes["action"] = nir.Affine(np.eye(policy.actions), _array(policy.action_bias))
    nodes["output"] = nir.Output({"output": np.array([policy.actions])})
    edges += [("readout", "action"), ("action", "output")]
    return nir.NIRGraph(nodes, edges)


def hidden_node(policy: DeltaSnnPolicy) -> str:
    """Return the name of the hidden neurons' node."""
    return "sd1" if isinstance(policy, DeltaMlpPolicy) else "lif1"


def _spike(policy: DeltaSnnPolicy) -> Tensor:
    """Return what a spike of each hidden neuron (H,) stands for."""
    if isinstance(policy, DeltaMlpPolicy):
        return policy.threshold
    return torch.ones_like(policy.bias)


def _sigma_delta(policy: DeltaSnnPolicy) -> dict[str, SigmaDelta]:
    live = live_neurons(policy)
    return {"sd1": SigmaDelta(_array(_spike(policy)[live]), _array(policy.bias[live]))}


def _neurons(policy: DeltaSnnPolicy, live: Tensor, dt: float) -> nir.CubaLIF | nir.I:
    """Return the hidden neurons; the bias of LIF neurons is their resting membrane."""
    if isinstance(policy, DeltaMlpPolicy):
        return nir.I(np.full(int(live.sum()), 1 / dt))
    beta, bias = _array(policy.beta[live]), _array(policy.bias[live])
    # tau = dt / (1 - decay) ; gains of 1 ; V = beta V + I + (1 - beta) v_leak
    tau_mem, tau_syn = dt / (1 - beta), np.full(beta.size, dt / (1 - policy.current_decay))
    return nir.CubaLIF(
        tau_syn=tau_syn,
        tau_mem=tau_mem,
        r=tau_mem / dt,
        v_leak=bias / (1 - beta),
        v_reset=np.zeros(beta.size),
        v_threshold=_array(policy.threshold[live]),
        w_in=tau_syn / dt,
    )


def _readout(policy: DeltaSnnPolicy, decay: Array, dt: float) -> nir.LI | nir.I:
    if isinstance(policy, DeltaMlpPolicy):
        return nir.I(np.full(policy.actions, 1 / dt))
    tau = dt / (1 - decay)
    return nir.LI(tau=tau, r=tau / dt, v_leak=np.zeros(tau.size))


def _array(tensor: Tensor) -> Array:
    array: Array = tensor.detach().cpu().numpy().astype(np.float64)
    return array
