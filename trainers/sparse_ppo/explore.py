"""Exploration around a policy whose states live on from one control step to the next."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.trainers.ppo.learner import CategoricalHead
from spikedeploy.trainers.sparse_ppo.replay import Means


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
    """A policy that explores, as a BatchController.

    means: the policy, whose states live on
    drawn: what was drawn in every control step of the episodes, (B, act) or (B,) each
    """

    def __init__(self, means: Means, head: NoisyActions | CategoricalHead) -> None:
        self.means, self._head = means, head
        self.drawn: list[Tensor] = []

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self.means.reset(robots)
        self.drawn = []

    @torch.no_grad()
    def act_batch(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """Return actions (B, act), or (B,) if discrete."""
        mean = self.means(torch.from_numpy(observation).float())
        self.drawn.append(self._head.draw(mean))
        return self._head.action(self.drawn[-1]).numpy()
