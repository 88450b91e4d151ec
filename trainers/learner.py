"""Critics: float networks that estimate the discounted return."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.policy import full_precision

# -- Adam, the optimiser of all algorithms, with its state as named tensors for
#    checkpoints.


def adam(module: nn.Module, learning_rate: float) -> torch.optim.Adam:
    """Return Adam for a module's parameters (Kingma and Ba 2015)."""
    parameters = list(module.parameters())
    # the fused implementation is four times as fast as the others on one core
    captured = parameters[0].is_cuda  # its steps may become part of a CUDA graph
    return torch.optim.Adam(parameters, lr=learning_rate, fused=True, capturable=captured)


def adam_tensors(optimizer: torch.optim.Adam) -> dict[str, Tensor]:
    """Return Adam's state by name; empty before its first step."""
    states = optimizer.state_dict()["state"].items()
    return {f"{index}.{key}": value for index, state in states for key, value in state.items()}


def load_adam(optimizer: torch.optim.Adam, named: dict[str, Tensor]) -> None:
    """Restore the state that `adam_tensors` returned."""
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in named.items():
        index, key = name.split(".")
        state.setdefault(int(index), {})[key] = value
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})


def under(prefix: str, named: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return the tensors whose names start with the prefix and a dot, with these removed."""
    start = f"{prefix}."
    return {name[len(start) :]: t for name, t in named.items() if name.startswith(start)}


# -- Critics: float networks that estimate the discounted return.


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
