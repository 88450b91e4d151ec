"""Lessons: states that were visited, and what the teacher would do in each."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


class DaggerDataset:
    """A growing set of labelled states, in float32.

    observation: (n, obs) raw
    action: (n, act) of the teacher
    """

    def __init__(self, observations: int, actions: int) -> None:
        self.observation = torch.zeros(0, observations)
        self.action = torch.zeros(0, actions)

    def __len__(self) -> int:
        return len(self.observation)

    def add(self, observation: NDArray[np.float64], action: NDArray[np.float64]) -> None:
        """Take in states (B, obs) with their labels (B, act)."""
        self.observation = torch.cat([self.observation, torch.from_numpy(observation).float()])
        self.action = torch.cat([self.action, torch.from_numpy(action).float()])

    def sample(self, count: int, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return states and labels drawn uniformly with replacement."""
        rows = torch.from_numpy(rng.integers(len(self), size=count))
        return self.observation[rows], self.action[rows]

    def tensors(self) -> dict[str, Tensor]:
        """Return everything by name, for a checkpoint."""
        return {"lessons.observation": self.observation, "lessons.action": self.action}

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Take over the lessons of a checkpoint."""
        self.observation = tensors["lessons.observation"]
        self.action = tensors["lessons.action"]
