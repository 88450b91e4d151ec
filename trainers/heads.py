"""What exploration adds to a policy: the distribution that actions are drawn from."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from spikedeploy.trainers.policy import Head

HALF_LOG_2_PI = 0.5 * math.log(2.0 * math.pi)


class CategoricalHead(nn.Module):
    """One of a few actions; `Latent.mean` holds their logits.

    temperature: the logits are divided by it; near zero, only the best action is drawn
    """

    temperature = 1.0

    def draw(self, mean: Tensor) -> Tensor:
        """Return the indices (B,) of actions drawn for the logits (B, act)."""
        return torch.multinomial((mean / self.temperature).softmax(-1), 1).squeeze(-1)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return (B,) of what was drawn."""
        return self._logs(mean).gather(-1, drawn[:, None]).squeeze(-1)

    def entropy(self, mean: Tensor) -> Tensor:
        """Return (B,)."""
        logs = self._logs(mean)
        # H = -sum p log p
        return -(logs.exp() * logs).sum(-1)

    def action(self, drawn: Tensor) -> Tensor:
        """Return what the environment is given: the index itself."""
        return drawn

    def _logs(self, mean: Tensor) -> Tensor:
        """Return the logarithm of every action's probability (B, act)."""
        return functional.log_softmax(mean / self.temperature, -1)


class GaussianHead(nn.Module):
    """A Gaussian around `Latent.mean`, squashed by tanh, with one learned spread per action.

    Ratios and divergences are those of the Gaussian before tanh: what tanh adds to a
    log-probability depends on the action alone and cancels. Its spread is learned, so it needs no
    temperature.
    """

    temperature = 1.0

    def __init__(self, actions: int, spread: float) -> None:
        super().__init__()
        self.log_std = nn.Parameter(torch.full((actions,), math.log(spread)))

    def draw(self, mean: Tensor) -> Tensor:
        """Return actions before tanh (B, act) drawn around the mean (B, act)."""
        return mean + self.log_std.exp() * torch.randn_like(mean)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return (B,) of what was drawn."""
        # log p = sum(-1/2 ((u - mean) / std)^2 - log std - 1/2 log 2 pi)
        noise = (drawn - mean) / self.log_std.exp()
        return (-0.5 * noise.square() - self.log_std - HALF_LOG_2_PI).sum(-1)

    def entropy(self, mean: Tensor) -> Tensor:
        """Return (B,)."""
        # H = sum(1/2 + 1/2 log 2 pi + log std)
        return (0.5 + HALF_LOG_2_PI + self.log_std).sum().expand(len(mean))

    def action(self, drawn: Tensor) -> Tensor:
        """Return what the environment is given (B, act) in [-1, 1]."""
        return torch.tanh(drawn).double()


def exploration(head: Head, actions: int, spread: float) -> CategoricalHead | GaussianHead:
    """Return the distribution for a policy's head."""
    return CategoricalHead() if head == "discrete" else GaussianHead(actions, spread)
