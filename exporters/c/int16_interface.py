"""Observations as 16-bit integers: a power of two for each, chosen from the normaliser's range."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.codec.codec import Normaliser
from spikedeploy.runtime.errors import ConfigError, ObservationError

Integers = NDArray[np.int64]

LARGEST = 2**15 - 1
_EXPONENTS = 126  # of either sign: what an int8_t of C holds


@dataclass(frozen=True, eq=False)
class Int16Observations:
    """Fixed-point numbers that stand for observations.

        o = rint(clip(value 2**exponent, low, high))

    exponent: (obs,) bits behind the binary point; may be negative.
    low, high: (obs,) the clip of the normaliser in these units, within int16.
    """

    exponent: Integers
    low: Integers
    high: Integers

    @classmethod
    def of(cls, normaliser: Normaliser) -> "Int16Observations":
        """The finest powers of two at which mean +- clip standard deviations fit in 16 bits."""
        mean, std = normaliser.mean.astype(np.float64), normaliser.std.astype(np.float64)
        reach = np.abs(mean) + normaliser.clip * std
        with np.errstate(all="ignore"):
            exponent = np.floor(np.log2(LARGEST / reach))
        bad = ~(np.abs(exponent) <= _EXPONENTS)
        if bad.any():
            k = int(np.flatnonzero(bad)[0])
            raise ConfigError(
                f"--to c: observation {k} reaches {reach[k]:.3g}, which no int16 with an exponent "
                f"from -{_EXPONENTS} to {_EXPONENTS} stands for. Train with a finite normaliser "
                "clip and observations in ordinary units."
            )
        scale = 2.0**exponent
        low = np.rint((mean - normaliser.clip * std) * scale)
        high = np.rint((mean + normaliser.clip * std) * scale)
        return cls(exponent.astype(np.int64), low.astype(np.int64), high.astype(np.int64))

    def quantise(self, observation: NDArray[np.floating]) -> Integers:
        """Integers (..., obs) of observations in their own units."""
        if not np.isfinite(observation).all():
            raise ObservationError("the observation holds a number that is not finite")
        scaled = np.asarray(observation, np.float64) * 2.0**self.exponent
        return np.asarray(np.rint(np.clip(scaled, self.low, self.high)), np.int64)
