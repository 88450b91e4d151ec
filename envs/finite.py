"""Whether a vector holds numbers only: asked in every control step."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def all_finite(values: NDArray[np.float64]) -> bool:
    """Whether none of the values (N,) is infinite or NaN."""
    # either makes the sum of squares infinite or NaN, and a product takes a third of the time;
    # squares of large numbers overflow too, so only a finite sum says anything
    return math.isfinite(values.dot(values)) or bool(np.isfinite(values).all())
