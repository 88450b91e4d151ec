"""The tally: a layer's line of the ledger, counted while the window is still in memory."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from runtime.kernels import Window
from runtime.ledger import Counts
from runtime.program import Program
from runtime.synapses import Raster

Number: TypeAlias = int | NDArray[Any]


class Tally:
    """Counts the events of all layers; equal to runtime.ledger.count.

    windows: of the layers, in their order.
    steps: chip timesteps that a window stands for, those in which a layer only waits included.
    """

    def __init__(self, program: Program, windows: Sequence[Window], steps: int) -> None:
        self._layers = [LayerTally(program, window, steps) for window in windows]

    def __call__(self, emitted: Mapping[str, Raster], counts: Counts) -> None:
        """Add what happened in the windows that have just run to counts (B, L, E)."""
        events = [count(emitted) for count in self._layers]
        if len(counts) == 1:
            counts += np.array(events, np.int64)
        else:
            for index, columns in enumerate(events):
                counts[:, index] += np.stack(np.broadcast_arrays(*columns), axis=1)


class LayerTally:
    """Counts the events of one layer."""

    def __init__(self, program: Program, window: Window, steps: int) -> None:
        layer = window.layer
        timesteps, self._batch, _ = window.spikes.shape
        self._window = window
        self._neurons = steps * layer.size
        self._bias_sops = timesteps * layer.bias_fan_out
        self._bias_messages = timesteps * (layer.bias_fan_out > 0)
        self._to_host = layer.name == program.output
        self._sources = [(s.source, s.fan_out.astype(np.float64)) for s in layer.synapses]
        self._biased = layer.voltage_bias != 0 if layer.voltage_bias.any() else None
        self._alive = np.empty(window.states.shape, np.bool_)
        self._current, self._membrane_before = self._alive[1:, 0], self._alive[:-1, 1]
        self._busy = np.empty_like(window.spikes)

    def __call__(self, emitted: Mapping[str, Raster]) -> tuple[Number, ...]:
        """Each of runtime.ledger.EVENTS: a number where the batch is 1, and (B,) or 1 elsewhere."""
        heard: Number = 0
        sops: Number = 0
        for source, fan_out in self._sources:
            heard = heard + self._spikes(emitted[source])
            sops = sops + self._sops(emitted[source], fan_out)
        if self._window.waiting:
            return heard, sops, 0, 0, self._neurons, 0, heard, 0
        updates = self._updates()
        idle = self._neurons - updates
        spikes = self._spikes(emitted[self._window.layer.name])
        messages = heard + self._bias_messages
        if self._to_host:
            messages = messages + spikes
        return heard, sops, self._bias_sops, updates, idle, spikes, messages, self._overflows()

    def _spikes(self, raster: Raster) -> Number:
        if self._batch == 1:
            return raster.total()
        return np.asarray(raster.per_axon().sum(axis=1, dtype=np.int64))

    def _sops(self, raster: Raster, fan_out: NDArray[np.float64]) -> Number:
        # float64 is exact up to 2**53, and has the dot product that int64 lacks; dot() is @ for
        # those in a hurry
        sops = raster.per_axon().astype(np.float64).dot(fan_out)
        return int(sops[0]) if self._batch == 1 else sops.astype(np.int64)

    def _updates(self) -> Number:
        """Neuron-timesteps with a membrane, a current or a bias to add up."""
        busy = self._busy
        np.not_equal(self._window.states, 0.0, self._alive)
        np.logical_or(self._current, self._membrane_before, busy)
        if self._biased is not None:
            np.logical_or(busy, self._biased, busy)
        if self._batch == 1:
            return int(np.count_nonzero(busy))
        return np.asarray(np.count_nonzero(busy, axis=(0, 2)))

    def _overflows(self) -> Number:
        if not self._window.interpreted:
            return 0
        overflows = self._window.overflows
        return int(overflows[0]) if self._batch == 1 else overflows
