"""Rounding in training: what a chip's own quantiser makes of a policy's weights."""

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.policies import DeltaMlpPolicy, DeltaSnnPolicy
from spikedeploy.trainers.policies.delta_graph import delta_artifact, live_neurons

Array = NDArray[np.float64]
_STEP = "weights"  # the kind of rounding, as an arithmetic's `ablation_steps` name it


def check_rounding(target: Chip) -> None:
    """Refuse chips whose rounding of weights alone is not defined."""
    if _STEP not in target.arithmetic.ablation_steps:
        raise ConfigError(
            f"rounding: the weights of {target.name} cannot be rounded by themselves, which "
            "training with rounding needs. Set rounding=false, or choose chip=loihi1 or int."
        )


def rounding_offsets(policy: DeltaSnnPolicy, target: Chip) -> dict[str, Tensor]:
    """Return what rounding adds to the weights of `into`, `out` and `past`, by name, each (N, M).

    The channels of an observation are rounded apart, each by its own error; an observation takes
    their mean error for one event.
    """
    artifact = delta_artifact(policy)
    exact = compile_program(artifact, chip("ideal"), limits=False)
    rounded = compile_program(artifact, target, limits=False)
    offsets = {
        name: torch.zeros_like(getattr(policy, name).weight) for name in ("into", "out", "past")
    }
    hidden = torch.nonzero(live_neurons(policy)).ravel()
    for before, after in zip(exact.layers, rounded.layers, strict=True):
        for name, source, error in _errors(exact, before, after, target):
            added = _per_observation(policy, error) if source == exact.input else error
            if name == "out" and isinstance(policy, DeltaMlpPolicy):  # by what a spike counts
                added = added / policy.threshold[hidden].double().numpy()[:, None]
            rows = hidden if name == "into" else torch.arange(policy.actions)
            columns = hidden if name == "out" else torch.arange(policy.observations)
            offsets[name][rows[:, None], columns[None]] = torch.from_numpy(added.T).float()
    # what pruning took out stays out
    return {name: added * getattr(policy, name).mask for name, added in offsets.items()}


def _errors(
    program: Program, before: Layer, after: Layer, target: Chip
) -> Iterator[tuple[str, str, Array]]:
    """Name of each kind of weights onto a layer, their source, and their errors (M, N)."""
    units = target.arithmetic.partly_rounded(before, after, _STEP)
    for exact, rounded in zip(before.synapses, units.synapses, strict=True):
        kind = "into" if before.spiking else "past" if exact.source == program.input else "out"
        yield kind, exact.source, rounded.weight * after.scale - exact.weight


def _per_observation(policy: DeltaSnnPolicy, error: Array) -> Array:
    """Mean error (obs, N) of one event of each observation, from those of its channels (M, N)."""
    k = np.arange(1, policy.most + 1)
    each = k if policy.code == "one-hot" else np.ones_like(k)
    signed = np.concatenate([each, -each])[None, :, None]
    channels = error.reshape(policy.observations, len(signed[0]), -1)
    moved = policy.step.double().numpy()[:, None]
    return np.asarray((channels / signed).mean(axis=1) / moved)
