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
    """A DeltaSnnPolicy in torch as a BatchController."""

    def __init__(self, policy: DeltaSnnPolicy) -> None:
        self._policy = policy

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._state = self._policy.rest(robots)

    @torch.no_grad()
    def act_batch(self, observation: FloatArray) -> NDArray[Any]:
        """Return actions (B, act), or (B,) if discrete."""
        mean, _, _ = self._policy.advance(torch.from_numpy(observation).float(), self._state)
        return _numbers(self._policy.decide(mean))


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
        self._controller = SpikingController(artifact, chip, ledger="none")
        self.act_batch = self._controller.act_batch

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._controller.reset(0)


def on_chip(policy: Policy, chip: Chip) -> BatchController:
    """Return the policy as the chip runs it; a float policy as it is."""
    if isinstance(policy, DeltaSnnPolicy):
        return ChipController(delta_artifact(policy), chip)
    return in_float(policy)


def _numbers(action: torch.Tensor) -> NDArray[Any]:
    return (action.double() if action.is_floating_point() else action).numpy()
