"""Networks that serve several parts of a body: copies with the same weights, and their matrices.

A copy reads some observations, those of another part in its place or with the other sign, and sets
actions of its own part. All copies together are one network, whose matrices consist of blocks:

    W[i_kr, j_kc] = sign_kc w[r, c]        of copy k

Weights w are learned and pruned once, and count their operations in every copy. Biases, decay
factors and thresholds belong to neurons and are not shared: parts need not be mounted alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from spikedeploy.trainers.policies.policy import PrunedWeight


@dataclass(frozen=True)
class Copies:
    """Which observations and actions K copies of a network have.

    inputs: (K, F) observations that each copy reads
    signs: (K, F) 1, or -1 where a copy reads the opposite
    outputs: (K, n) actions that each copy sets
    """

    inputs: Sequence[Sequence[int]]
    signs: Sequence[Sequence[int]]
    outputs: Sequence[Sequence[int]]

    def spec(self) -> dict[str, Any]:
        """Return the arguments that rebuild these copies, for JSON."""
        return asdict(self)

    @property
    def count(self) -> int:
        """Number K of copies."""
        return len(self.inputs)

    @cached_property
    def columns(self) -> Tensor:
        """`inputs` as a tensor (K, F)."""
        return torch.tensor(self.inputs)

    @cached_property
    def factors(self) -> Tensor:
        """`signs` as a tensor (K, F) of floats."""
        return torch.tensor(self.signs, dtype=torch.float32)

    def neurons(self, width: int) -> Tensor:
        """Return indices (K, n) of a layer of so many neurons, of which each copy has a part."""
        return torch.arange(width).view(self.count, -1)

    def means(self, values: Tensor, signed: bool = False) -> Tensor:
        """Return values (obs,), those that copies read in the same place replaced by their mean.

        signed: whether the value of an opposite is the opposite value
        """
        factors = (self.factors if signed else torch.ones_like(self.factors)).to(values.dtype)
        found = values.clone()
        found[self.columns] = (values[self.columns] * factors).mean(0) * factors
        return found


class SharedWeight(PrunedWeight):
    """Weights (n, m) of a block, shared by K blocks of a matrix (N, M).

    rows, columns: (K, n) and (K, m) places of each block; a neuron is in one block
    factors: (K, m) of its columns, 1 or -1; None where all are 1
    """

    def __init__(
        self, weight: Tensor, shape: tuple[int, int], rows: Tensor, columns: Tensor,
        factors: Tensor | None = None,
    ) -> None:  # fmt: skip
        super().__init__(weight)
        self._shape, self._columns = shape, columns
        self._factors = torch.ones(columns.shape) if factors is None else factors
        self._places = rows[:, :, None], columns[:, None, :]
        # most layers have their blocks one behind the other
        self._gathers = not _in_order(columns, shape[1])
        self._sorting = None if _in_order(rows, shape[0]) else rows.flatten().argsort()

    def read(self, inputs: Tensor) -> Tensor:
        """Return what each of the K copies reads (..., K, m) of inputs (..., M)."""
        if self._gathers:
            inputs = inputs[..., self._columns.flatten()] * self._factors.flatten()
        return inputs.reshape(*inputs.shape[:-1], *self._columns.shape)

    def drive(self, inputs: Tensor, weight: Tensor) -> Tensor:
        """Return what inputs (..., M) bring to each neuron (..., N) through such weights."""
        read = self.read(inputs).reshape(-1, weight.shape[1])
        brought = (read @ weight.T).view(*inputs.shape[:-1], self._shape[0])
        return brought if self._sorting is None else brought[..., self._sorting]

    def whole(self) -> Tensor:
        """Return the matrix (N, M), zero where no block is or a synapse was taken out."""
        return self._spread(self() * self._factors[:, None, :])

    @property
    def whole_mask(self) -> Tensor:
        """(N, M) 1 where a synapse is left."""
        return self._spread(self.mask.expand(len(self._columns), *self.mask.shape))

    @property
    def fan_out(self) -> Tensor:
        """Synapses (M,) that are left of each presynaptic neuron."""
        each = self.mask.sum(0).repeat(len(self._columns))
        return each.new_zeros(self._shape[1]).index_add(0, self._columns.flatten(), each)

    def _spread(self, blocks: Tensor) -> Tensor:
        """Return blocks (K, n, m) in their places (N, M), zeros elsewhere."""
        return blocks.new_zeros(self._shape).index_put(self._places, blocks)

    def block(self, matrix: Tensor) -> Tensor:
        """Return the block (n, m) of which a matrix (N, M) consists; zeros are no part of it."""
        blocks = matrix[self._places] * self._factors[:, None, :]
        largest = blocks.abs().argmax(0, keepdim=True)
        return blocks.gather(0, largest)[0]

    def uses(self, rate: Tensor) -> Tensor:
        """Return operations of each weight (n, m), in all blocks together."""
        return rate[self._columns].sum(0).expand_as(self.mask)


Draw = Callable[[int, int], Tensor]  # initial weights (n, m)


def he_normal(n: int, m: int) -> Tensor:
    """Return initial weights (n, m) in front of ReLUs (He et al. 2015)."""
    weight: Tensor = torch.randn(n, m) * (2 / m) ** 0.5
    return weight


def weights_between(
    copies: Copies | None, widths: tuple[int, int], draw: Draw, reads: bool = False,
    acts: bool = False,
) -> PrunedWeight:  # fmt: skip
    """Return weights between layers of `widths` (M, N) neurons, shared where there are copies.

    reads, acts: whether the layers are the observations, and the actions
    """
    before, after = widths
    if copies is None or not before:
        return PrunedWeight(draw(after, before))
    rows = torch.tensor(copies.outputs) if acts else copies.neurons(after)
    columns = copies.columns if reads else copies.neurons(before)
    weight = draw(rows.shape[1], columns.shape[1])
    factors = copies.factors if reads else None
    return SharedWeight(weight, (after, before), rows, columns, factors)


def _in_order(places: Tensor, count: int) -> bool:
    """Return whether blocks hold neurons 0 to `count`, one after the other."""
    return places.numel() == count and bool((places.flatten() == torch.arange(count)).all())
