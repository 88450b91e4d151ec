"""Synapses in a hurry: from spikes to the sum of weights that arrives, in three ways.

Which way is fastest depends on how many spikes there are and where. All of them sum whole numbers
that their number type is proven to hold exactly, so they agree bit for bit, in any order of
summation and on any BLAS. (`ideal` has no whole numbers and always multiplies in float64.)
"""

from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from runtime.program import Synapses

# largest magnitudes up to which every whole number is held
EXACT_FLOAT32 = 1 << 24
EXACT_INT16 = (1 << 15) - 1

# up to here a product over all axons costs less than looking for those that spiked
NARROW = 200


class Raster:
    """Spikes of one source in a window, with their counts, which several readers share.

    rows: (T, B, M), uint8 or bool.
    """

    def __init__(self, rows: NDArray[Any]) -> None:
        self.rows = rows

    @cached_property
    def per_axon(self) -> NDArray[Any]:
        """(B, M) spikes of each axon."""
        # eight bits hold the counts of a short window, and are summed several times faster
        counts: NDArray[Any] = np.add.reduce(
            self.rows, 0, np.uint8 if len(self.rows) < 256 else np.int64
        )
        return counts

    @cached_property
    def total(self) -> NDArray[np.int64]:
        """(B,) all spikes."""
        counts: NDArray[np.int64] = np.add.reduce(self.per_axon, 1, np.int64)
        return counts


class Sum(Protocol):
    """What turns spikes into sums of weights."""

    def __call__(self, raster: Raster) -> NDArray[Any]:
        """Sums (T, B, N); the array is used again by the next call."""


def summing(synapses: Synapses, partial: int | None, timesteps: int, batch: int) -> Sum:
    """The fastest exact way.

    partial: largest magnitude of any partial sum; None where weights are no whole numbers.
    """
    dtype = np.float32 if partial is not None and partial < EXACT_FLOAT32 else np.float64
    dense = Dense(synapses.weight, dtype, timesteps, batch)
    if partial is None or batch > 1 or synapses.weight.shape[1] <= NARROW:
        return dense
    whole = np.int16 if partial <= EXACT_INT16 else np.int32
    return Sparse(Gather(synapses.weight, whole, timesteps), Union(dense), dense)


class Dense:
    """All axons times all weights: one matrix product for the window."""

    def __init__(self, weight: NDArray[Any], dtype: DTypeLike, timesteps: int, batch: int) -> None:
        self.weight = np.ascontiguousarray(weight, dtype)
        self.sums = np.empty((timesteps, batch, weight.shape[1]), dtype)
        self._spikes = np.empty((timesteps, batch, weight.shape[0]), dtype)
        # matrices over the same memory: BLAS wants two axes
        self._flat_spikes = self._spikes.reshape(-1, weight.shape[0])
        self._flat_sums = self.sums.reshape(-1, weight.shape[1])

    def __call__(self, raster: Raster) -> NDArray[Any]:
        """Sums (T, B, N)."""
        np.copyto(self._spikes, raster.rows)
        np.matmul(self._flat_spikes, self.weight, self._flat_sums)
        return self.sums


class Gather:
    """Only the weights of axons that spiked, timestep by timestep; batch 1.

    Cost grows with the number of spikes, and int16 halves the bytes that must be fetched.
    """

    def __init__(self, weight: NDArray[Any], dtype: DTypeLike, timesteps: int) -> None:
        self.weight = np.ascontiguousarray(weight, dtype)
        self.sums = np.empty((timesteps, 1, weight.shape[1]), dtype)
        self._rows = list(self.sums[:, 0])

    def __call__(self, raster: Raster) -> NDArray[Any]:
        """Sums (T, 1, N)."""
        take, add = self.weight.take, np.add.reduce
        for spikes, row in zip(raster.rows[:, 0], self._rows, strict=True):
            add(take(spikes.nonzero()[0], 0), 0, None, row)
        return self.sums


class Union:
    """Axons that spiked at least once, in one small matrix product; batch 1.

    Best where the same axons spike again and again, as those of a population code do.
    """

    def __init__(self, dense: Dense) -> None:
        self.weight = dense.weight
        self.sums = dense.sums
        self._rows = dense.sums[:, 0]

    def __call__(self, raster: Raster) -> NDArray[Any]:
        """Sums (T, 1, N)."""
        axons = raster.per_axon[0].nonzero()[0]
        spikes = raster.rows[:, 0].take(axons, 1).astype(self.weight.dtype)
        np.matmul(spikes, self.weight.take(axons, 0), self._rows)
        return self.sums


class Sparse:
    """Looks at the spikes and takes the cheapest way; batch 1."""

    def __init__(self, gather: Gather, union: Union, dense: Dense) -> None:
        self.gather, self.union, self.dense = gather, union, dense

    def __call__(self, raster: Raster) -> NDArray[Any]:
        """Sums (T, 1, N)."""
        spikes = int(raster.total[0])
        axons = int(np.count_nonzero(raster.per_axon))
        # measured: a row of the union costs about a third of a gathered one, its product 50 rows
        if axons < 50 + 0.35 * spikes:
            return self.union(raster)
        # measured: above about half of all axons a product over all of them is cheaper
        if spikes > 0.5 * raster.rows.size:
            return self.dense(raster)
        return self.gather(raster)
