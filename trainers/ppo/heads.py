"""Exploration of PPO: the distributions from which actions are drawn."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from spikedeploy.trainers.policies import Head

HALF_LOG_2_PI = 0.5 * math.log(2.0 * math.pi)


class CategoricalHead(nn.Module):
    """Categorical distribution over discrete actions; `Latent.mean` holds their logits.

    temperature: divisor of the logits; near zero only the best action is drawn
    """

    temperature = 1.0

    def draw(self, mean: Tensor) -> Tensor:
        """Return the indices (B,) of actions drawn for the logits (B, act)."""
        return torch.multinomial((mean / self.temperature).softmax(-1), 1).squeeze(-1)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return the log-probability (B,) of drawn actions."""
        return self._logs(mean).gather(-1, drawn[:, None]).squeeze(-1)

    def entropy(self, mean: Tensor) -> Tensor:
        """Return the entropy (B,)."""
        logs = self._logs(mean)
        # H = -sum p log p
        return -(logs.exp() * logs).sum(-1)

    def action(self, drawn: Tensor) -> Tensor:
        """Return the action of the environment: the index itself."""
        return drawn

    def _logs(self, mean: Tensor) -> Tensor:
        """Return the log-probability of every action (B, act)."""
        return functional.log_softmax(mean / self.temperature, -1)


class GaussianHead(nn.Module):
    """Gaussian around `Latent.mean`, squashed by tanh, with a learned spread for each action.

    Ratios and divergences are those of the Gaussian before tanh: the correction of the
    log-probability by tanh depends on the action alone and cancels. The spread is learned, so that
    the temperature has no effect.
    """

    temperature = 1.0

    def __init__(self, actions: int, spread: float) -> None:
        super().__init__()
        self.log_std = nn.Parameter(torch.full((actions,), math.log(spread)))

    def draw(self, mean: Tensor) -> Tensor:
        """Return actions before tanh (B, act) drawn around the mean (B, act)."""
        return mean + self.log_std.exp() * torch.randn_like(mean)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return the log-probability (B,) of drawn actions."""
        # log p = sum(-1/2 ((u - mean) / std)^2 - log std - 1/2 log 2 pi)
        noise = (drawn - mean) / self.log_std.exp()
        return (-0.5 * noise.square() - self.log_std - HALF_LOG_2_PI).sum(-1)

    def entropy(self, mean: Tensor) -> Tensor:
        """Return the entropy (B,)."""
        # H = sum(1/2 + 1/2 log 2 pi + log std)
        return (0.5 + HALF_LOG_2_PI + self.log_std).sum().expand(len(mean))

    def action(self, drawn: Tensor) -> Tensor:
        """Return the action of the environment (B, act) in [-1, 1]."""
        return torch.tanh(drawn).double()


def exploration(head: Head, actions: int, spread: float) -> CategoricalHead | GaussianHead:
    """Return the distribution for a policy's head."""
    return CategoricalHead() if head == "discrete" else GaussianHead(actions, spread)
