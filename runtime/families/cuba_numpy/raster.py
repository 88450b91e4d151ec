"""Spikes of one source in a window with counts that readers share, and aligned memory."""

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class Raster:
    """Spikes (T, B, M), and counts of them, each found once.

    rows: uint8 or bool, 0 or 1.
    bits: the same in bool, on which NumPy searches and counts faster than on numbers.
    """

    __slots__ = ("_axons", "_per_axon", "_spikes", "bits", "rows")

    def __init__(self, rows: NDArray[Any]) -> None:
        self.rows = rows
        self.bits = rows.view(np.bool_) if rows.dtype.itemsize == 1 else rows.astype(np.bool_)
        self._axons: NDArray[np.intp] | None = None
        self._per_axon: NDArray[Any] | None = None
        self._spikes = -1

    def spikes(self) -> int:
        """How many there are in all."""
        if self._spikes < 0:
            self._spikes = int(np.count_nonzero(self.bits))
        return self._spikes

    def axons(self) -> NDArray[np.intp]:
        """Which axons spiked at least once; batch 1."""
        if self._axons is None:
            self._axons = np.logical_or.reduce(self.bits.squeeze(1), 0).nonzero()[0]
        return self._axons

    def per_axon(self) -> NDArray[Any]:
        """(B, M) spikes of each axon."""
        if self._per_axon is None:
            # eight bits hold the counts of a short window, and are summed several times faster
            dtype = np.uint8 if len(self.rows) < 256 else np.int64
            self._per_axon = np.add.reduce(self.rows, 0, dtype)
        return self._per_axon


# [bytes] of a cache line; large arrays of NumPy begin 16 bytes after one, which costs a fifth
LINE = 64


def aligned(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Zeros that begin with a cache line."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    raw = np.zeros(size + LINE, np.uint8)
    start = -raw.ctypes.data % LINE
    return raw[start : start + size].view(dtype).reshape(shape)


def as_aligned(values: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
    """A copy of the values that begins with a cache line."""
    copy = aligned(values.shape, dtype)
    np.copyto(copy, values, casting="unsafe")
    return copy


class Scratch:
    """Memory that one user after another fills; nothing in it lasts.

    size: [bytes] of the largest array that anyone asks for.
    """

    def __init__(self, size: int) -> None:
        self._bytes = aligned((size,), np.uint8)

    def like(self, array: NDArray[Any]) -> NDArray[Any]:
        """An array of the same shape and type, in the memory that all share."""
        return self._bytes[: array.nbytes].view(array.dtype).reshape(array.shape)
