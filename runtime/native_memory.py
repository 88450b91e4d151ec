"""The memory of the compiled kernels: how large it is, and where in it what is."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.native_kernels import (
    LENGTHS,
    NEURONS,
    RASTER,
    REMEMBERS,
    SIZE,
    STATE,
    Constants,
    Memory,
)
from runtime.scratch import aligned


class NativeMemory:
    """Memory for windows of T timesteps of a batch of B, with views of what is in it.

    constants: of the program; here they know their places.
    arrays: what the kernels take.
    slots: of each state; 2, or T + 1 to leave a trace.
    """

    def __init__(self, constants: Constants, timesteps: int, batch: int, slots: int) -> None:
        self.timesteps, self.batch, self.slots = timesteps, batch, slots
        layers, sources = constants.layers.copy(), constants.sources.copy()
        neurons, rows = sources[:, NEURONS], sources[:, REMEMBERS] + timesteps
        layers[:, STATE], states = _one_after_another(2 * slots * layers[:, SIZE])
        sources[:, RASTER], spikes = _one_after_another(neurons * rows)
        sources[:, LENGTHS], lengths = _one_after_another(rows)
        self.constants = constants._replace(layers=layers, sources=sources)
        widest = int(layers[:, SIZE].max())
        self.arrays = Memory(
            rasters=np.zeros((batch, spikes), np.uint8),
            lists=np.zeros((batch, spikes), np.int32),
            lengths=np.zeros((batch, lengths), np.int64),
            states=aligned((batch, states), np.float64),
            silent=np.zeros((batch, int(layers[:, SIZE].sum())), np.int64),
            sums16=aligned((widest,), np.int16),
            sums32=aligned((widest,), np.int32),
            sums64=aligned((widest,), np.int64),
        )

    def states(self, layer: int) -> NDArray[np.float64]:
        """(B, slots, 2, N) current and membrane."""
        size, at = self.constants.layers[layer, [SIZE, STATE]]
        flat: NDArray[np.float64] = self.arrays.states[:, at : at + 2 * self.slots * size]
        return flat.reshape(self.batch, self.slots, 2, size)

    def rows(self, source: int) -> NDArray[np.uint8]:
        """(B, T, N) spikes of a source in the window."""
        return self._split(self.arrays.rasters, source)[:, -self.timesteps :]

    def copy(self, other: "NativeMemory") -> None:
        """Take over the states, and what is on its way, from memory for other windows."""
        for layer in range(len(self.constants.layers)):
            self.states(layer)[:, 0] = other.states(layer)[:, 0]
        for source, (_, past, _, at) in enumerate(self.constants.sources):
            for mine, its in zip(self.arrays[:2], other.arrays[:2], strict=True):
                self._split(mine, source)[:, :past] = other._split(its, source)[:, :past]
            there = other.constants.sources[source, LENGTHS]
            lengths = other.arrays.lengths[:, there : there + past]
            self.arrays.lengths[:, at : at + past] = lengths
        self.arrays.silent[:] = other.arrays.silent

    def _split(self, array: NDArray[Any], source: int) -> NDArray[Any]:
        """(B, remembered + T, N) of the rasters or of the lists."""
        size, past, at, _ = self.constants.sources[source]
        rows = past + self.timesteps
        return array[:, at : at + rows * size].reshape(self.batch, rows, size)


def _one_after_another(sizes: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Where each begins, and where the last ends."""
    ends = np.cumsum(sizes)
    return ends - sizes, int(ends[-1])
