"""Replay buffer: a preallocated ring of transitions, one row of memory for each."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file
from torch import Tensor

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.atomic import replacing
from spikedeploy.trainers.checksums import of_file
from spikedeploy.trainers.write_errors import said


@dataclass(frozen=True)
class ReplayBatch:
    """Transitions drawn at random.

    observation, following: (B, obs) raw, before and after the action
    action: (B, act)
    reward: (B,)
    terminated: (B,) 1 at terminal states, 0 where the episode continued or was truncated
    """

    observation: Tensor
    action: Tensor
    reward: Tensor
    terminated: Tensor
    following: Tensor


class ReplayBuffer:
    """The last `capacity` transitions, in float32.

    size: number of transitions held
    """

    def __init__(self, capacity: int, observations: int, actions: int) -> None:
        self.widths = [observations, actions, 1, 1, observations]
        # np.zeros takes no memory until it is written: memory grows with the transitions held
        self.rows = np.zeros((capacity, sum(self.widths)), np.float32)
        self.size = 0
        self.next = 0

    def add(
        self,
        observation: NDArray[np.float64],
        action: NDArray[np.float64],
        reward: NDArray[np.float64],
        terminated: NDArray[np.bool_],
        following: NDArray[np.float64],
    ) -> None:
        """Add transitions, one for each row of the arguments (B, ...)."""
        parts = (observation, action, reward[:, None], terminated[:, None], following)
        count, capacity = len(reward), len(self.rows)
        places = np.arange(self.next, self.next + count) % capacity
        self._store(places, np.concatenate(parts, axis=1))
        self.next = (self.next + count) % capacity
        self.size = min(self.size + count, capacity)

    def _store(self, places: NDArray[np.int64], rows: NDArray[np.float64]) -> None:
        """Put rows (B, all numbers of a transition) in their places (B,)."""
        self.rows[places] = rows

    def sample(self, count: int, rng: np.random.Generator) -> ReplayBatch:
        """Return transitions drawn uniformly with replacement."""
        return self.split(torch.from_numpy(self.rows[rng.integers(self.size, size=count)]))

    def split(self, rows: Tensor) -> ReplayBatch:
        """Return the transitions of rows (B, all numbers of a transition)."""
        observation, action, reward, terminated, following = torch.split(rows, self.widths, dim=1)
        return ReplayBatch(observation, action, reward[:, 0], terminated[:, 0], following)

    def save(self, path: Path) -> str:
        """Write the transitions held, oldest first; return the file's checksum."""
        start = self.next if self.size == len(self.rows) else 0
        held = np.concatenate([self.rows[start : self.size], self.rows[:start]])
        with said(path):
            with replacing(path) as temporary:
                save_file({"rows": held, "next": np.array([self.next])}, temporary)
            return of_file(path)

    def load(self, path: Path) -> None:
        """Load the transitions of a file; if there are too many, the newest."""
        if not path.is_file():
            raise ConfigError(
                f"{path} is missing: resuming a run needs its replay, which a finished run no "
                "longer has. Start a new run with more steps."
            )
        held, place = _read(path)
        if held.shape[1] != self.rows.shape[1]:
            raise ConfigError(
                f"{path} holds transitions of {held.shape[1]} numbers, this task has "
                f"{self.rows.shape[1]}: was it written for another environment?"
            )
        capacity = len(self.rows)
        held = held[-capacity:]
        # in a full ring each transition takes its place again, as updates draw places
        self.next = place % capacity if len(held) == capacity else len(held) % capacity
        first = self.next if len(held) == capacity else 0
        self.rows[first : len(held)] = held[: len(held) - first]
        self.rows[:first] = held[len(held) - first :]
        self.size = len(held)


def _read(path: Path) -> tuple[NDArray[np.float32], int]:
    """Return the rows of a file, and the place of the next one; 0 in files of before."""
    try:
        arrays = load_file(path)
        rows = arrays["rows"]
        if rows.ndim != 2 or rows.dtype != np.float32:
            raise ValueError(f"its rows are {rows.dtype} {rows.shape}")
        return rows, int(arrays["next"][0]) if "next" in arrays else 0
    except (SafetensorError, OSError, KeyError, ValueError) as error:
        raise ConfigError(damaged(path, str(error))) from error


def damaged(path: Path, why: str) -> str:
    """Return what to say of a replay that is damaged."""
    return (
        f"{path} is damaged: {why}. The run cannot go on without it: put it back, or train again; "
        f"its policies are whole: `spikedeploy export {path.parent}`."
    )
