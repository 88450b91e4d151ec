"""The raster: spikes of one source in a window, with counts that several readers share."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Raster:
    """Spikes (T, B, M), and what readers want to know of them, found once.

    rows: uint8 or bool, 0 or 1.
    bits: the same in bool, on which NumPy searches and counts faster than on numbers.
    """

    __slots__ = ("_active", "_axons", "_per_axon", "_spikes", "bits", "rows")

    def __init__(self, rows: NDArray[Any]) -> None:
        self.rows = rows
        self.bits = rows.view(np.bool_) if rows.dtype.itemsize == 1 else rows.astype(np.bool_)
        self._active: NDArray[np.bool_] | None = None
        self._axons: NDArray[np.intp] | None = None
        self._per_axon: NDArray[Any] | None = None
        self._spikes = -1

    def spikes(self) -> int:
        """How many there are in all."""
        if self._spikes < 0:
            self._spikes = int(np.count_nonzero(self.bits))
        return self._spikes

    def active(self) -> int:
        """Axons that spiked at least once, over the batch."""
        if self.rows.shape[1] == 1:
            return len(self.axons(0))
        return int(np.count_nonzero(self._whether_active()))

    def axons(self, copy: int) -> NDArray[np.intp]:
        """Which axons spiked at least once, of one of the batch."""
        if copy:
            return np.asarray(self._whether_active()[copy].nonzero()[0])
        if self._axons is None:
            self._axons = self._whether_active()[0].nonzero()[0]
        return self._axons

    def per_axon(self) -> NDArray[Any]:
        """(B, M) spikes of each axon."""
        if self._per_axon is None:
            # eight bits hold the counts of a short window, and are summed several times faster
            dtype = np.uint8 if len(self.rows) < 256 else np.int64
            self._per_axon = np.add.reduce(self.rows, 0, dtype)
        return self._per_axon

    def _whether_active(self) -> NDArray[np.bool_]:
        """(B, M) whether an axon spiked at all."""
        if self._active is None:
            self._active = np.logical_or.reduce(self.bits, 0)
        return self._active
