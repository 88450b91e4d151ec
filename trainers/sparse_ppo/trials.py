"""Walks that explored, cut into windows with advantages: what PPO learns from."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from spikedeploy.trainers.ppo.batch import advantages
from spikedeploy.trainers.sparse.collect import Earned
from spikedeploy.trainers.sparse.pool import Walk, WalkPool, Windows


@dataclass(frozen=True)
class Trials:
    """Windows of walks, n of them, with L control steps each behind the burn-in.

    windows: observations and labels, the burn-in included
    drawn: (n, L, act) or (n, L) actions as drawn
    advantage: (n, L)
    counts: (n, L) whether the step is part of the walk, and not behind its end
    before: (n, L) log-probability of what was drawn, by the policy that is learned from
    """

    windows: Windows
    drawn: Tensor
    advantage: Tensor
    counts: Tensor
    before: Tensor

    def __len__(self) -> int:
        return len(self.drawn)

    def minibatches(self, size: int) -> Iterator["Trials"]:
        """Yield all windows once, shuffled, in minibatches of about `size`."""
        for chosen in torch.randperm(len(self)).tensor_split(max(1, round(len(self) / size))):
            w = self.windows
            yield Trials(
                Windows(w.seen[chosen], w.moved[chosen], w.label[chosen], w.begins[chosen]),
                self.drawn[chosen],
                self.advantage[chosen],
                self.counts[chosen],
                self.before[chosen],
            )


@dataclass(frozen=True)
class Tiles:
    """Windows that cover every control step of W walks once behind their burn-in.

    windows: of all walks, one walk after another
    at, row: (n, L) and (n, 1) control step and walk of each step behind the burn-in
    counts: (n, L) whether the step is part of the walk
    """

    windows: Windows
    at: Tensor
    row: Tensor
    counts: Tensor

    def of(self, steps: Tensor) -> Tensor:
        """Return an array (S, W, ...) of all walks as (n, L, ...)."""
        return steps[self.at, self.row]


def tiles(pool: WalkPool, window: int, burn_in: int) -> Tiles:
    """Return the windows of a pool whose walks are encoded."""
    stride = window - burn_in
    lengths = [len(walk.label) for walk in pool.walks]
    begins = [np.arange(0, length, stride) for length in lengths]
    which = np.repeat(np.arange(len(lengths)), [len(each) for each in begins])
    first = np.concatenate(begins)
    steps = first[:, None] + np.arange(stride)
    return Tiles(
        pool.windows(which, first - burn_in, window, burn_in),
        torch.from_numpy(np.minimum(steps, max(lengths) - 1)),
        torch.from_numpy(which)[:, None],
        torch.from_numpy(steps < np.array(lengths)[which][:, None]),
    )


@dataclass(frozen=True)
class Course:
    """W walks as arrays, filled with zeros behind their ends.

    reward: (S, W)
    terminated, ended: (S, W) whether the episode ended in a terminal state; whether it ended
    lengths: (W,)
    """

    reward: Tensor
    terminated: Tensor
    ended: Tensor
    lengths: Tensor

    @classmethod
    def of(cls, earned: Sequence[Earned]) -> "Course":
        """Return what walks earned."""
        reward = pad_sequence([torch.from_numpy(each.reward) for each in earned])
        lengths = torch.tensor([len(each.reward) for each in earned])
        last = torch.arange(len(reward))[:, None] == lengths - 1
        stopped = torch.tensor([each.terminated for each in earned])
        return cls(reward, last & stopped, last, lengths)

    @property
    def counts(self) -> Tensor:
        """Whether a step is part of the walk (S, W)."""
        return torch.arange(len(self.reward))[:, None] < self.lengths

    def advantages(self, values: Sequence[Tensor], gamma: float, trace: float) -> Tensor:
        """Return advantages (S, W) for values (S_k + 1,) of each walk, that of its end included."""
        value = pad_sequence([each[:-1] for each in values])
        following = pad_sequence([each[1:] for each in values])
        return advantages(self.reward, value, following, self.terminated, self.ended, gamma, trace)


def states(walks: Sequence[Walk], earned: Sequence[Earned]) -> list[Tensor]:
    """Return raw observations (S + 1, obs) of each walk, that after its last step included."""
    return [
        torch.from_numpy(np.concatenate([walk.observation, each.final[None]]))
        for walk, each in zip(walks, earned, strict=True)
    ]
