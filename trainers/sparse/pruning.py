"""Pruning by operations: one ranking over all synapses of a policy."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from spikedeploy.trainers.policies.policy import PrunedWeight, SynapseGroup

_TINY = 1e-12


def operations(synapses: Sequence[SynapseGroup]) -> float:
    """Mean number of operations in a control step, over all synapses."""
    return float(sum(float(each.operations) for each in synapses))


@torch.no_grad()
def prune(
    synapses: Sequence[SynapseGroup], squares: Mapping[PrunedWeight, Tensor], target: float
) -> int:
    """Take out the synapses that matter least for each operation; return how many.

    squares: Adam's second moment of each weight

    A synapse is worth w^2 sqrt(v) / rate: what the loss would gain by it, about (LeCun et al.
    1989, with Adam's v for the curvature), over the operations that it takes.
    """
    excess = operations(synapses) - target
    if excess <= 0:
        return 0
    worths = [
        torch.where(each.matrix.mask > 0, _saliency(each, squares) / (each.uses + 1e-4), torch.inf)
        for each in synapses
    ]
    worth = torch.cat([each.flatten() for each in worths])
    rates = torch.cat([each.uses.flatten() for each in synapses])
    order = worth.argsort()
    count = int((rates[order].cumsum(0) < excess).sum()) + 1
    count = min(count, int(torch.isfinite(worth).sum()))
    drop = torch.zeros_like(worth)
    drop[order[:count]] = 1.0
    parts = torch.split(drop, [each.matrix.mask.numel() for each in synapses])
    for each, part in zip(synapses, parts, strict=True):
        each.matrix.mask[part.view_as(each.matrix.mask) > 0] = 0.0
    return count


def _saliency(synapses: SynapseGroup, squares: Mapping[PrunedWeight, Tensor]) -> Tensor:
    """Return what the loss would gain by each synapse (N, M), about; 0 where it is out."""
    matrix = synapses.matrix
    return matrix.weight.square() * (squares[matrix].sqrt() + _TINY) * matrix.mask


@torch.no_grad()
def clear_idle(into: SynapseGroup, out: SynapseGroup) -> None:
    """Take out the synapses onto hidden neurons from which none leads."""
    into.matrix.mask[~out.matrix.mask.any(0)] = 0.0
