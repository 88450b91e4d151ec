"""Critics: float networks that estimate the discounted return."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.policy import full_precision


class Critic(nn.Module):
    """A multilayer perceptron that estimates the discounted return of its input."""

    def __init__(self, size: int, hidden: Sequence[int]) -> None:
        super().__init__()
        widths = (size, *hidden)
        pairs = pairwise(widths)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairs)
        self.value = nn.Linear(widths[-1], 1)

    def forward(self, inputs: Tensor) -> Tensor:
        """Return estimates (B,) for inputs (B, size)."""
        for layer in self.layers:
            inputs = torch.relu(layer(inputs))
        return full_precision(self.value, inputs).squeeze(-1)


class TwinCritic(nn.Module):
    """Two critics of observation and action, used by their minimum (Fujimoto et al. 2018)."""

    def __init__(self, observations: int, actions: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.pair = nn.ModuleList(Critic(observations + actions, hidden) for _ in range(2))

    def forward(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return both estimates (B,) for a normalised observation and an action."""
        inputs = torch.cat([observation, action], dim=1)
        first, second = (critic(inputs) for critic in self.pair)
        return first, second


@torch.no_grad()
def move_towards(target: nn.Module, source: nn.Module, tau: float) -> None:
    """Move the target's parameters towards the source's by the share tau."""
    # target = target + tau (source - target)
    torch._foreach_lerp_(list(target.parameters()), list(source.parameters()), tau)
