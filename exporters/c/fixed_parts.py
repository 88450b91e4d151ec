"""A delta code in fixed point: observations in 1/256 steps, and how sure their rounding is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, literal
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder

Floats = NDArray[np.float64]

_OBSERVED = 29  # bits of the magnitude of an observation in fixed point
_PRODUCT = 61  # bits of its product with the gain
_REST = 16  # bits behind the point that tell how near the next whole number is
_LARGEST = 2**30  # as the encoder clips X
_USELESS = 0.05  # [1/256 steps] error at which doubles are better


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
    def of(cls, codec: Codec, encoder: DeltaEncoder, live: NDArray[np.bool_]) -> "FixedParts":
        """Those of a codec, with as many bits as fit."""
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
    def small(self) -> bool:
        """Whether X, also before it is clipped, and its levels differ by less than 2**31."""
        return _PRODUCT - self.fraction < 29 and int(self.x_max.max()) < 2**29

    def gaps(self, out: Declarations) -> dict[str, str]:
        """What the template leaves open."""
        useful = self.error < _USELESS
        unsure = int(np.ceil(self.error * 2**_REST)) + 2 if useful else 2**_REST
        return {
            # 1054: the bias of a double's exponent, and the 31 bits before the point of its size
            "scale": out.per_neuron("scale", 1054 - self.exponent, "k", "int32_t"),
            "mean_fixed": out.per_neuron("mean_fixed", self.mean, "k", "int32_t"),
            "gain": out.per_neuron("gain", self.gain, "k", "int32_t"),
            "x_max": out.per_neuron("x_max", self.x_max, "k", "int32_t"),
            "fraction": f"{self.fraction}u",
            "raise": literal((1 << _PRODUCT) + (1 << (self.fraction - 1)), "int64_t"),
            "base": str(1 << (_PRODUCT - self.fraction)),
            "rest_shift": f"{self.fraction - _REST}u",
            "rest_mask": str((1 << _REST) - 1),
            "unsure": str(unsure),
            "sure": str((1 << _REST) - 2 * unsure) if useful else "1",
        }
