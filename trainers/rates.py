"""Firing rates of spikes (T, B, N): what readouts hear, and what learning may hold down."""

from collections.abc import Iterable

import torch
from torch import Tensor


def mean_over_time(spikes: Tensor) -> Tensor:
    """Return firing rates (B, N) of spikes (T, B, N)."""
    precise = torch.float32 if spikes.dtype == torch.bfloat16 else spikes.dtype
    return spikes.mean(0, dtype=precise)


def mean_rate(spikes: Tensor) -> Tensor:
    """Return the mean firing rate of a layer, a scalar."""
    return spikes.mean(dtype=torch.float32)


def excess(rates: Iterable[Tensor], target: float) -> Tensor:
    """Return by how much layers fire above a rate, summed over them; nothing for no layers."""
    # sum over layers of max(0, rate - target)
    return sum(((rate - target).relu() for rate in rates), start=torch.zeros(()))
