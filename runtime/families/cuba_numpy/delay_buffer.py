"""Spikes that were emitted in earlier timesteps and have not arrived yet."""

import numpy as np

from spikedeploy.runtime.emulator.backend import SavedState
from spikedeploy.runtime.families.cuba_numpy.raster import Raster


class DelayBuffer:
    """Delivers the rows of each source late.

    sizes: neurons of each source.
    longest: longest delay, in rows.
    """

    def __init__(self, sizes: dict[str, int], longest: int, batch: int) -> None:
        self._longest = longest
        self._tails = {name: np.zeros((longest, batch, n), np.uint8) for name, n in sizes.items()}

    def reset(self) -> None:
        """Nothing is on its way."""
        if self._longest:
            for tail in self._tails.values():
                tail.fill(0)

    def delayed(
        self, source: str, delay: int, output_spikes: dict[str, Raster], timesteps: int
    ) -> Raster:
        """The T rows of a source that arrive in this window."""
        if delay == 0:
            return output_spikes[source]
        first = self._longest - delay
        rows = self._tails[source][first : first + timesteps]
        if delay < timesteps:
            rows = np.concatenate([rows, output_spikes[source].rows[: timesteps - delay]])
        return Raster(rows)

    def keep(self, output_spikes: dict[str, Raster]) -> None:
        """Remember the last rows of a window."""
        if self._longest:
            for name, raster in output_spikes.items():
                rows = np.concatenate([self._tails[name], raster.rows])
                self._tails[name] = rows[-self._longest :]

    def saved(self) -> SavedState:
        """Copies of the rows that have not arrived, by source."""
        return {name: tail.copy() for name, tail in self._tails.items()}

    def restore(self, saved: SavedState) -> None:
        """Go on from there."""
        self._tails = {name: saved[name].copy() for name in self._tails}
