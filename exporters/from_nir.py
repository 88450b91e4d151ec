"""Reads a spiking policy back from its `.nir` file, to check the file or to train on."""

from pathlib import Path
from typing import Any

import nir
import numpy as np
import torch
from numpy.typing import NDArray

from runtime.artifact import Artifact, load
from runtime.discrete import discretise
from runtime.errors import ArtifactError
from runtime.population import PopulationEncoder
from trainers.policies import PopsanPolicy

DIGITS = 12  # of a decay; what dt / tau loses of it lies behind them


def from_nir(path: str | Path) -> PopsanPolicy:
    """Return the policy that `to_nir` wrote, in float32 as it was trained."""
    try:
        return policy(load(path))
    except (KeyError, AttributeError) as error:
        raise ArtifactError(
            f"{path} is not laid out as fc1, lif1, ..., readout with a population code ({error}); "
            "only what spikedeploy exported can be read back as a torch policy"
        ) from error


def policy(artifact: Artifact) -> PopsanPolicy:
    """Return the artifact as a torch policy."""
    codec = artifact.codec
    if codec is None or not isinstance(codec.encoder, PopulationEncoder):
        raise AttributeError("no population encoder")
    layers = _layers(artifact.graph)
    network = PopsanPolicy(
        codec.encoder.observed,
        artifact.graph.nodes["readout"].bias.size,
        hidden=[layer.bias.size for layer in layers[:-1]],
        populations=codec.encoder.mean.shape[1],
        timesteps=codec.timesteps,
        clip=codec.normaliser.clip,
        **_neurons(artifact),
    )
    arrays = {
        "normalizer.mean": codec.normaliser.mean,
        "normalizer.std": codec.normaliser.std,
        "encoder.mean": codec.encoder.mean,
        "encoder.log_std": np.log(codec.encoder.std),
        "decoder_weight": _blocks(artifact.graph.nodes["readout"].weight),
        "decoder_bias": artifact.graph.nodes["readout"].bias,
        **{f"layers.{k}.weight": layer.weight for k, layer in enumerate(layers)},
        **{f"layers.{k}.bias": layer.bias for k, layer in enumerate(layers)},
    }
    # the file's float64 numbers are float32 ones, so this loses nothing
    network.load_state_dict({name: torch.from_numpy(a).float() for name, a in arrays.items()})
    return network


def _layers(graph: nir.NIRGraph) -> list[nir.Affine]:
    """Return fc1, fc2, ... in order."""
    count = sum(isinstance(node, nir.CubaLIF) for node in graph.nodes.values())
    return [graph.nodes[f"fc{number}"] for number in range(1, count + 1)]


def _neurons(artifact: Artifact) -> dict[str, Any]:
    """Return the decays and the threshold that all neurons share."""
    neuron = discretise("lif1", artifact.graph.nodes["lif1"], artifact.convention)
    if neuron.current_decay is None or neuron.threshold is None:
        raise AttributeError("lif1 has no current or no threshold")
    return {
        "alpha": round(float(neuron.current_decay[0]), DIGITS),
        "beta": round(float(neuron.membrane_decay[0]), DIGITS),
        "threshold": float(neuron.threshold[0]),
    }


def _blocks(weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the populations' own weights (act, P) of a block-diagonal readout (act, act·P)."""
    actions = np.arange(len(weight))
    own: NDArray[np.float64] = weight.reshape(len(weight), len(weight), -1)[actions, actions]
    return own
