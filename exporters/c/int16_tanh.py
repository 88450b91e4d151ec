"""tanh in integers: a fixed-point score to Q15, by a table and straight lines between."""

from math import ceil, floor, log2

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]

ONE = 2**15 - 1  # the action 1.0 in Q15
PER_UNIT = 5  # bits: 32 entries for each unit of the score
BETWEEN = 10  # bits of the place between two entries
_LAST = 5.5  # tanh is 1 within half a unit of Q15 from here on

TABLE = np.rint(ONE * np.tanh(np.arange(ceil(_LAST * 2**PER_UNIT) + 1) / 2**PER_UNIT)).astype(
    np.int64
)
LEAST_FRACTION = PER_UNIT + BETWEEN


def tanh_q15(score: Integers, fraction: int) -> Integers:
    """Q15 of tanh(score 2**-fraction), fraction >= LEAST_FRACTION; within 5 units of the real one.

    z = |score|,  i = z >> (fraction - 5),  f = ten bits behind i
    y = T[i] + ((T[i + 1] - T[i]) f + 512 >> 10),  and 32767 where the table ends
    """
    size = np.abs(score)
    place = size >> (fraction - PER_UNIT)
    inside = np.minimum(place, len(TABLE) - 2)
    between = (size >> (fraction - LEAST_FRACTION)) & (2**BETWEEN - 1)
    step = TABLE[inside + 1] - TABLE[inside]
    line = TABLE[inside] + ((step * between + 2 ** (BETWEEN - 1)) >> BETWEEN)
    found: Integers = np.sign(score) * np.where(place < len(TABLE) - 1, line, ONE)
    return found


def linear_q15(score: Integers, fraction: int) -> Integers:
    """Q15 of the score itself, within [-1, 1]."""
    found: Integers = np.clip(score >> (fraction - 15), -ONE, ONE)
    return found


def score_fraction(largest: float) -> int:
    """Bits behind the point with which scores up to this magnitude leave one of 31 bits free."""
    return floor(30 - log2(max(largest, 2.0**-14)))
