"""Scratch memory: one place for what is needed only for a moment, so that it stays in the cache."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Scratch:
    """Memory that one user after another may fill; nothing in it lasts.

    size: [bytes] of the largest array that anyone asks for.
    """

    def __init__(self, size: int) -> None:
        self._bytes = np.empty(size, np.uint8)

    def like(self, array: NDArray[Any]) -> NDArray[Any]:
        """An array of the same shape and type, in the memory that all share."""
        return self._bytes[: array.nbytes].view(array.dtype).reshape(array.shape)
