"""A check for numbers that are not finite."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def all_finite(values: NDArray[np.float64]) -> bool:
    """Return False if any of the values (N,) is infinite or NaN."""
    # either makes the sum infinite or NaN; so do large numbers, so only a finite sum says anything.
    # Python's sum of a few numbers takes a third of the time of isfinite, and does not warn
    return math.isfinite(sum(values.tolist())) or bool(np.isfinite(values).all())
