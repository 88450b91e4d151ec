"""Numbers of codec.c: observations to channels that spike, what leaves the chip to actions."""

from dataclasses import dataclass
from math import ldexp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.population import PopulationEncoder, pattern_table
from spikedeploy.runtime.errors import ConfigError

Floats = NDArray[np.floating]

# far below the logarithm of the least double
_LOG_OF_ZERO = -800.0
# tanh in 2**-64 at multiples of 1/16, up to where it is 1 within 1e-13
_TANH = np.array([int(ldexp(value, 64)) for value in np.tanh(np.arange(240) / 16)], np.uint64)


def codec_values(codec: Codec) -> dict[str, Any]:
    """Values of the template of a codec.

    encoder: name of the encoder's template.
    live: (obs,) which observations are encoded.
    """
    encoder = codec.encoder
    live = np.ones(encoder.observed, np.bool_)
    found = {"encoder": f"encode_{encoder.kind}", "live": live, "tanh_table": _TANH}
    if isinstance(encoder, DeltaEncoder):
        live &= np.isfinite(encoder.step)
        if not live.any():
            raise ConfigError("--to c: the delta code has no channel with a finite step.")
        return {**found, "parts": FixedParts.from_codec(codec, encoder, live)}
    if isinstance(encoder, PopulationEncoder):
        patterns = pattern_table(encoder.threshold, codec.timesteps, "<f8")
        bits = (patterns.spikes.astype(object) << np.arange(codec.timesteps)[:, None]).sum(axis=0)
        masks = np.array([int(each) for each in bits], np.uint64)
        return {**found, "above": exponents(patterns.edges), "masks": masks}
    return found


def exponents(drives: Floats) -> Floats:
    """For each drive the largest u with exp(u) <= drive, as NumPy computes exp."""
    low, high = np.full(drives.shape, _LOG_OF_ZERO), np.zeros(drives.shape)
    while True:
        middle = low + (high - low) / 2
        open_ = (middle > low) & (middle < high)
        if not open_.any():
            return low
        above = np.exp(middle) > drives
        high, low = np.where(open_ & above, middle, high), np.where(open_ & ~above, middle, low)


_OBSERVED = 29  # bits of the magnitude of an observation in fixed point
_PRODUCT = 61  # bits of its product with the gain
_REST = 16  # bits behind the point that tell how near the next whole number is
_LARGEST = 2**30  # as the encoder clips X
_ERROR_MAX = 0.05  # [1/256 steps] error at which doubles are better


@dataclass(frozen=True, eq=False)
class FixedParts:
    """Numbers by which C computes X = 256 (observation - mean) / std / step; per live channel.

    exponent: an observation is multiplied by 2**this, and cut.
    mean: in the same unit.
    gain: of the difference, in 2**-fraction of X.
    fraction: bits of the product behind the point.
    x_max: largest X, by the clip of the normaliser.
    error: of X [1/256 steps], at most.
    """

    exponent: NDArray[np.int64]
    mean: NDArray[np.int64]
    gain: NDArray[np.int64]
    fraction: int
    x_max: NDArray[np.int64]
    error: float

    @classmethod
    def from_codec(
        cls, codec: Codec, encoder: DeltaEncoder, live: NDArray[np.bool_]
    ) -> "FixedParts":
        """Return the numbers of a codec, with as many bits as fit."""
        normaliser = codec.normaliser
        mean, std = (v[live].astype(np.float64) for v in (normaliser.mean, normaliser.std))
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            parts = 256 / (std * encoder.step[live])  # per unit of the observation
            reach = normaliser.clip * std
            # beyond the clip by some parts, so that what is cut off there is clipped anyway
            reach = np.abs(mean) + reach + np.maximum(0.05 * reach, 4 / parts)
            x_max = np.rint(np.minimum(normaliser.clip / encoder.step[live] * 256, _LARGEST))
            exponent = _OBSERVED - np.ceil(np.log2(reach))
            each = parts / 2.0**exponent
            fraction = np.floor(_PRODUCT - 31 - np.log2(each))
            fine = np.isfinite(fraction) & (np.abs(exponent) < 900)
        if not fine.all() or not 34 <= fraction.min() < 59 or x_max.max() >= _LARGEST:
            zero = np.zeros(len(mean), np.int64)
            return cls(zero, zero, zero, 40, np.minimum(x_max, _LARGEST).astype(np.int64), 1.0)
        bits = int(fraction.min())
        lost = 1.5 * each + 2.0 ** (_OBSERVED + 1 - bits) / 2 + x_max * 2.0**-48
        return cls(
            exponent.astype(np.int64),
            np.rint(mean * 2.0**exponent).astype(np.int64),
            np.rint(each * 2.0**bits).astype(np.int64),
            bits,
            x_max.astype(np.int64),
            float(lost.max()),
        )

    @property
    def fits_int32(self) -> bool:
        """True if X, also before it is clipped, and its levels differ by less than 2**31."""
        return _PRODUCT - self.fraction < 29 and int(self.x_max.max()) < 2**29

    @property
    def scale(self) -> NDArray[np.int64]:
        """Exponent of a double in its bits, less that by which it is shifted to the unit."""
        # 1054: the bias of a double's exponent, and the 31 bits before the point of its size
        return 1054 - self.exponent

    @property
    def rounding_offset(self) -> int:
        """A half, to round; and `offset` in the unit of the product, so that none is negative."""
        return (1 << _PRODUCT) + (1 << (self.fraction - 1))

    @property
    def offset(self) -> int:
        """Added so that no number is negative [1/256 steps]."""
        return 1 << (_PRODUCT - self.fraction)

    @property
    def tie_margin(self) -> int:
        """Distance from a tie of rounding [2**-16] within which doubles decide."""
        useful = self.error < _ERROR_MAX
        return int(np.ceil(self.error * 2**_REST)) + 2 if useful else 2**_REST

    @property
    def certain_width(self) -> int:
        """Width of what integers decide between two ties [2**-16]; 1 where doubles decide all."""
        return (1 << _REST) - 2 * self.tie_margin if self.error < _ERROR_MAX else 1
