"""Observation normalisation: the module of a policy, and running statistics."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

_SMALLEST_STD = 0.01  # observations are of order one; a constant one must not be amplified


class TorchNormaliser(nn.Module):
    """Shifts, scales and clips observations; part of every policy.

    mean, std: (obs,) [observation]
    clip: limit on both sides [standard deviations]
    """

    mean: Tensor
    std: Tensor

    def __init__(self, size: int, clip: float = 4.0) -> None:
        super().__init__()
        self.clip = clip
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def forward(self, observation: Tensor) -> Tensor:
        """Return normalised and clipped observations (B, obs)."""
        # x = clip((obs - mean) / std)
        return ((observation - self.mean) / self.std).clamp_(-self.clip, self.clip)

    def adopt(self, moments: "Moments") -> None:
        """Use the mean and standard deviation of these statistics."""
        for buffer, found in ((self.mean, moments.mean), (self.std, moments.std)):
            buffer.copy_(torch.from_numpy(found).float(), non_blocking=True)  # also to a GPU


@dataclass
class Moments:
    """Running mean and variance in float64 (Chan et al. 1979).

    mean, square: (obs,) mean, and sum of squared deviations
    count: number of observations added
    """

    mean: NDArray[np.float64]
    square: NDArray[np.float64]
    count: int = 0

    @classmethod
    def empty(cls, size: int) -> "Moments":
        """Return the moments of no observations."""
        return cls(np.zeros(size), np.zeros(size))

    @classmethod
    def restored(cls, named: Mapping[str, Tensor], count: int) -> "Moments":
        """Return the moments of a checkpoint, from `tensors` and the count."""
        return cls(named["moments.mean"].numpy(), named["moments.square"].numpy(), count)

    def tensors(self) -> dict[str, Tensor]:
        """Return the arrays by name, for a checkpoint."""
        return {
            "moments.mean": torch.from_numpy(self.mean),
            "moments.square": torch.from_numpy(self.square),
        }

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation (obs,), at least SMALLEST_STD; 1 before there are data."""
        if self.count < 2:
            return np.ones_like(self.mean)
        return np.maximum(np.sqrt(self.square / self.count), _SMALLEST_STD)

    def add(self, batch: NDArray[np.float64]) -> None:
        """Add a batch of observations (B, obs)."""
        count, mean = len(batch), batch.mean(0)
        delta, total = mean - self.mean, self.count + count
        # M = M_a + M_b + delta^2 n_a n_b / n
        self.square += ((batch - mean) ** 2).sum(0) + delta**2 * (self.count * count / total)
        self.mean += delta * (count / total)
        self.count = total
