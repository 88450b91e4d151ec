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
    """Return the artifact as a torch policy."""
    if artifact.codec is None:
        raise AttributeError("no codec")
    if isinstance(artifact.codec.encoder, DeltaEncoder):
        return _event_driven(artifact, artifact.codec, artifact.codec.encoder)
    cuba = isinstance(artifact.graph.nodes["lif1"], nir.CubaLIF)
    network = (_popsan if cuba else _spiking_mlp)(artifact, artifact.codec)
    layers = _layers(artifact.graph)
    arrays: Arrays = {
        "normalizer.mean": artifact.codec.normaliser.mean,
        "normalizer.std": artifact.codec.normaliser.std,
        **{f"layers.{k}.weight": layer.weight for k, layer in enumerate(layers)},
        **{f"layers.{k}.bias": layer.bias for k, layer in enumerate(layers)},
        **_encoder(artifact.codec),
        **_readout(artifact.graph.nodes["readout"], cuba),
    }
    # exact: the float64 numbers of the file were float32
    network.load_state_dict({name: torch.from_numpy(a).float() for name, a in arrays.items()})
    return network


def _event_driven(artifact: Artifact, codec: Codec, encoder: DeltaEncoder) -> DeltaSnnPolicy:
    nodes = artifact.graph.nodes
    policy = _untrained(artifact, codec, encoder)
    arrays: Arrays = {
        "normalizer.mean": codec.normaliser.mean,
        "normalizer.std": codec.normaliser.std,
        # a step of infinity is of an observation that no synapse reads
        "step": np.where(np.isfinite(encoder.step), encoder.step, 1.0),
        "action_bias": nodes["action"].bias,
    }
    if "skip" in nodes:
        arrays["past.weight"] = _of_observations(nodes["skip"].weight, encoder)
    if policy.hidden:
        graded = isinstance(policy, DeltaMlpPolicy)
        arrays |= (_sigma_delta if graded else _hidden)(artifact, encoder)
    if not isinstance(policy, DeltaMlpPolicy):
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
    settings["integrated"] = "integral" in nodes
    settings["current_decay"] = round(float(_current_decays(artifact)[0]), _DIGITS)
    return DeltaSnnPolicy(encoder.observed, actions, **settings)


def _readout_decays(artifact: Artifact) -> NDArray[np.floating[Any]]:
    node = artifact.graph.nodes["readout"]
    return discretise("readout", node, artifact.convention).membrane_decay


def _current_decays(artifact: Artifact) -> NDArray[np.floating[Any]]:
    """Return the currents' decay factors: of the neurons, or of a readout that stands for them."""
    if "lif1" not in artifact.graph.nodes:
        return _readout_decays(artifact)
    neuron = discretise("lif1", artifact.graph.nodes["lif1"], artifact.convention)
    if neuron.current_decay is None:
        raise AttributeError("lif1 has no current")
    return neuron.current_decay


def _hidden(artifact: Artifact, encoder: DeltaEncoder) -> Arrays:
    nodes = artifact.graph.nodes
    neuron = discretise("lif1", nodes["lif1"], artifact.convention)
    return {
        "into.weight": _of_observations(nodes["fc1"].weight, encoder),
        "out.weight": nodes["fc2"].weight,
        "bias": neuron.leak,
        "_beta": _logits(neuron.membrane_decay),
    }


def _sigma_delta(artifact: Artifact, encoder: DeltaEncoder) -> Arrays:
    nodes, neurons = artifact.graph.nodes, artifact.sigma_delta["sd1"]
    return {
        "into.weight": _of_observations(nodes["fc1"].weight, encoder),
        "out.weight": nodes["fc2"].weight / neurons.threshold,
        "bias": neurons.bias,
        "threshold": neurons.threshold,
    }


def _of_observations(weight: NDArray[np.float64], encoder: DeltaEncoder) -> NDArray[np.float64]:
    """Return weights (N, obs) of observations, from those of the first channel of each."""
    first = weight.reshape(len(weight), encoder.observed, -1)[:, :, 0]
    return np.asarray(np.where(np.isfinite(encoder.step), first / encoder.step, 0.0))


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
    return SpikingMlpPolicy(
        codec.encoder.observed,
        artifact.graph.nodes["readout"].bias.size,
        hidden=[layer.bias.size for layer in _layers(artifact.graph)],
        **_code(codec),
        timesteps=codec.timesteps,
        clip=codec.normaliser.clip,
        head="discrete" if codec.chooses else "continuous",
        **_neurons(artifact),
    )


def _code(codec: Codec) -> dict[str, Any]:
    if isinstance(codec.encoder, RateEncoder):
        return {"coding": codec.encoder.mode}
    populations = codec.encoder.width // codec.encoder.observed
    return {"coding": "population", "populations": populations}


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


def _encoder(codec: Codec) -> Arrays:
    encoder = codec.encoder
    if isinstance(encoder, PopulationEncoder):
        return {"encoder.mean": encoder.mean, "encoder.log_std": np.log(encoder.std)}
    if isinstance(encoder, RateEncoder):
        return {"encoder.low": encoder.low, "encoder.high": encoder.high}
    raise AttributeError(f"a code of kind {encoder.kind}")


def _readout(readout: nir.Affine, cuba: bool) -> Arrays:
    if cuba:
        return {"decoder_weight": _blocks(readout.weight), "decoder_bias": readout.bias}
    return {"readout.weight": readout.weight, "readout.bias": readout.bias}


def _blocks(weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights (act, P) of the blocks of a block-diagonal readout (act, act·P)."""
    actions = np.arange(len(weight))
    own: NDArray[np.float64] = weight.reshape(len(weight), len(weight), -1)[actions, actions]
    return own
