"""What the ways of summing weights cost on this machine, measured when a network is loaded.

A wrong measurement, on a machine that was busy, costs time and nothing else: the ways agree.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.emulator.raster import Raster

Way = Callable[[Raster], None]

# runs of which the fastest counts
RUNS = 10


@dataclass(frozen=True)
class SumCosts:
    """Times of the ways [us].

    dense: of one matrix product of everything.
    union: axons of one of the batch that spiked, and what its small matrix product then costs.
    gather: spikes, and what fetching their weights one by one costs; empty where that is no way.
    """

    dense: float
    union: tuple[tuple[int, float], ...]
    gather: tuple[tuple[int, float], ...] = ()

    def united(self, axons: int) -> NDArray[np.float64]:
        """Time for one of the batch when none, one, … all of its axons spiked [us]."""
        at, costs = zip(*self.union, strict=True)
        return np.asarray(np.interp(np.arange(axons + 1), at, costs))

    def affordable(self, budget: NDArray[np.float64]) -> NDArray[np.int64]:
        """Most spikes whose weights can be fetched one by one in that time [us]; -1 for none."""
        if not self.gather:
            return np.full(budget.shape, -1)
        (_, none), (spikes, some) = self.gather
        each = max(some - none, 1e-9) / spikes
        return np.maximum((budget - none) / each, -1).astype(np.int64)


def measured(dense: Way, union: Way, gather: Way | None, shape: tuple[int, int, int]) -> SumCosts:
    """Run the ways in turns, so that what else the machine does hits all alike.

    dense: for the whole batch.
    union, gather: for one of it.
    shape: T, B and M.
    """
    timesteps, batch, axons = shape
    parts = (0, 4, 2, 1)  # of the axons none, every fourth, …

    def spiking(every: int, copies: int) -> Raster:
        """Every so many-th axon spikes all the time."""
        rows = np.zeros((timesteps, copies, axons), np.bool_)
        if every:
            rows[:, :, ::every] = True
        return Raster(rows)

    trials = [(dense, spiking(1, batch)), *((union, spiking(every, 1)) for every in parts)]
    if gather:
        trials += [(gather, spiking(every, 1)) for every in parts[:2]]
    # a new raster every time: what is known of it is kept
    runs = [[_timed(way, Raster(raster.rows)) for way, raster in trials] for _ in range(RUNS)]
    best = [min(times) for times in zip(*runs, strict=True)]
    presynaptic = [raster for _, raster in trials]
    return SumCosts(
        dense=best[0],
        union=tuple(
            (raster.active(), t) for raster, t in zip(presynaptic[1:5], best[1:5], strict=True)
        ),
        gather=tuple(
            (raster.spikes(), t) for raster, t in zip(presynaptic[5:], best[5:], strict=True)
        ),
    )


def _timed(way: Way, raster: Raster) -> float:
    start = time.perf_counter()
    way(raster)
    return 1e6 * (time.perf_counter() - start)
