"""What PPO learns from: the newest steps of every copy, and how good their actions were."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Transition:
    """One step of every copy, B of them.

    perceived: (B, ...) what the policy made of the observation, see `Policy.perceive`
    observation, following: (B, obs) before and after the step
    drawn: (B,) or (B, act) as `trainers.heads` drew it
    log_probability, reward: (B,)
    terminated: (B,) whether the episode ended by itself, so that nothing follows
    ended: (B,) whether it ended at all, so that what follows belongs to another one
    """

    perceived: Tensor
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

    advantage: (N,) of the action over what the critic expected
    target: (N,) return that the critic should have expected
    """

    perceived: Tensor
    observation: Tensor
    drawn: Tensor
    log_probability: Tensor
    advantage: Tensor
    target: Tensor

    def __len__(self) -> int:
        return len(self.advantage)

    def minibatches(self, size: int) -> Iterator["RolloutBatch"]:
        """Yield all steps once, shuffled; a remainder joins the last minibatch."""
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

    An episode cut by the clock goes on in the critic's eyes: only `terminated` ends the return,
    while `ended` keeps the sum from running on into the next episode.
    """
    # delta = r + gamma V' (1 - terminated) - V ; A = delta + gamma trace (1 - ended) A'
    delta = reward + gamma * following * ~terminated - value
    kept = gamma * trace * ~ended
    result = torch.empty_like(delta)
    later = torch.zeros_like(delta[0])
    for k in reversed(range(len(delta))):
        later = delta[k] + kept[k] * later
        result[k] = later
    return result


def stacked(moments: list[Transition]) -> Transition:
    """Return the moments as one, with K in front of B."""
    names = Transition.__dataclass_fields__
    return Transition(
        *(torch.stack([getattr(moment, name) for moment in moments]) for name in names)
    )
