"""Arrays as text: differences in time as small integers, compressed, in base64."""

import zlib
from base64 import b64encode
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_LEVELS = 32_000  # of a column between its lowest and highest value


def packed(values: ArrayLike) -> dict[str, Any]:
    """Numbers (S, …) with 32,000 levels between lowest and highest, as differences along S.

    `shape`, `low` and `step` undo it: value = low + step * cumulative sum, NaN becomes low.
    """
    array = np.nan_to_num(np.asarray(values, np.float64))
    low, high = (float(array.min()), float(array.max())) if array.size else (0.0, 0.0)
    step = (high - low) / _LEVELS or 1.0
    levels = np.rint((array - low) / step).astype(np.int16)
    changes = np.diff(levels, axis=0, prepend=np.zeros_like(levels[:1]))
    return {"shape": list(array.shape), "low": low, "step": step, "data": _text(changes)}


def packed_bits(spikes: NDArray[Any]) -> dict[str, Any]:
    """Spikes (R, N), each row from the lowest bit on: `shape` and `data`."""
    rows = spikes.reshape(len(spikes), -1) != 0
    bits = np.packbits(rows, axis=1, bitorder="little")
    return {"shape": list(rows.shape), "data": _text(bits)}


def _text(array: NDArray[Any]) -> str:
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return b64encode(zlib.compress(little.tobytes(), 9)).decode()
