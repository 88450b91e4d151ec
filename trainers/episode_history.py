"""What brought an environment where it is: the seed of its reset, and every action since.

Physics engines keep what they do not show (MuJoCo its warm start, pymunk its contacts), and other
people's environments cannot be saved at all. All that are deterministic can be brought back by
taking the actions of the episode again, which needs at most one episode's steps.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


class Watcher(Protocol):
    """Who keeps sums or records of the episodes under way."""

    def episode_begun(self, k: int) -> None:
        """Forget what copy k did: its episode begins."""

    def step_repeated(
        self, k: int, action: NDArray[Any], reward: float, info: Mapping[str, Any]
    ) -> None:
        """Take a step of copy k into account that was taken before."""


class EpisodeHistory:
    """The episode under way of one copy.

    seed: of its reset
    actions: (S, ...) as the environment took them
    support: (S + 1,) support force at the reset and at each step; nan where it was never set
    """

    def __init__(self, seed: int, support: float) -> None:
        self.seed = seed
        self.actions: list[NDArray[Any]] = []
        self.support = [support]

    def add(self, action: NDArray[Any], support: float) -> None:
        """Add a step."""
        self.actions.append(np.array(action)[()])  # a choice stays a number
        self.support.append(support)

    def tensors(self) -> dict[str, Tensor]:
        """Return actions and support forces by name, for a checkpoint."""
        support = {"support": torch.tensor(self.support, dtype=torch.float64)}
        if not self.actions:
            return support
        return {**support, "actions": torch.from_numpy(np.stack(self.actions))}

    @classmethod
    def restored(cls, seed: int, named: Mapping[str, Tensor]) -> "EpisodeHistory":
        """Return what `tensors` returned."""
        support: list[float] = named["support"].tolist()
        history = cls(seed, support[0])
        actions = named["actions"].numpy() if "actions" in named else ()
        for action, force in zip(actions, support[1:], strict=True):
            history.add(action, force)
        return history
