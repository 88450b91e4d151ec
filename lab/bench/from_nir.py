"""A `.nir` file of `to_nir` as a torch policy, for checks or further training."""

from pathlib import Path
from typing import Any

import nir
import numpy as np
import torch
from numpy.typing import NDArray

from spikedeploy.exporters.to_nir import SpikingPolicy
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.population import PopulationEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.neurons import SPIKING, discretise
from spikedeploy.trainers.policies import (
    DeltaMlpPolicy,
    DeltaSnnPolicy,
    PopsanPolicy,
    SpikingMlpPolicy,
)
from spikedeploy.trainers.policies.delta import DEEP_NODE

_DIGITS = 12  # of a decay; dt / tau loses precision beyond them

Arrays = dict[str, NDArray[np.floating[Any]]]


def from_nir(path: str | Path) -> SpikingPolicy | DeltaSnnPolicy:
    """Return the policy that `to_nir` wrote, in float32 as it was trained."""
    try:
        return _policy(load(path))
    except (KeyError, AttributeError) as error:
        raise ArtifactError(
            f"{path} is not laid out as fc1, lif1, ..., readout with a codec ({error}); "
            "only what spikedeploy exported can be read back as a torch policy"
        ) from error


def _policy(artifact: Artifact) -> SpikingPolicy | DeltaSnnPolicy:
    codec, nodes = artifact.codec, artifact.graph.nodes
    if codec is None:
        raise AttributeError("no codec")
    arrays: Arrays = {
        "normalizer.mean": codec.normaliser.mean,
        "normalizer.std": codec.normaliser.std,
    }
    if isinstance(codec.encoder, DeltaEncoder):
        return _event_driven(artifact, codec, codec.encoder, arrays)
    cuba = isinstance(nodes["lif1"], nir.CubaLIF)
    network = (_popsan if cuba else _spiking_mlp)(artifact, codec)
    for k, layer in enumerate(_layers(artifact.graph)):
        arrays |= {f"layers.{k}.weight": layer.weight, f"layers.{k}.bias": layer.bias}
    encoder, readout = codec.encoder, nodes["readout"]
    if isinstance(encoder, PopulationEncoder):
        arrays |= {"encoder.mean": encoder.mean, "encoder.log_std": np.log(encoder.std)}
    elif isinstance(encoder, RateEncoder):
        arrays |= {"encoder.low": encoder.low, "encoder.high": encoder.high}
    else:
        raise AttributeError(f"a code of kind {encoder.kind}")
    weight = readout.weight
    if cuba:  # weights (act, P) of the blocks of a block-diagonal readout (act, act·P)
        actions = np.arange(len(weight))
        blocks = weight.reshape(len(weight), len(weight), -1)[actions, actions]
        arrays |= {"decoder_weight": blocks, "decoder_bias": readout.bias}
    else:
        arrays |= {"readout.weight": weight, "readout.bias": readout.bias}
    # exact: the float64 numbers of the file were float32
    network.load_state_dict({name: torch.from_numpy(a).float() for name, a in arrays.items()})
    return network


def _event_driven(
    artifact: Artifact, codec: Codec, encoder: DeltaEncoder, arrays: Arrays
) -> DeltaSnnPolicy:
    nodes = artifact.graph.nodes
    if DEEP_NODE in nodes:
        raise AttributeError("a second hidden layer")
    policy = _untrained(artifact, codec, encoder)
    is_graded = isinstance(policy, DeltaMlpPolicy)
    is_read = np.isfinite(encoder.step)  # a step of infinity: no synapse reads the observation
    arrays |= {"step": np.where(is_read, encoder.step, 1.0), "action_bias": nodes["action"].bias}

    def of_observations(node: nir.NIRNode) -> NDArray[np.float64]:
        """Weights (N, obs), from those of the first channel of each observation."""
        first = node.weight.reshape(len(node.weight), encoder.observed, -1)[:, :, 0]
        return np.where(is_read, first / encoder.step, 0.0)

    if "skip" in nodes:
        arrays["past.weight"] = of_observations(nodes["skip"])
    if policy.hidden:
        arrays["into.weight"] = of_observations(nodes["fc1"])
        if is_graded:
            neurons = artifact.sigma_delta["sd1"]
            arrays["out.weight"] = nodes["fc2"].weight / neurons.threshold
            arrays |= {"bias": neurons.bias, "threshold": neurons.threshold}
        else:
            neuron = discretise("lif1", nodes["lif1"], artifact.convention)
            arrays |= {"out.weight": nodes["fc2"].weight, "bias": neuron.leak}
            arrays["_beta"] = _logits(neuron.membrane_decay)
    if not is_graded:
        arrays["_gamma"] = _logits(_readout_decays(artifact))
    state = policy.state_dict() | {n: torch.from_numpy(a).float() for n, a in arrays.items()}
    masks = {f"{n}.mask": (state[f"{n}.weight"] != 0).float() for n in ("into", "out", "past")}
    policy.load_state_dict(state | masks)
    return policy


def _untrained(artifact: Artifact, codec: Codec, encoder: DeltaEncoder) -> DeltaSnnPolicy:
    """Return a policy of the artifact's kind and sizes."""
    nodes = artifact.graph.nodes
    graded = isinstance(nodes["readout"], nir.I)
    neurons = nodes.get("sd1" if graded else "lif1")
    settings: dict[str, Any] = {
        "hidden": 0 if neurons is None else neurons.r.size,
        "skip": "skip" in nodes,
        "most": encoder.most,
        "code": encoder.code,
        "events_above": encoder.threshold,
        "clip": codec.normaliser.clip,
        "head": "discrete" if codec.chooses else "continuous",
        "clock": artifact.convention.clock,
    }
    actions = nodes["action"].bias.size
    if graded:
        return DeltaMlpPolicy(encoder.observed, actions, **settings)
    decays = _readout_decays(artifact)  # of currents: the neurons', or of a readout in their place
    if neurons is not None:
        decays = discretise("lif1", neurons, artifact.convention).current_decay
        if decays is None:
            raise AttributeError("lif1 has no current")
    settings |= {"integrated": "integral" in nodes, "timesteps": codec.timesteps}
    settings["current_decay"] = round(float(decays[0]), _DIGITS)
    return DeltaSnnPolicy(encoder.observed, actions, **settings)


def _readout_decays(artifact: Artifact) -> NDArray[np.floating[Any]]:
    node = artifact.graph.nodes["readout"]
    return discretise("readout", node, artifact.convention).membrane_decay


def _logits(share: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    return np.asarray(np.log(share) - np.log1p(-share))


def _popsan(artifact: Artifact, codec: Codec) -> PopsanPolicy:
    return PopsanPolicy(
        codec.encoder.observed,
        artifact.graph.nodes["readout"].bias.size,
        hidden=[layer.bias.size for layer in _layers(artifact.graph)[:-1]],
        populations=codec.encoder.width // codec.encoder.observed,
        timesteps=codec.timesteps,
        clip=codec.normaliser.clip,
        **_neurons(artifact),
    )


def _spiking_mlp(artifact: Artifact, codec: Codec) -> SpikingMlpPolicy:
    populations = codec.encoder.width // codec.encoder.observed
    code: dict[str, Any] = {"coding": "population", "populations": populations}
    if isinstance(codec.encoder, RateEncoder):
        code = {"coding": codec.encoder.mode}
    return SpikingMlpPolicy(
        codec.encoder.observed,
        artifact.graph.nodes["readout"].bias.size,
        hidden=[layer.bias.size for layer in _layers(artifact.graph)],
        **code,
        timesteps=codec.timesteps,
        clip=codec.normaliser.clip,
        head="discrete" if codec.chooses else "continuous",
        **_neurons(artifact),
    )


def _layers(graph: nir.NIRGraph) -> list[nir.Affine]:
    """Return fc1, fc2, ... in order."""
    count = sum(isinstance(node, SPIKING) for node in graph.nodes.values())
    return [graph.nodes[f"fc{number}"] for number in range(1, count + 1)]


def _neurons(artifact: Artifact) -> dict[str, Any]:
    """Return the decays and the threshold shared by all neurons."""
    neuron = discretise("lif1", artifact.graph.nodes["lif1"], artifact.convention)
    if neuron.threshold is None:
        raise AttributeError("lif1 has no threshold")
    shared = {
        "beta": round(float(neuron.membrane_decay[0]), _DIGITS),
        "threshold": float(neuron.threshold[0]),
    }
    if neuron.current_decay is not None:
        shared["alpha"] = round(float(neuron.current_decay[0]), _DIGITS)
    return shared
