"""Few distinct thresholds for many neurons, since a core stores only so many of them.

A neuron that has a scale of its own has a threshold of its own. Scales may shrink a little, so that
neurons share thresholds; a spike has no size, so nothing else has to follow.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROUNDS = 60


def levelled(scale: Floats, thresholds: Floats, most: int) -> Floats:
    """Scales (N,), at most as large, at which so many distinct threshold mantissas are enough.

    The scale that loses most loses as little as possible.

    thresholds: (N,) [float units].
    """
    whole = np.floor(scale * thresholds)
    used = np.unique(whole[whole > 0])
    # a threshold of 0 is one of them
    room = max(most - int((whole <= 0).any()), 1)
    starts = used if len(used) <= room else _starts(used, _least_ratio(used, room))
    if not len(starts):
        return scale
    level = starts[(np.searchsorted(starts, whole, "right") - 1).clip(min=0)]
    return np.asarray(np.divide(level, thresholds, out=scale.copy(), where=whole > 0))


def _least_ratio(used: Floats, most: int) -> float:
    """Smallest ratio of the largest to the smallest of a group with which so many groups do."""
    low, high = 1.0, float(used[-1] / used[0]) * (1 + 1e-9)
    for _ in range(ROUNDS):
        middle = (low * high) ** 0.5
        low, high = (low, middle) if len(_starts(used, middle)) <= most else (middle, high)
    return high


def _starts(used: Floats, ratio: float) -> Floats:
    """The smallest of each group, whose others are at most so many times as large."""
    starts: list[float] = []
    for value in used.tolist():
        if not starts or value > starts[-1] * ratio:
            starts.append(value)
    return np.array(starts)
