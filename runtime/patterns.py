"""Spike patterns: all that a neuron under a constant drive can do in T timesteps, as a table.

The membrane never decreases when the drive increases, as long as the spikes before are the same; so
each pattern belongs to one interval of drives, and there are few. Looking a drive up among the
edges of the intervals gives the bits of going through the timesteps, in a third of the time.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Drives = NDArray[np.floating]

# timesteps up to which tables are worth their memory: the number of patterns grows with T * T
LONGEST = 64


def spike_pattern(drive: Drives, threshold: float, timesteps: int) -> NDArray[np.uint8]:
    """Spikes (T, ...) of the drives (...), at most one per timestep, each taking the threshold."""
    if timesteps > LONGEST:
        return integrated(drive, threshold, timesteps)
    table = patterns(threshold, timesteps, drive.dtype.str)
    return np.asarray(table.spikes.take(table.edges.searchsorted(drive), axis=1))


def integrated(drive: Drives, threshold: float, timesteps: int) -> NDArray[np.uint8]:
    """The same, timestep by timestep: the definition."""
    spikes = np.empty((timesteps, *drive.shape), np.bool_)
    membrane = drive.copy()
    for t in range(timesteps):
        if t:
            # v = (v - threshold * s) + A
            membrane -= threshold * spikes[t - 1]
            membrane += drive
        # s = v > threshold
        np.greater(membrane, threshold, out=spikes[t])
    return spikes.view(np.uint8)


@dataclass(frozen=True, eq=False)
class Patterns:
    """Every pattern of the drives from 0 to 1.

    edges: (K - 1,) the largest drive of each pattern but the last, increasing.
    spikes: (T, K).
    """

    edges: Drives
    spikes: NDArray[np.uint8]


@lru_cache(maxsize=16)
def patterns(threshold: float, timesteps: int, dtype: str) -> Patterns:
    """All patterns, their edges found by bisection down to neighbouring numbers."""
    low, high = np.zeros(1, dtype), np.ones(1, dtype)
    edges = [np.empty(0, dtype)]
    while low.size:
        differ = _differ(low, high, threshold, timesteps)
        low, high = low[differ], high[differ]
        neighbours = np.nextafter(low, high) == high
        edges.append(low[neighbours])
        low, high = low[~neighbours], high[~neighbours]
        middle = low + (high - low) / 2
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
    found = np.sort(np.concatenate(edges))
    one_of_each = np.append(found, np.ones(1, dtype))
    return Patterns(found, integrated(one_of_each, threshold, timesteps))


def _differ(low: Drives, high: Drives, threshold: float, timesteps: int) -> NDArray[np.bool_]:
    """Whether the ends of each interval have different patterns."""
    at_low, at_high = (integrated(ends, threshold, timesteps) for ends in (low, high))
    return np.asarray((at_low != at_high).any(axis=0))
