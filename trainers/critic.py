"""The twin critics: two estimates of the return, of which the smaller is believed."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policy import full_precision


class Critic(nn.Module):
    """One estimate of the discounted return of an observation and an action."""

    def __init__(self, size: int, hidden: Sequence[int]) -> None:
        super().__init__()
        widths = (size, *hidden)
        pairs = pairwise(widths)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairs)
        self.value = nn.Linear(widths[-1], 1)

    def forward(self, joined: Tensor) -> Tensor:
        """Return (B,) of observation and action side by side."""
        for layer in self.layers:
            joined = torch.relu(layer(joined))
        return full_precision(self.value, joined).squeeze(-1)


class TwinCritic(nn.Module):
    """Two critics with their own weights (Fujimoto et al. 2018)."""

    def __init__(self, observations: int, actions: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.pair = nn.ModuleList(Critic(observations + actions, hidden) for _ in range(2))

    def forward(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return both estimates (B,) for a normalised observation and an action."""
        joined = torch.cat([observation, action], dim=1)
        first, second = (critic(joined) for critic in self.pair)
        return first, second


@torch.no_grad()
def follow(target: nn.Module, source: nn.Module, tau: float) -> None:
    """Move the target's parameters towards the source's."""
    # target = target + tau (source - target)
    torch._foreach_lerp_(list(target.parameters()), list(source.parameters()), tau)
