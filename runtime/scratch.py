"""Memory as processors like it: it begins with a cache line, and is used again while it is warm."""

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

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
    """Memory that one user after another may fill; nothing in it lasts.

    size: [bytes] of the largest array that anyone asks for.
    """

    def __init__(self, size: int) -> None:
        self._bytes = aligned((size,), np.uint8)

    def like(self, array: NDArray[Any]) -> NDArray[Any]:
        """An array of the same shape and type, in the memory that all share."""
        return self._bytes[: array.nbytes].view(array.dtype).reshape(array.shape)
