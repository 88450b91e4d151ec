"""The tally: what the ledger needs of a window, taken while it is in memory, and counted later.

Taking is part of every inference and must be quick; counting is done for many at once.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.ledger import EVENTS, Counts
from runtime.program import Layer, Program
from runtime.raster import Raster


class Ran(Protocol):
    """What a window shows of the layer that ran in it, as Window has it."""

    @property
    def layer(self) -> Layer:
        """Whose window it is."""

    @property
    def states(self) -> NDArray[Any]:
        """(T + 1, 2, B, N)."""

    @property
    def spikes(self) -> NDArray[np.bool_]:
        """(T, B, N)."""

    @property
    def ordinary(self) -> bool:
        """Whether it ran, and ran fast."""

    @property
    def waiting(self) -> bool:
        """Whether it let the window pass."""

    @property
    def interpreted(self) -> bool:
        """Whether the interpreter ran it."""

    @property
    def overflows(self) -> Any:  # noqa: ANN401
        """(B,) numbers that did not fit, where it was interpreted."""


class Observation(NamedTuple):
    """One window of all layers.

    per_axon: of the input and of each layer, spikes (B, N) of each neuron.
    updates: (L, B) neuron-timesteps with something to add up; (L,) where the batch is 1.
    overflows: (L, B) numbers that did not fit; None where all did and all layers ran.
    running: (L,) whether a layer has started; None likewise.
    """

    per_axon: list[NDArray[Any]]
    updates: list[Any]
    overflows: list[Any] | None
    running: list[bool] | None


class Tally:
    """Observes the windows of all layers; its counts are those of runtime.ledger.count.

    windows: of the layers, in their order.
    steps: chip timesteps that a window stands for, those in which a layer only waits included.
    """

    def __init__(self, program: Program, windows: Sequence[Ran], steps: int) -> None:
        self.steps = steps
        self.timesteps, self.batch, _ = windows[0].spikes.shape
        self._program, self._windows = program, windows
        self._busy = [Busy(window) for window in windows]

    def observe(self, emitted: Mapping[str, Raster]) -> Observation:
        """The windows that have just run, with the spikes of the input and of each layer."""
        overflows = running = None
        if not all([window.ordinary for window in self._windows]):
            overflows = [w.overflows * w.interpreted for w in self._windows]
            running = [not window.waiting for window in self._windows]
        per_axon = [raster.per_axon() for raster in emitted.values()]
        return Observation(per_axon, [busy() for busy in self._busy], overflows, running)

    def count(self, observations: Sequence[Observation]) -> Counts:
        """Counts (S, L, E): a row for each observation and each of its batch."""
        layers = self._program.layers
        none, all_ = np.zeros((len(layers), self.batch)), [True] * len(layers)
        updates = self._rows([o.updates for o in observations])
        overflows = self._rows([none if o.overflows is None else o.overflows for o in observations])
        running = np.repeat([o.running or all_ for o in observations], self.batch, axis=0)
        spikes = {
            name: np.concatenate([o.per_axon[index] for o in observations])
            for index, name in enumerate(self._program.sizes)
        }
        counts = np.zeros((*updates.shape, len(EVENTS)), np.int64)
        for index, layer in enumerate(layers):
            events = self._events(layer, spikes, running[:, index])
            events["neuron_update"] = updates[:, index] * running[:, index]
            events["neuron_idle"] = layer.size * self.steps - events["neuron_update"]
            events["saturation"] = overflows[:, index]
            counts[:, index] = np.stack([events[name] for name in EVENTS], axis=1)
        return counts

    def _events(
        self, layer: Layer, spikes: Mapping[str, NDArray[Any]], running: NDArray[np.bool_]
    ) -> dict[str, Counts]:
        """What follows from the spikes (S, N) of each neuron alone."""
        heard = [(synapses, spikes[synapses.source]) for synapses in layer.synapses]
        spike_in = sum(rows.sum(axis=1, dtype=np.int64) for _, rows in heard)
        spike_out = spikes[layer.name].sum(axis=1, dtype=np.int64)
        always_on = self.timesteps * running
        to_host = spike_out * (layer.name in self._program.to_host)
        return {
            "spike_in": spike_in,
            # float64 is exact up to 2**53, and has the matrix product that int64 lacks
            "sop": sum((rows @ s.fan_out.astype(np.float64)).astype(np.int64) for s, rows in heard),
            "bias_sop": always_on * layer.bias_fan_out,
            "spike_out": spike_out,
            "message": spike_in + always_on * (layer.bias_fan_out > 0) + to_host,
        }

    def _rows(self, values: Sequence[Any]) -> Counts:
        """Values of observations, layers and batch as rows (S, L)."""
        layers = len(self._program.layers)
        shaped = np.array(values, np.int64).reshape(-1, layers, self.batch)
        return np.asarray(shaped.swapaxes(1, 2).reshape(-1, layers))


class Busy:
    """Counts neuron-timesteps with a membrane, a current or a bias to add up."""

    def __init__(self, window: Ran) -> None:
        self._window = window
        voltage_bias = window.layer.voltage_bias
        self._biased = voltage_bias != 0 if voltage_bias.any() else None
        self._alive = np.empty(window.states.shape, np.bool_)
        self._current, self._membrane_before = self._alive[1:, 0], self._alive[:-1, 1]
        self._busy = np.empty_like(window.spikes)

    def __call__(self) -> Any:  # noqa: ANN401
        """Of the last window, (B,); a number where the batch is 1."""
        busy = self._busy
        np.not_equal(self._window.states, 0.0, self._alive)
        np.logical_or(self._current, self._membrane_before, busy)
        if self._biased is not None:
            np.logical_or(busy, self._biased, busy)
        if busy.shape[1] == 1:
            return np.count_nonzero(busy)
        return np.count_nonzero(busy, axis=(0, 2))
