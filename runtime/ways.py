"""What the ways of summing weights cost on this machine, measured when a network is loaded.

A wrong measurement, on a machine that was busy, costs time and nothing else: the ways agree.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from runtime.raster import Raster

Way = Callable[[Raster], None]

# runs of which the fastest counts
RUNS = 4


@dataclass(frozen=True)
class Costs:
    """Times of the ways [us].

    dense: of one matrix product of everything.
    union: axons of one of the batch that spiked, and what its small matrix product then costs.
    gather: spikes, and what fetching their weights one by one costs; empty where that is no way.
    """

    dense: float
    union: tuple[tuple[int, float], ...]
    gather: tuple[tuple[int, float], ...] = ()

    def united(self, axons: float) -> float:
        """Time when so many axons of one of the batch spiked [us]."""
        at, costs = zip(*self.union, strict=True)
        return float(np.interp(axons, at, costs))

    def affordable(self, budget: float) -> int:
        """Most spikes whose weights can be fetched one by one in that time [us]; -1 for none."""
        if not self.gather:
            return -1
        (_, none), (spikes, some) = self.gather
        each = max(some - none, 1e-9) / spikes
        return max(-1, int((budget - none) / each))


def measured(dense: Way, union: Way, gather: Way | None, shape: tuple[int, int, int]) -> Costs:
    """Run the ways.

    dense: for the whole batch.
    union, gather: for one of it.
    shape: T, B and M.
    """
    timesteps, batch, axons = shape
    parts = (0, 4, 2, 1)  # of the axons none, every fourth, …

    def taken(way: Way, every: int, copies: int) -> float:
        """Time when every so many-th axon spikes all the time [us]."""
        rows = np.zeros((timesteps, copies, axons), np.bool_)
        if every:
            rows[:, :, ::every] = True
        return min(_timed(lambda: way(Raster(rows))) for _ in range(RUNS))

    def among(every: int) -> int:
        return len(range(0, axons, every)) if every else 0

    return Costs(
        dense=taken(dense, 1, batch),
        union=tuple((among(every), taken(union, every, 1)) for every in parts),
        gather=tuple((among(every) * timesteps, taken(gather, every, 1)) for every in parts[:2])
        if gather
        else (),
    )


def _timed(act: Callable[[], None]) -> float:
    start = time.perf_counter()
    act()
    return 1e6 * (time.perf_counter() - start)
