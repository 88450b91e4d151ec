"""Data of DAgger: states that teacher and student visit, labelled with the teacher's actions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.trainers.distill.config import DistillConfig
from spikedeploy.trainers.distill.teacher import FloatArray, Teacher
from spikedeploy.trainers.env_batch import EnvBatch


class DaggerDataset:
    """A growing set of labelled states, in float32.

    observation: (n, obs) raw
    action: (n, act) of the teacher, or its logits
    """

    def __init__(self, observations: int, actions: int) -> None:
        self.observation = torch.zeros(0, observations)
        self.action = torch.zeros(0, actions)

    def __len__(self) -> int:
        return len(self.observation)

    def add(self, observation: NDArray[np.float64], action: NDArray[np.float64]) -> None:
        """Add states (B, obs) with their labels (B, act)."""
        self.observation = torch.cat([self.observation, torch.from_numpy(observation).float()])
        self.action = torch.cat([self.action, torch.from_numpy(action).float()])

    def sample(self, count: int, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return states and labels drawn uniformly with replacement."""
        rows = torch.from_numpy(rng.integers(len(self), size=count))
        return self.observation[rows], self.action[rows]

    def tensors(self) -> dict[str, Tensor]:
        """Return everything by name, for a checkpoint."""
        # "lessons" is the dataset's name in the checkpoints of all versions
        return {"lessons.observation": self.observation, "lessons.action": self.action}

    def load(self, tensors: Mapping[str, Tensor]) -> None:
        """Restore the dataset of a checkpoint."""
        self.observation = tensors["lessons.observation"]
        self.action = tensors["lessons.action"]


@dataclass(frozen=True)
class _Collected:
    """Labelled states of one iteration.

    observation: (n, obs) of every state
    label: (n, act) the teacher's action in it, or its logits
    returns: of the episodes that ended
    """

    observation: FloatArray
    label: FloatArray
    returns: list[float]


def iteration_envs(config: DistillConfig, iteration: int) -> EnvBatch:
    """Return the environments of an iteration, the same ones for a run resumed there."""
    return EnvBatch(config.env, np.random.default_rng((config.seed, iteration)))


def collect(
    config: DistillConfig,
    iteration: int,
    teacher: Teacher,
    student: Teacher,
    stopped: Callable[[], bool],
) -> _Collected | None:
    """Collect the labelled states of an iteration; None if stopped before its end."""
    envs = iteration_envs(config, iteration)
    visited: list[FloatArray] = []
    labels: list[FloatArray] = []
    rng = np.random.default_rng((config.seed, iteration, 1))
    share = config.mixing**iteration  # of the teacher's actions; 1 in iteration 0
    while len(visited) * len(envs) < config.states:
        if stopped():
            return None
        visited.append(envs.observation)
        labels.append(teacher.act_all(envs.observation))
        taught = rng.random(len(envs)) < share
        action = labels[-1] if taught.all() else student.act_all(envs.observation)
        action = np.where(taught[:, None], labels[-1], action)
        envs.step(_executed(action, envs.head == "discrete", config.noise, rng))
    return _Collected(np.concatenate(visited), np.concatenate(labels), envs.returns)


def _executed(
    action: FloatArray, discrete: bool, noise: float, rng: np.random.Generator
) -> NDArray[Any]:
    """Return actions (B, act) with noise, or the choices (B,) of logits, some of them drawn."""
    if not discrete:
        return np.clip(action + noise * rng.standard_normal(action.shape), -1.0, 1.0)
    drawn = rng.integers(action.shape[1], size=len(action))
    return np.where(rng.random(len(action)) < noise, drawn, action.argmax(-1))
