"""Rounding in training: what a chip's own quantiser makes of a policy's numbers.

Decay factors, biases and thresholds of LIF neurons are those of the chip's registers.

The channels of an observation must weigh exactly 1, 2 ... K times the same integer. Rounded each by
itself, three events up and one event down three times would not cancel, and currents that hardly
decay would drift away from the observation. So the weight of one event is rounded, and a policy
with rounded weights has multiples of it on all channels, which the quantiser then leaves as they
are: its scale is that of the largest weight, which is 255 on Loihi and a multiple of K for 3 and 5.
"""

from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.policies import DeltaMlpPolicy, DeltaSnnPolicy, Policy
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
    """Return what rounding adds to each field of DeltaWeights, by name.

    That of an observation is the error of the channel of one event. Of sigma-delta neurons only
    weights are rounded here.
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
    offsets = {name: added * getattr(policy, name).mask for name, added in offsets.items()}
    if isinstance(policy, DeltaMlpPolicy):
        return offsets
    layers = zip(exact.layers, rounded.layers, strict=True)
    return offsets | _neuron_offsets(policy, hidden, layers, target)


@torch.no_grad()
def _neuron_offsets(
    policy: DeltaSnnPolicy, hidden: Tensor, layers: Iterable[tuple[Layer, Layer]], target: Chip
) -> dict[str, Tensor]:
    """Return what rounding adds to decay factors, biases and thresholds."""
    offsets = {"gamma": torch.zeros_like(policy.gamma)}
    offsets |= {name: torch.zeros_like(policy.bias) for name in ("beta", "bias", "threshold")}
    for before, after in layers:
        decay = torch.from_numpy(after.membrane_decay / target.arithmetic.decay_one)
        if before.name == "readout" and policy.hidden:
            offsets["gamma"] = decay.float() - policy.gamma
        if before.spiking:
            offsets["beta"][hidden] = decay.float() - policy.beta[hidden]
            for name, exact, rounded in (
                ("bias", before.voltage_bias, after.voltage_bias),
                ("threshold", before.threshold, after.threshold),
            ):
                offsets[name][hidden] = torch.from_numpy(rounded * after.scale - exact).float()
    return offsets


@torch.no_grad()
def add_offsets(policy: DeltaSnnPolicy, offsets: Mapping[str, Tensor]) -> None:
    """Add what rounding adds, so that the policy computes with the numbers of the chip."""
    for name in ("into", "out", "past"):
        if name in offsets:
            getattr(policy, name).weight += offsets[name]
    if "beta" in offsets:
        policy.set_decays(policy.beta + offsets["beta"], policy.gamma + offsets["gamma"])
        policy.bias.add_(offsets["bias"])
        policy.threshold.add_(offsets["threshold"])


@torch.no_grad()
def deployed(policy: Policy, target: Chip, rounding: bool) -> Policy:
    """Return the policy with the numbers that the chip holds; a float policy as it is.

    rounding: whether they are rounded; weights that round to 0 are taken out
    """
    if not rounding or not isinstance(policy, DeltaSnnPolicy):
        return policy
    copy = deepcopy(policy)
    add_offsets(copy, rounding_offsets(policy, target))
    for matrix in (copy.into, copy.out, copy.past):
        matrix.mask *= matrix.weight != 0
    return copy


def _errors(
    program: Program, before: Layer, after: Layer, target: Chip
) -> Iterator[tuple[str, str, Array]]:
    """Name of each kind of weights onto a layer, their source, and their errors (M, N)."""
    units = target.arithmetic.partly_rounded(before, after, _STEP)
    for exact, rounded in zip(before.synapses, units.synapses, strict=True):
        kind = "into" if before.spiking else "past" if exact.source == program.input else "out"
        yield kind, exact.source, rounded.weight * after.scale - exact.weight


def _per_observation(policy: DeltaSnnPolicy, error: Array) -> Array:
    """Error (obs, N) of one event of each observation, from those of all channels (M, N)."""
    first = error.reshape(policy.observations, 2 * policy.most, -1)[:, 0]
    return np.asarray(first / policy.step.double().numpy()[:, None])
