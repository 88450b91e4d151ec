"""From spikes to the sum of weights that arrives, in three ways.

Which way is fastest depends on how many spikes there are and where; a fixed rule on their density
chooses. All ways sum whole numbers that their number type is proven to hold exactly, so they agree
bit for bit, in any order of summation and on any BLAS. (`ideal` has no whole numbers and always
multiplies in float64, timesteps and batch in one matrix.)
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.families.cuba_numpy.raster import Raster, Scratch, aligned, as_aligned

Floats = NDArray[Any]
Weights = NDArray[Any]

# largest magnitudes up to which every whole number is held
EXACT_FLOAT32 = 1 << 24
EXACT_INT16 = (1 << 15) - 1

# the rule, from the measurements in docs/performance.md: at batch 1, matrices of at least so many
# weights are not multiplied whole, but
SMALL = 1 << 15
# only the rows of axons that spike in the window, while those are no larger a part of all,
FEW = 0.4
# or rows are added one by one, in matrices of at least so many weights, while such an axon spikes
# no more often in the mean
LARGE, _SELDOM = 1 << 17, 2.5


class _Sum(Protocol):
    """What turns spikes into sums of weights, those of an axon that always spikes included."""

    def __call__(self, raster: Raster) -> None:
        """Write the sums, in state units, where they are wanted."""


def summing(
    weight: Weights, bias: Weights, partial: int | None, unit: int, out: Floats, scratch: Scratch
) -> _Sum:
    """The exact way for a layer, or the choice among them.

    weight: (M, N).
    bias: (N,) weights of the axon that always spikes; (T, 1, N) where it does not always.
    partial: largest magnitude of any partial sum; None where weights are no whole numbers.
    unit: state units per weight unit.
    out: (T, B, N) where the sums are wanted.
    scratch: for as many float64 as there are weights.
    """
    exact32 = partial is not None and partial * unit < EXACT_FLOAT32
    dtype = np.float32 if exact32 else np.float64
    scaled, pull = as_aligned(weight * float(unit), dtype), (bias * float(unit)).astype(dtype)
    dense = Matmul(scaled, pull, out)
    if partial is None or out.shape[1] > 1 or weight.size < SMALL:
        return dense
    large = weight.size >= LARGE
    gather = gathering(weight, bias, partial, unit, out, scratch) if large else None
    return AutoSum(gather, ActiveRows(scaled, pull, out, scratch), dense)


def gathering(
    weight: Weights, bias: Weights, partial: int, unit: int, out: Floats, scratch: Scratch
) -> "SparseSum":
    """Gather with numbers as small as the bounds allow; arguments as in summing."""
    whole = np.int16 if partial <= EXACT_INT16 else np.int32
    return SparseSum(as_aligned(weight, whole), bias.astype(whole), unit, out, scratch)


class Matmul:
    """All axons times all weights: one matrix product for the window."""

    def __init__(self, weight: Weights, bias: Weights, out: Floats) -> None:
        self.weight = weight
        timesteps, batch, neurons = out.shape
        axons = len(weight)
        # matrices over the same memory: BLAS wants two axes
        self._spikes = aligned((timesteps, batch, axons), weight.dtype)
        self._flat = self._spikes.reshape(-1, axons)
        self._out = out.reshape(-1, neurons)
        self._sums = _product(self._out, weight)
        self._bias = _filled(self._sums, bias)

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        np.copyto(self._spikes, raster.rows)
        self._flat.dot(self.weight, self._sums)
        if self._bias is not None:
            np.add(self._sums, self._bias, self._sums)
        if self._sums is not self._out:
            np.copyto(self._out, self._sums)


class SparseSum:
    """Only the weights of axons that spiked, timestep by timestep; batch 1.

    Cost grows with the number of spikes; with int16 it has the fewest bytes to fetch.
    """

    def __init__(
        self, weight: Weights, bias: Weights, unit: int, out: Floats, scratch: Scratch
    ) -> None:
        self.weight = weight
        self._out = out
        self._unit = out.dtype.type(unit)
        self._sums = aligned(out.shape, weight.dtype)
        self._bias = _filled(self._sums, bias)
        self._rows = list(self._sums.squeeze(1))
        self._fetched = scratch.like(weight)

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        take, add, fetched = self.weight.take, np.add.reduce, self._fetched
        for spikes, row in zip(raster.bits.squeeze(1), self._rows, strict=True):
            axons = spikes.nonzero()[0]
            # "clip" never has anything to clip here, and needs no second buffer
            add(take(axons, 0, fetched[: len(axons)], "clip"), 0, None, row)
        if self._bias is not None:
            np.add(self._sums, self._bias, self._sums)
        np.multiply(self._sums, self._unit, self._out)


class ActiveRows:
    """Only the weights of axons that spiked at least once, in one small product; batch 1.

    Best where the same axons spike again and again, as those of a population code do.
    """

    def __init__(self, weight: Weights, bias: Weights, out: Floats, scratch: Scratch) -> None:
        self.weight = weight
        # (T, N)
        self._out = out.squeeze(1)
        self._sums = _product(self._out, weight)
        self._bias = _filled(self._sums, bias)
        self._fetched = scratch.like(weight)

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        weight, axons = self.weight, raster.axons()
        spikes = raster.rows.squeeze(1).take(axons, 1).astype(weight.dtype)
        spikes.dot(weight.take(axons, 0, self._fetched[: len(axons)], "clip"), self._sums)
        if self._bias is not None:
            np.add(self._sums, self._bias, self._sums)
        if self._sums is not self._out:
            np.copyto(self._out, self._sums)


class AutoSum:
    """Takes the way that the density of the spikes asks for; batch 1.

    gather: only where the matrix is large.
    """

    def __init__(self, gather: SparseSum | None, union: ActiveRows, dense: Matmul) -> None:
        self.gather, self.union, self.dense = gather, union, dense
        self._few = FEW * len(dense.weight)

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        axons = len(raster.axons())
        if axons <= self._few:
            self.union(raster)
        elif self.gather is not None and raster.spikes() <= _SELDOM * axons:
            self.gather(raster)
        else:
            self.dense(raster)


def _product(out: Floats, weight: Weights) -> Weights:
    """Where a product goes: to the place itself if its number type is that of the weights."""
    return out if out.dtype == weight.dtype else aligned(out.shape, weight.dtype)


def _filled(like: Weights, bias: Weights) -> Weights | None:
    """The bias on every row: arrays of one shape are added in half the time; None adds nothing."""
    if not bias.any():
        return None
    if bias.ndim > 1:  # of each timestep its own, for all of the batch
        copies = like.size // bias.size
        bias = np.broadcast_to(bias, (len(bias), copies, bias.shape[-1])).reshape(like.shape)
    return np.broadcast_to(bias, like.shape).astype(like.dtype)
