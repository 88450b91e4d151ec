"""Synapses in a hurry: from spikes to the sum of weights that arrives, in three ways.

Which way is fastest depends on how many spikes there are and where, and on the machine: what each
costs is measured when a network is loaded. All of them sum whole numbers that their number type is
proven to hold exactly, so they agree bit for bit, in any order of summation and on any BLAS.
(`ideal` has no whole numbers and always multiplies in float64.)
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.emulator.raster import Raster, Scratch, aligned, as_aligned
from spikedeploy.runtime.families.cuba_numpy.ways import SumCosts, measured

Floats = NDArray[Any]
Weights = NDArray[Any]

# largest magnitudes up to which every whole number is held
EXACT_FLOAT32 = 1 << 24
EXACT_INT16 = (1 << 15) - 1


class Sum(Protocol):
    """What turns spikes into sums of weights, those of an axon that always spikes included."""

    def __call__(self, raster: Raster) -> None:
        """Write the sums, in state units, where they are wanted."""


def summing(
    weight: Weights, bias: Weights, partial: int | None, unit: int, out: Floats, scratch: Scratch
) -> Sum:
    """The fastest exact way.

    weight: (M, N).
    bias: (N,) weights of the axon that always spikes.
    partial: largest magnitude of any partial sum; None where weights are no whole numbers.
    unit: state units per weight unit.
    out: (T, B, N) where the sums are wanted, float32 or float64.
    scratch: for as many float64 as there are weights.
    """
    exact32 = partial is not None and partial * unit < EXACT_FLOAT32
    dtype = np.float32 if exact32 else np.float64
    scaled, pull = as_aligned(weight * float(unit), dtype), (bias * float(unit)).astype(dtype)
    dense = Matmul(scaled, pull, out)
    if partial is None:
        return dense
    union = ActiveRows(scaled, pull, out, scratch)
    one = out.shape[1] == 1
    gather = gathering(weight, bias, partial, unit, out, scratch) if one else None
    cheapest = AutoSum(gather, union, dense, _costs(gather, union, dense))
    return cheapest if cheapest.has_choice else dense


def gathering(
    weight: Weights, bias: Weights, partial: int, unit: int, out: Floats, scratch: Scratch
) -> "SparseSum":
    """Gather with numbers as small as the bounds allow; arguments as in summing."""
    whole = np.int16 if partial <= EXACT_INT16 else np.int32
    return SparseSum(as_aligned(weight, whole), bias.astype(whole), unit, out, scratch)


class Matmul:
    """All axons times all weights: one matrix product for the window.

    shape: T, B, M and N.
    """

    def __init__(self, weight: Weights, bias: Weights, out: Floats) -> None:
        self.weight = weight
        timesteps, batch, neurons = out.shape
        axons = len(weight)
        self.shape = (timesteps, batch, axons, neurons)
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
        self._rows = list(self._sums[:, 0])
        self._fetched = scratch.like(weight)

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        take, add, fetched = self.weight.take, np.add.reduce, self._fetched
        for spikes, row in zip(raster.bits[:, 0], self._rows, strict=True):
            axons = spikes.nonzero()[0]
            # "clip" never has anything to clip here, and needs no second buffer
            add(take(axons, 0, fetched[: len(axons)], "clip"), 0, None, row)
        if self._bias is not None:
            np.add(self._sums, self._bias, self._sums)
        np.multiply(self._sums, self._unit, self._out)


class ActiveRows:
    """Axons that spiked at least once, in one small matrix product for each of the batch.

    Best where the same axons spike again and again, as those of a population code do.
    """

    def __init__(self, weight: Weights, bias: Weights, out: Floats, scratch: Scratch) -> None:
        self.weight, self.bias, self.scratch = weight, bias, scratch
        # (B, T, N)
        self._out = out.swapaxes(0, 1)
        one = len(self._out) == 1
        self._sums = aligned(self._out.shape, weight.dtype)
        if one and out.dtype == weight.dtype:
            self._sums = self._out
        self._bias = _filled(self._sums, bias)
        self._each = list(self._sums)
        self._fetched = scratch.like(weight)

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        weight, fetched, rows = self.weight, self._fetched, raster.rows
        for copy, sums in enumerate(self._each):
            axons = raster.axons(copy)
            spikes = rows[:, copy].take(axons, 1).astype(weight.dtype)
            spikes.dot(weight.take(axons, 0, fetched[: len(axons)], "clip"), sums)
        if self._bias is not None:
            np.add(self._sums, self._bias, self._sums)
        if self._sums is not self._out:
            np.copyto(self._out, self._sums)


class AutoSum:
    """Looks at the spikes and takes the way that costs least.

    gather: only where the batch is 1.
    """

    def __init__(
        self, gather: SparseSum | None, union: ActiveRows, dense: Matmul, costs: SumCosts
    ) -> None:
        self.gather, self.union, self.dense = gather, union, dense
        self._batch = dense.shape[1]
        # by the number of axons that spiked at all, in the mean of a batch: whether their union
        # beats the dense product, and up to how many spikes fetching them one by one beats both
        united, product = costs.united(dense.shape[2]), costs.dense / self._batch
        self._union = (united < product).tolist()
        self._spikes = costs.affordable(np.minimum(united, product)).tolist()

    @property
    def has_choice(self) -> bool:
        """Whether a way other than the dense product is ever the cheapest."""
        return any(self._union) or any(most >= a for a, most in enumerate(self._spikes))

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        axons = raster.active() // self._batch
        most = self._spikes[axons]
        # every axon spiked at least once; only where that is not too much, count exactly
        if self.gather is not None and axons <= most and raster.spikes() <= most:
            self.gather(raster)
        elif self._union[axons]:
            self.union(raster)
        else:
            self.dense(raster)


_KNOWN: dict[object, SumCosts] = {}


def _costs(gather: SparseSum | None, union: ActiveRows, dense: Matmul) -> SumCosts:
    """Measured once for each shape and number type."""
    types = (dense.weight.dtype, gather and gather.weight.dtype)
    if (key := (dense.shape, types)) not in _KNOWN:
        timesteps, batch, _, neurons = dense.shape
        place = np.empty((timesteps, 1, neurons), dense.weight.dtype)
        one = union if batch == 1 else ActiveRows(union.weight, union.bias, place, union.scratch)
        _KNOWN[key] = measured(dense, one, gather, dense.shape[:3])
    return _KNOWN[key]


def _product(out: Floats, weight: Weights) -> Weights:
    """Where a product goes: to the place itself if its number type is that of the weights."""
    return out if out.dtype == weight.dtype else aligned(out.shape, weight.dtype)


def _filled(like: Weights, row: Weights) -> Weights | None:
    """The row on every row: arrays of one shape are added in half the time; None adds nothing."""
    return np.broadcast_to(row, like.shape).astype(like.dtype) if row.any() else None
