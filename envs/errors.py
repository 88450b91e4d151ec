"""EnvError, the exception of this package, and a check for finite numbers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from spikedeploy.errors import SpikedeployError


class EnvError(SpikedeployError):
    """An environment, an option, an action or a file that is not valid."""


def all_finite(values: NDArray[np.float64]) -> bool:
    """Return False if any of the values (N,) is infinite or NaN."""
    # either makes the sum infinite or NaN; so do large numbers, so only a finite sum says anything.
    # Python's sum of a few numbers takes a third of the time of isfinite, and does not warn
    return math.isfinite(sum(values.tolist())) or bool(np.isfinite(values).all())
