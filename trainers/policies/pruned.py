"""Weights with masks: what pruning takes out stays out."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn


class PrunedWeight(nn.Module):
    """A weight matrix (N, M) and which of its synapses are left.

    weight: (N, M) trained
    mask: (N, M) 1 where a synapse is left, 0 where it was taken out
    """

    mask: Tensor

    def __init__(self, weight: Tensor) -> None:
        super().__init__()
        self.weight = nn.Parameter(weight)
        self.register_buffer("mask", torch.ones_like(weight))

    def forward(self) -> Tensor:
        """Return the weights (N, M), zero where a synapse was taken out."""
        return self.weight * self.mask

    @property
    def fan_out(self) -> Tensor:
        """Synapses (M,) that are left of each presynaptic neuron."""
        return self.mask.sum(0)


@dataclass(frozen=True)
class SynapseGroup:
    """Synapses of one kind, for penalties and pruning.

    matrix: their weights and masks
    rate: (M,) mean number of operations that one synapse of each presynaptic neuron takes in a
        control step: of a spiking neuron its spikes, of an input that is always read 1
    """

    matrix: PrunedWeight
    rate: Tensor

    @property
    def operations(self) -> Tensor:
        """Mean number of operations in a control step, a scalar."""
        # sum_j rate_j fan-out_j
        return (self.rate * self.matrix.fan_out).sum()
