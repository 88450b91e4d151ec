"""The relay: spikes that were emitted in earlier timesteps and are still on their way."""

import numpy as np
from numpy.typing import NDArray

from runtime.raster import Raster

Rows = NDArray[np.uint8]


class Relay:
    """Delivers the rows of each source late.

    sizes: neurons of each source.
    memory: longest lateness, in rows.
    """

    def __init__(self, sizes: dict[str, int], memory: int, batch: int) -> None:
        self._memory = memory
        self._tails = {name: np.zeros((memory, batch, n), np.uint8) for name, n in sizes.items()}

    def reset(self) -> None:
        """Nothing is on its way."""
        if self._memory:
            for tail in self._tails.values():
                tail.fill(0)

    def heard(self, source: str, late: int, emitted: dict[str, Raster], timesteps: int) -> Raster:
        """The T rows that arrive in this window when they are so late."""
        if late == 0:
            return emitted[source]
        first = self._memory - late
        rows = self._tails[source][first : first + timesteps]
        if late < timesteps:
            rows = np.concatenate([rows, emitted[source].rows[: timesteps - late]])
        return Raster(rows)

    def keep(self, emitted: dict[str, Raster]) -> None:
        """Remember the last rows of a window."""
        if self._memory:
            for name, raster in emitted.items():
                rows = np.concatenate([self._tails[name], raster.rows])
                self._tails[name] = rows[-self._memory :]
