"""The tally: a layer's line of the ledger, counted while the window is still in memory."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from runtime.kernels import Window
from runtime.ledger import EVENTS
from runtime.program import Program
from runtime.synapses import Raster

Counts = NDArray[np.int64]

SPIKE_IN, SOP, BIAS_SOP, UPDATE, IDLE, SPIKE_OUT, MESSAGE, SATURATION = range(len(EVENTS))


class Tally:
    """Counts the events of one layer; equal to runtime.ledger.count.

    steps: chip timesteps that a window stands for, those in which the layer only waits included.
    """

    def __init__(self, program: Program, window: Window, steps: int) -> None:
        self._window, self._layer = window, window.layer
        self._timesteps = len(window.spikes)
        self._neurons = steps * self._layer.size
        # float64 is exact up to 2**53, and has the dot product that int64 lacks
        self._fan_out = [s.fan_out.astype(np.float64) for s in self._layer.synapses]
        self._busy = np.empty_like(window.spikes)
        self._biased = self._layer.voltage_bias != 0 if self._layer.voltage_bias.any() else None
        self._to_host = self._layer.name == program.output

    def __call__(self, emitted: Mapping[str, Raster], counts: Counts) -> None:
        """Add the events of the window that has just run to counts (B, E)."""
        for synapses, fan_out in zip(self._layer.synapses, self._fan_out, strict=True):
            raster = emitted[synapses.source]
            counts[:, SPIKE_IN] += raster.total
            counts[:, MESSAGE] += raster.total
            counts[:, SOP] += (raster.per_axon @ fan_out).astype(np.int64)
        if self._window.waiting:
            counts[:, IDLE] += self._neurons
            return
        updates = self._updates()
        spikes = emitted[self._layer.name].total
        counts[:, BIAS_SOP] += self._timesteps * self._layer.bias_fan_out
        counts[:, MESSAGE] += self._timesteps * (self._layer.bias_fan_out > 0)
        counts[:, UPDATE] += updates
        counts[:, IDLE] += self._neurons - updates
        counts[:, SPIKE_OUT] += spikes
        counts[:, SATURATION] += self._window.overflows
        if self._to_host:
            counts[:, MESSAGE] += spikes

    def _updates(self) -> NDArray[np.int64] | int:
        """(B,) neuron-timesteps with a membrane, a current or a bias to add up."""
        states, busy = self._window.states, self._busy
        np.logical_or(states[1:, 0], states[:-1, 1], busy)
        if self._biased is not None:
            np.logical_or(busy, self._biased, busy)
        if busy.shape[1] == 1:
            return int(np.count_nonzero(busy))
        return np.asarray(np.count_nonzero(busy, axis=(0, 2)))
