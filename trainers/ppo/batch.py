"""Batches of PPO: the newest steps of all copies, and their advantages."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Transition:
    """One step of all B copies.

    encoded: (B, ...) encoding of the observation, see `Policy.sample_encoding`
    observation, following: (B, obs) before and after the step
    drawn: (B,) or (B, act) action as drawn by `ppo.heads`
    log_probability, reward: (B,)
    terminated: (B,) whether the episode ended in a terminal state
    ended: (B,) whether it ended, by a terminal state or the time limit
    """

    encoded: Tensor
    observation: Tensor
    following: Tensor
    drawn: Tensor
    log_probability: Tensor
    reward: Tensor
    terminated: Tensor
    ended: Tensor


@dataclass(frozen=True)
class RolloutBatch:
    """Steps in any order, N of them.

    advantage: (N,) of the action over the critic's value
    target: (N,) return that the critic learns
    """

    encoded: Tensor
    observation: Tensor
    drawn: Tensor
    log_probability: Tensor
    advantage: Tensor
    target: Tensor

    def __len__(self) -> int:
        return len(self.advantage)

    def minibatches(self, size: int) -> Iterator["RolloutBatch"]:
        """Yield all steps once, shuffled, in minibatches of at least `size`."""
        order = torch.randperm(len(self))
        count = max(1, len(self) // size)
        for chosen in order.tensor_split(count):
            yield RolloutBatch(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def advantages(
    reward: Tensor,
    value: Tensor,
    following: Tensor,
    terminated: Tensor,
    ended: Tensor,
    gamma: float,
    trace: float,
) -> Tensor:
    """Return generalised advantages (K, B) of K steps of B copies (Schulman et al. 2016).

    value, following: (K, B) the critic's values before and after each step

    Only `terminated` sets the value after a step to zero, so that truncated episodes are
    bootstrapped; `ended` stops the sum at the end of an episode.
    """
    # delta = r + gamma V' (1 - terminated) - V ; A = delta + gamma trace (1 - ended) A'
    delta = reward + gamma * following * ~terminated - value
    decay = gamma * trace * ~ended
    result = torch.empty_like(delta)
    later = torch.zeros_like(delta[0])
    for k in reversed(range(len(delta))):
        later = delta[k] + decay[k] * later
        result[k] = later
    return result


def stacked(transitions: list[Transition]) -> Transition:
    """Return K transitions as one, with arrays (K, B, ...)."""
    names = Transition.__dataclass_fields__
    return Transition(
        *(torch.stack([getattr(step, name) for step in transitions]) for name in names)
    )
