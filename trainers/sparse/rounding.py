"""Rounding: what a chip's own quantiser makes of a policy's numbers.

The channels of an observation must weigh exactly 1, 2 ... K times the same integer. Rounded each by
itself, three events up and one event down three times would not cancel, and currents that hardly
decay would drift away from the observation. So the weight of one event is rounded, and a policy
with rounded weights has multiples of it on all channels, which the quantiser then leaves as they
are: its scale is that of the largest weight, which is 255 on Loihi and a multiple of K for 3 and 5.
"""

import math
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.policies import DeltaSnnPolicy
from spikedeploy.trainers.policies.delta_policy import delta_artifact, live_neurons

_STEP = "weights"  # the kind of rounding, as an arithmetic's `ablation_steps` name it


def check_rounding(target: Chip) -> None:
    """Refuse chips whose rounding of weights alone is not defined."""
    if _STEP not in target.arithmetic.ablation_steps:
        raise ConfigError(
            f"rounding: the weights of {target.name} cannot be rounded by themselves, which "
            "training with rounding needs. Set rounding=false, or choose chip=loihi1 or int."
        )


@torch.no_grad()
def rounding_offsets(
    policy: DeltaSnnPolicy, target: Chip
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Return what rounding adds to each field of DeltaWeights, and the quanta of each matrix.

    That of an observation is the error of the channel of one event. Decay factors, biases and
    thresholds are those of the chip's registers. Weights are rounded to multiples of their quanta;
    0 for those that are out.
    """
    artifact = delta_artifact(policy)
    exact = compile_program(artifact, chip("ideal"), limits=False)
    rounded = compile_program(artifact, target, limits=False)
    offsets = {name: torch.zeros_like(each) for name, each in vars(policy.weights()).items()}
    quanta = {name: torch.zeros_like(each.mask) for name, each in policy.groups.items()}
    live = torch.nonzero(live_neurons(policy)).ravel()
    for before, after in zip(exact.layers, rounded.layers, strict=True):
        units = target.arithmetic.partly_rounded(before, after, _STEP)
        # on the grid of the chip lie all weights of a layer, whatever is left of each matrix
        held = np.concatenate([np.abs(s.weight).ravel() for s in units.synapses])
        step = _grid(held.astype(np.int64), target) * after.scale
        rows = live if before.spiking else torch.arange(policy.actions)
        for old, new in zip(before.synapses, units.synapses, strict=True):
            error = new.weight * after.scale - old.weight
            counts, columns = np.ones(len(error)), live  # what a unit of the source's output counts
            if from_events := old.source == exact.input:
                # that of the channel of one event
                error = error.reshape(policy.observations, 2 * policy.most, -1)[:, 0]
                counts, columns = policy.step.double().numpy(), torch.arange(policy.observations)
            name = "into" if before.spiking else "past" if from_events else "out"
            for found, each in ((offsets, error), (quanta, np.broadcast_to(step, error.shape))):
                of_unit = torch.from_numpy((each / counts[:, None]).T).float()
                found[name][rows[:, None], columns[None]] = of_unit
        decay = torch.from_numpy(after.membrane_decay / target.arithmetic.decay_one).float()
        if before.name == "readout" and policy.hidden:
            offsets["gamma"] = decay - policy.gamma
        if before.spiking:
            bias = after.voltage_bias * after.scale - before.voltage_bias
            threshold = after.threshold * after.scale - before.threshold
            offsets["beta"][live] = decay - policy.beta[live]
            offsets["bias"][live] = torch.from_numpy(bias).float()
            offsets["threshold"][live] = torch.from_numpy(threshold).float()
    # what pruning took out stays out
    matrices = {name: offsets[name] * each.mask for name, each in policy.groups.items()}
    steps = {name: quanta[name].abs() * each.mask for name, each in policy.groups.items()}
    return offsets | matrices, steps


def _grid(held: NDArray[np.int64], target: Chip) -> int:
    """Return the distance of neighbouring weights of a layer, from those (n,) that it holds.

    Weights count 2**exponent times, with an exponent for all: the largest one needs it.
    """
    registers: Any = target.arithmetic
    unit = 1 << int(registers.mantissa_shift)
    over = max(int(held.max(initial=0)) / unit / registers.weight_max, 1.0)
    return int(registers.weight_step * unit << math.ceil(math.log2(over)))


@torch.no_grad()
def with_offsets(policy: DeltaSnnPolicy, offsets: Mapping[str, Tensor]) -> DeltaSnnPolicy:
    """Return a copy that computes with the numbers of the chip: those of the policy and these."""
    copy = deepcopy(policy)
    for name, matrix in copy.groups.items():
        if name in offsets:
            matrix.weight.add_(offsets[name])
    if "beta" in offsets:
        copy.set_decays(copy.beta + offsets["beta"], copy.gamma + offsets["gamma"])
        copy.bias.add_(offsets["bias"])
        copy.threshold.add_(offsets["threshold"])
    return copy


@torch.no_grad()
def round_for_chip(policy: DeltaSnnPolicy, target: Chip) -> DeltaSnnPolicy:
    """Return the policy with the numbers that the chip holds; weights that round to 0 are out."""
    offsets, _ = rounding_offsets(policy, target)
    copy = with_offsets(policy, offsets)
    for matrix in copy.groups.values():
        matrix.mask *= matrix.weight != 0
        matrix.weight.mul_(matrix.mask)  # what is out is stored as zeros, which take no room
    return copy
