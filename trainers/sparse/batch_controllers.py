"""Students in episodes: in float to collect walks, on the chip to validate, and what they count."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.trainers.policies import DeltaSnnPolicy, Policy, PrunedMlpPolicy
from spikedeploy.trainers.policies.delta_policy import delta_artifact

FloatArray = NDArray[np.float64]


class FloatController:
    """A policy in torch as a BatchController."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        if isinstance(self.policy, DeltaSnnPolicy):
            self._state: Any = self.policy.initial_states(robots)

    @torch.no_grad()
    def mean(self, observation: FloatArray) -> Tensor:
        """Take one control step: return the mean (B, act) of each robot's action."""
        seen = torch.from_numpy(observation).float()
        if isinstance(self.policy, DeltaSnnPolicy):
            return self.policy.advance(seen, self._state)[0]
        return self.policy.scores(seen)

    def act_batch(self, observation: FloatArray) -> NDArray[Any]:
        """Return actions (B, act), or (B,) if discrete."""
        return self.policy.env_action(self.mean(observation))


class ChipController:
    """An artifact on a chip as a BatchController, with the synaptic operations of its ledger."""

    def __init__(self, artifact: Artifact, chip: Chip) -> None:
        self._controller = SpikingController(artifact, chip, ledger="each")
        self.act_batch = self._controller.act_batch
        self._robots: list[int] = []

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._robots.append(robots)
        self._controller.reset(0)

    def operations(self, lengths: Sequence[int]) -> float:
        """Return the mean synaptic operations of a control step in all episodes so far.

        lengths: control steps of each; robots that are at their end keep their place, uncounted
        """
        found = self._controller.ledger.counts[:, :, EVENTS.index("sop")].sum(1)
        return _mean_in_episodes(found, self._robots, lengths)


class MultiplyingController(FloatController):
    """A float policy as a BatchController, with its multiplications with inputs that are not 0."""

    def __init__(self, policy: PrunedMlpPolicy) -> None:
        super().__init__(policy)
        self.policy: PrunedMlpPolicy = policy
        groups = [*policy.layers, *([policy.past] if policy.skip else [])]
        self._fan_outs = [each.fan_out.double() for each in groups]
        self._robots: list[int] = []
        self._steps: list[FloatArray] = []

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        super().reset(robots)
        self._robots.append(robots)

    @torch.no_grad()
    def mean(self, observation: FloatArray) -> Tensor:
        """Take one control step: return the mean (B, act) of each robot's action."""
        seen, policy = torch.from_numpy(observation).float(), self.policy
        mean, inputs = policy.scores(seen), policy.activations(seen)[1]
        inputs = [*inputs, inputs[0]]  # past the hidden layers
        pairs = zip(inputs, self._fan_outs, strict=False)
        macs = torch.stack([(x != 0).double() @ fan_out for x, fan_out in pairs])
        self._steps.append(macs.sum(0).numpy())
        return mean

    def operations(self, lengths: Sequence[int]) -> float:
        """Return the mean multiplications of a control step, as ChipController does."""
        return _mean_in_episodes(np.concatenate(self._steps), self._robots, lengths)


def _mean_in_episodes(rows: NDArray[Any], robots: Sequence[int], lengths: Sequence[int]) -> float:
    """Return the mean of rows (R,) while episodes last.

    rows: for each batch of episodes the robots of each control step, step after step
    robots: number of robots of each batch
    """
    within, at = [], 0
    for count in robots:
        ends = np.asarray(lengths[at : at + count])
        within.append((np.arange(ends.max())[:, None] < ends).ravel())
        at += count
    return float(rows[np.concatenate(within)].mean())


def controller_of(policy: Policy, chip: Chip) -> ChipController | MultiplyingController:
    """Return the policy as the chip runs it; a float policy as it is."""
    if isinstance(policy, DeltaSnnPolicy):
        return ChipController(delta_artifact(policy), chip)
    if isinstance(policy, PrunedMlpPolicy):
        return MultiplyingController(policy)
    raise TypeError(f"{type(policy).__name__} is no policy that is pruned")
