"""Exploration around a policy whose states live on from one control step to the next."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.trainers.policies import DeltaSnnPolicy
from spikedeploy.trainers.ppo.learner import CategoricalHead


class NoisyActions:
    """Gaussian around the deterministic action tanh(mean), executed within [-1, 1].

    spread: standard deviation [action]
    """

    def __init__(self, spread: float) -> None:
        self.spread = spread

    def draw(self, mean: Tensor) -> Tensor:
        """Return actions (B, act) drawn around those of the means (B, act), before clipping."""
        return torch.tanh(mean) + self.spread * torch.randn_like(mean)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return the log-probability (B,) of drawn actions, but for a constant."""
        # log p = -1/2 sum ((a - tanh(mean)) / spread)^2 ; the same spread for all of an iteration
        return -0.5 * ((drawn - torch.tanh(mean)) / self.spread).square().sum(-1)

    def action(self, drawn: Tensor) -> Tensor:
        """Return the action of the environment (B, act) in [-1, 1]."""
        return drawn.clamp(-1.0, 1.0).double()


class Exploring:
    """A DeltaSnnPolicy that explores, as a BatchController.

    drawn: what was drawn in every control step of the episodes, (B, act) or (B,) each
    """

    def __init__(self, policy: DeltaSnnPolicy, head: NoisyActions | CategoricalHead) -> None:
        self._policy, self._head = policy, head
        self.drawn: list[Tensor] = []

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._state = self._policy.rest(robots)
        self.drawn = []

    @torch.no_grad()
    def act_batch(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """Return actions (B, act), or (B,) if discrete."""
        mean, _, _ = self._policy.advance(torch.from_numpy(observation).float(), self._state)
        self.drawn.append(self._head.draw(mean))
        return self._head.action(self.drawn[-1]).numpy()
