"""Networks that serve several parts of a body: copies with the same weights, and their matrices.

A copy reads some observations, those of another part in its place or with the other sign, and sets
actions of its own part. All copies together are one network, whose matrices consist of blocks:

    W[i_kr, j_kc] = sign_kc w[r, c]        of copy k

Weights w are learned and pruned once, and count their operations in every copy. Biases, decay
factors and thresholds belong to neurons and are not shared: parts need not be mounted alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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
        return {name: [list(row) for row in each] for name, each in vars(self).items()
                if name in ("inputs", "signs", "outputs")}  # fmt: skip

    @property
    def count(self) -> int:
        """Number K of copies."""
        return len(self.inputs)

    @cached_property
    def _columns(self) -> Tensor:
        return torch.tensor(self.inputs)

    @cached_property
    def _signs(self) -> Tensor:
        return torch.tensor(self.signs)

    def neurons(self, width: int) -> Tensor:
        """Return indices (K, n) of a layer of so many neurons, of which each copy has a part."""
        return torch.arange(width).view(self.count, -1)

    def means(self, values: Tensor, signed: bool = False) -> Tensor:
        """Return values (obs,), those that copies read in the same place replaced by their mean.

        signed: whether the value of an opposite is the opposite value
        """
        signs = self._signs.to(values.dtype) if signed else torch.ones_like(self._signs)
        mean = (values[self._columns] * signs).mean(0)
        found = values.clone()
        found[self._columns] = (mean * signs).to(values.dtype)
        return found


class SharedWeight(PrunedWeight):
    """Weights (n, m) of a block, shared by K blocks of a matrix (N, M).

    rows, columns: (K, n) and (K, m) places of each block; a neuron is in one block
    signs: (K, m) of its columns, None where all are 1
    """

    def __init__(
        self, weight: Tensor, shape: tuple[int, int], rows: Tensor, columns: Tensor,
        signs: Tensor | None = None,
    ) -> None:  # fmt: skip
        super().__init__(weight)
        self._shape, self._rows, self._columns = shape, rows, columns
        self._signs = torch.ones_like(columns) if signs is None else signs
        self._places = rows[:, :, None], columns[:, None, :]

    def drive(self, inputs: Tensor, weight: Tensor) -> Tensor:
        """Return what inputs (..., M) bring to each neuron (..., N) through such weights."""
        if not _in_order(self._columns, self._shape[1]):
            inputs = inputs[..., self._columns.flatten()] * self._signs.flatten()
        read = inputs.reshape(-1, weight.shape[1])
        brought = (read @ weight.T).view(*inputs.shape[:-1], self._rows.numel())
        if _in_order(self._rows, self._shape[0]):
            return brought
        return brought[..., self._rows.flatten().argsort()]

    def whole(self) -> Tensor:
        """Return the matrix (N, M), zero where no block is or a synapse was taken out."""
        return self._spread(self() * self._signs[:, None, :])

    @property
    def whole_mask(self) -> Tensor:
        """(N, M) 1 where a synapse is left."""
        return self._spread(self.mask.expand(len(self._rows), *self.mask.shape))

    def _spread(self, blocks: Tensor) -> Tensor:
        """Return blocks (K, n, m) in their places (N, M), zeros elsewhere."""
        return blocks.new_zeros(self._shape).index_put(self._places, blocks)

    def block(self, matrix: Tensor) -> Tensor:
        """Return the block (n, m) of which a matrix (N, M) consists; zeros are no part of it."""
        blocks = matrix[self._places] * self._signs[:, None, :]
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
    columns = torch.tensor(copies.inputs) if reads else copies.neurons(before)
    signs = torch.tensor(copies.signs) if reads else None
    weight = draw(rows.shape[1], columns.shape[1])
    return SharedWeight(weight, (after, before), rows, columns, signs)


def _in_order(places: Tensor, count: int) -> bool:
    """Return whether blocks hold neurons 0 to `count`, one after the other."""
    return places.numel() == count and bool((places.flatten() == torch.arange(count)).all())
