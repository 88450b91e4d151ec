"""Pruning by operations: one ranking over all synapses, and whole neurons as units of it."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from spikedeploy.trainers.policies.pruned import PrunedWeight, SynapseGroup

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
    worth = torch.cat([_worth(each, squares).flatten() for each in synapses])
    rates = torch.cat([each.rate.expand_as(each.matrix.mask).flatten() for each in synapses])
    order = worth.argsort()
    taken = int((rates[order].cumsum(0) < excess).sum()) + 1
    taken = min(taken, int(torch.isfinite(worth).sum()))
    drop = torch.zeros_like(worth)
    drop[order[:taken]] = 1.0
    parts = torch.split(drop, [each.matrix.mask.numel() for each in synapses])
    for each, part in zip(synapses, parts, strict=True):
        each.matrix.mask[part.view_as(each.matrix.mask) > 0] = 0.0
    return taken


def saliency(synapses: SynapseGroup, squares: Mapping[PrunedWeight, Tensor]) -> Tensor:
    """Return what the loss would gain by each synapse (N, M), about; 0 where it is out."""
    matrix = synapses.matrix
    return matrix.weight.square() * (squares[matrix].sqrt() + _TINY) * matrix.mask


def _worth(synapses: SynapseGroup, squares: Mapping[PrunedWeight, Tensor]) -> Tensor:
    worth = saliency(synapses, squares) / (synapses.rate + 1e-4)
    return torch.where(synapses.matrix.mask > 0, worth, torch.inf)


@torch.no_grad()
def remove_neurons(
    into: SynapseGroup,
    out: SynapseGroup,
    squares: Mapping[PrunedWeight, Tensor],
    neuron_cost: float,
    most: int,
) -> int:
    """Remove hidden neurons that are worth less than the average operation; return how many.

    neuron_cost: operations that an update of a neuron counts for
    most: how many to remove at once

    Neurons without synapses on the outgoing side lose those on the other one.
    """
    idle = ~out.matrix.mask.any(0)
    into.matrix.mask[idle] = 0.0
    cost = into.matrix.mask @ into.rate + out.rate * out.matrix.fan_out + neuron_cost
    gain = saliency(into, squares).sum(1) + saliency(out, squares).sum(0)
    live = ~idle
    if not neuron_cost or int(live.sum()) < 2:
        return 0
    # less than a tenth of what the others bring for the same operations
    share = gain / cost
    weak = live & (share < 0.1 * gain[live].sum() / cost[live].sum())
    chosen = torch.where(weak, share, torch.inf).argsort()[:most]
    chosen = chosen[weak[chosen]]
    into.matrix.mask[chosen] = 0.0
    out.matrix.mask[:, chosen] = 0.0
    return len(chosen)
