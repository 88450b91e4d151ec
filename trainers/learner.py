"""Parts of several learners: Adam, networks and optimisers by name for checkpoints, critics."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.policy import Policy, full_precision


class Learner:
    """Networks and optimisers of an algorithm, which its checkpoints hold.

    policy: what is validated and saved
    modules, optimizers: by their names in checkpoints, the policy left out
    """

    policy: Policy
    modules: dict[str, nn.Module]
    optimizers: dict[str, torch.optim.Adam]

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name."""
        groups: dict[str, Mapping[str, Tensor]] = {}
        groups |= {name: module.state_dict() for name, module in self.modules.items()}
        for name, optimizer in self.optimizers.items():  # nothing before its first step
            states = optimizer.state_dict()["state"].items()
            groups[name] = {f"{n}.{key}": t for n, state in states for key, t in state.items()}
        return {f"{name}.{key}": t for name, group in groups.items() for key, t in group.items()}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        self.policy.load_state_dict(with_prefix("policy", named))
        for name, module in self.modules.items():
            module.load_state_dict(with_prefix(name, named))
        for name, optimizer in self.optimizers.items():
            state: dict[int, dict[str, Tensor]] = {}
            for place, value in with_prefix(name, named).items():
                index, key = place.split(".")
                state.setdefault(int(index), {})[key] = value
            optimizer.load_state_dict({**optimizer.state_dict(), "state": state})


def with_prefix(prefix: str, named: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the tensors whose names start with the prefix and a dot, with these removed."""
    start = f"{prefix}."
    return {name[len(start) :]: t for name, t in named.items() if name.startswith(start)}


def adam(module: nn.Module, learning_rate: float) -> torch.optim.Adam:
    """Return Adam for a module's parameters (Kingma and Ba 2015)."""
    parameters = list(module.parameters())
    # the fused implementation is four times as fast as the others on one core
    captured = parameters[0].is_cuda  # its steps may become part of a CUDA graph
    return torch.optim.Adam(parameters, lr=learning_rate, fused=True, capturable=captured)


def set_rate(optimizer: torch.optim.Adam, learning_rate: float) -> None:
    """Set the learning rate of all parameters."""
    for group in optimizer.param_groups:
        group["lr"] = learning_rate


def descend(
    optimizer: torch.optim.Adam, module: nn.Module, loss: Tensor, gradient_norm: float
) -> None:
    """Take one gradient step of a module, with a limit on the gradient's norm."""
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(module.parameters(), gradient_norm)
    optimizer.step()


class Critic(nn.Module):
    """A multilayer perceptron that estimates the discounted return of its input."""

    def __init__(self, size: int, hidden: Sequence[int]) -> None:
        super().__init__()
        widths = (size, *hidden)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(widths))
        self.value = nn.Linear(widths[-1], 1)

    def forward(self, inputs: Tensor) -> Tensor:
        """Return estimates (B,) for inputs (B, size)."""
        for layer in self.layers:
            inputs = torch.relu(layer(inputs))
        return full_precision(self.value, inputs).squeeze(-1)
