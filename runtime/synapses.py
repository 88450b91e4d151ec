"""Synapses in a hurry: from spikes to the sum of weights that arrives, in three ways.

Which way is fastest depends on how many spikes there are and where. All of them sum whole numbers
that their number type is proven to hold exactly, so they agree bit for bit, in any order of
summation and on any BLAS. (`ideal` has no whole numbers and always multiplies in float64.)
"""

from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Weights = NDArray[Any]

# largest magnitudes up to which every whole number is held
EXACT_FLOAT32 = 1 << 24
EXACT_INT16 = (1 << 15) - 1

# Measured on one core of a server of 2023; only their ratios matter, to choose a way.
CALL = 0.9  # [us] a NumPy call on a few hundred numbers
FETCH16 = 1.2e-4  # [us] a weight fetched as int16 and added
FETCH32 = 0.8e-4  # [us] a weight copied as float32
MULTIPLY = 0.3e-4  # [us] a weight multiplied and added in a matrix product


class Raster:
    """Spikes of one source in a window, with counts that several readers share.

    rows: (T, B, M), uint8 or bool.
    """

    __slots__ = ("_axons", "_per_axon", "rows")

    def __init__(self, rows: NDArray[Any]) -> None:
        self.rows = rows
        self._per_axon: NDArray[Any] | None = None
        self._axons: NDArray[np.intp] | None = None

    def per_axon(self) -> NDArray[Any]:
        """(B, M) spikes of each axon."""
        if self._per_axon is None:
            # eight bits hold the counts of a short window, and are summed several times faster
            dtype = np.uint8 if len(self.rows) < 256 else np.int64
            self._per_axon = np.add.reduce(self.rows, 0, dtype)
        return self._per_axon

    def axons(self) -> NDArray[np.intp]:
        """Which axons spiked at least once; batch 1."""
        if self._axons is None:
            # bool, for nonzero is slower on numbers
            self._axons = self.per_axon()[0].astype(np.bool_).nonzero()[0]
        return self._axons


class Sum(Protocol):
    """What turns spikes into sums of weights, those of an axon that always spikes included."""

    def __call__(self, raster: Raster, out: Floats) -> None:
        """Write the sums (T, B, N) in state units."""


def summing(
    weight: Weights,
    bias: Weights,
    partial: int | None,
    unit: int,
    timesteps: int,
    batch: int,
) -> Sum:
    """The fastest exact way.

    weight: (M, N).
    bias: (N,) weights of the axon that always spikes.
    partial: largest magnitude of any partial sum; None where weights are no whole numbers.
    unit: state units per weight unit.
    """
    exact32 = partial is not None and partial * unit < EXACT_FLOAT32
    dtype = np.float32 if exact32 else np.float64
    scaled, pull = (weight * float(unit)).astype(dtype), (bias * float(unit)).astype(dtype)
    dense = Dense(scaled, pull, timesteps, batch)
    if partial is None or batch > 1:
        return dense
    whole = np.int16 if partial <= EXACT_INT16 else np.int32
    gather = Gather(weight.astype(whole), bias.astype(whole), unit, timesteps)
    return Cheapest(gather, Union(scaled, pull, timesteps), dense)


class Dense:
    """All axons times all weights: one matrix product for the window."""

    def __init__(self, weight: Weights, bias: Weights, timesteps: int, batch: int) -> None:
        self._weight = weight
        axons, neurons = weight.shape
        # matrices over the same memory: BLAS wants two axes
        self._spikes = np.empty((timesteps, batch, axons), weight.dtype)
        self._flat = self._spikes.reshape(-1, axons)
        self._sums = np.empty((timesteps * batch, neurons), weight.dtype)
        self._bias = _filled(self._sums, bias)
        self._shaped = self._sums.reshape(timesteps, batch, neurons)
        self.cost = 3 * CALL + MULTIPLY * timesteps * batch * weight.size

    def __call__(self, raster: Raster, out: Floats) -> None:
        """Write the sums (T, B, N) in state units."""
        np.copyto(self._spikes, raster.rows)
        self._flat.dot(self._weight, self._sums)
        np.add(self._sums, self._bias, self._sums)
        np.copyto(out, self._shaped)


class Gather:
    """Only the weights of axons that spiked, timestep by timestep; batch 1.

    Cost grows with the number of spikes; with int16 it has the fewest bytes to fetch.
    """

    def __init__(self, weight: Weights, bias: Weights, unit: int, timesteps: int) -> None:
        self._weight = weight
        self._unit = np.float64(unit)
        self._sums = np.empty((timesteps, 1, weight.shape[1]), weight.dtype)
        self._bias = _filled(self._sums, bias)
        self._rows = list(self._sums[:, 0])
        self.cost = (1 + 3 * timesteps) * CALL
        self.cost_per_spike = FETCH16 * weight.itemsize / 2 * weight.shape[1]

    def __call__(self, raster: Raster, out: Floats) -> None:
        """Write the sums (T, 1, N) in state units."""
        take, add = self._weight.take, np.add.reduce
        for spikes, row in zip(raster.rows[:, 0], self._rows, strict=True):
            add(take(spikes.nonzero()[0], 0), 0, None, row)
        np.add(self._sums, self._bias, self._sums)
        np.multiply(self._sums, self._unit, out)


class Union:
    """Axons that spiked at least once, in one small matrix product; batch 1.

    Best where the same axons spike again and again, as those of a population code do.
    """

    def __init__(self, weight: Weights, bias: Weights, timesteps: int) -> None:
        self._weight = weight
        self._sums = np.empty((timesteps, weight.shape[1]), weight.dtype)
        self._bias = _filled(self._sums, bias)
        self.cost = 6 * CALL
        self.cost_per_axon = (FETCH32 + MULTIPLY * timesteps) * weight.shape[1]

    def __call__(self, raster: Raster, out: Floats) -> None:
        """Write the sums (T, 1, N) in state units."""
        axons = raster.axons()
        spikes = raster.rows[:, 0].take(axons, 1).astype(self._weight.dtype)
        spikes.dot(self._weight.take(axons, 0), self._sums)
        np.add(self._sums, self._bias, self._sums)
        np.copyto(out[:, 0], self._sums)


class Cheapest:
    """Looks at the spikes and takes the way that costs least; batch 1."""

    def __init__(self, gather: Gather, union: Union, dense: Dense) -> None:
        self.gather, self.union, self.dense = gather, union, dense

    def __call__(self, raster: Raster, out: Floats) -> None:
        """Write the sums (T, 1, N) in state units."""
        axons = len(raster.axons())
        cost, way = self.dense.cost, cast("Sum", self.dense)
        union = self.union.cost + self.union.cost_per_axon * axons
        if union < cost:
            cost, way = union, self.union
        # every axon spiked at least once; only where that is not too much, count exactly
        if self.gather.cost + self.gather.cost_per_spike * axons < cost:
            spikes = int(np.count_nonzero(raster.rows))
            if self.gather.cost + self.gather.cost_per_spike * spikes < cost:
                way = self.gather
        way(raster, out)


def _filled(like: Weights, row: Weights) -> Weights:
    """The row on every row: arrays of one shape are added in half the time."""
    return np.broadcast_to(row, like.shape).astype(like.dtype)
