"""Episodes of students: in float for collection, on the chip for validation."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.trainers.policies import DeltaSnnPolicy, Policy
from spikedeploy.trainers.policies.delta_graph import delta_artifact
from spikedeploy.trainers.sparse.collect import BatchController, Stateless

FloatArray = NDArray[np.float64]


class DeltaController:
    """A DeltaSnnPolicy in torch as a BatchController, with its mean operations.

    sops: mean synaptic operations in a control step of the episodes so far
    """

    def __init__(self, policy: DeltaSnnPolicy) -> None:
        self._policy = policy
        self._inputs = (
            (policy.into.fan_out + policy.past.fan_out) if policy.skip else (policy.into.fan_out)
        )
        self._operations = 0.0
        self._steps = 0

    @property
    def sops(self) -> float:
        """Mean synaptic operations in a control step of the episodes so far."""
        return self._operations / max(self._steps, 1)

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._state = self._policy.rest(robots)

    @torch.no_grad()
    def act_batch(self, observation: FloatArray) -> NDArray[Any]:
        """Return actions (B, act), or (B,) if discrete."""
        policy = self._policy
        mean, events, hidden = policy.advance(torch.from_numpy(observation).float(), self._state)
        spikes = events.abs() if policy.code == "unary" else (events != 0).float()
        self._operations += float((spikes @ self._inputs + hidden @ policy.out.fan_out).sum())
        self._steps += len(observation)
        return _numbers(policy.decide(mean))


def in_float(policy: Policy) -> BatchController:
    """Return the policy in torch."""
    if isinstance(policy, DeltaSnnPolicy):
        return DeltaController(policy)

    @torch.no_grad()
    def act(observation: FloatArray) -> NDArray[Any]:
        return _numbers(policy(torch.from_numpy(observation).float()))

    return Stateless(act)


class ChipController:
    """An artifact on a chip as a BatchController."""

    def __init__(self, artifact: Artifact, chip: Chip) -> None:
        self.controller = SpikingController(artifact, chip, ledger="total")
        self.act_batch = self.controller.act_batch

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self.controller.reset(0)


def on_chip(policy: Policy, chip: Chip) -> BatchController:
    """Return the policy as the chip runs it; a float policy as it is."""
    if isinstance(policy, DeltaSnnPolicy):
        return ChipController(delta_artifact(policy), chip)
    return in_float(policy)


def _numbers(action: torch.Tensor) -> NDArray[Any]:
    return (action.double() if action.is_floating_point() else action).numpy()
