"""The recorder: the ledger while it grows.

The tally: what the ledger needs of a window, taken while it is in memory, and counted later.

Taking is part of every inference and must be quick; counting is done for many at once.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Layer, Program
from spikedeploy.runtime.emulator.ledger import EVENTS, Counts, Ledger
from spikedeploy.runtime.emulator.raster import Raster
from spikedeploy.runtime.errors import ConfigError


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


class WindowStats(NamedTuple):
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


class EventCounter:
    """Observes the windows of all layers; its counts are those of runtime.ledger.count.

    windows: of the layers, in their order.
    steps: chip timesteps that a window stands for, those in which a layer only waits included.
    """

    def __init__(self, program: Program, windows: Sequence[Ran], steps: int) -> None:
        self.steps = steps
        self.timesteps, self.batch, _ = windows[0].spikes.shape
        self._program, self._windows = program, windows
        self._busy = [ActiveCount(window) for window in windows]

    def observe(self, output_spikes: Mapping[str, Raster]) -> WindowStats:
        """The windows that have just run, with the spikes of the input and of each layer."""
        overflows = running = None
        if not all([window.ordinary for window in self._windows]):
            overflows = [w.overflows * w.interpreted for w in self._windows]
            running = [not window.waiting for window in self._windows]
        per_axon = [raster.per_axon() for raster in output_spikes.values()]
        return WindowStats(per_axon, [busy() for busy in self._busy], overflows, running)

    def count(self, observations: Sequence[WindowStats]) -> Counts:
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
        presynaptic = [(synapses, spikes[synapses.source]) for synapses in layer.synapses]
        spike_in = sum(rows.sum(axis=1, dtype=np.int64) for _, rows in presynaptic)
        spike_out = spikes[layer.name].sum(axis=1, dtype=np.int64)
        always_on = self.timesteps * running
        to_host = spike_out * (layer.name in self._program.to_host)
        return {
            "spike_in": spike_in,
            # float64 is exact up to 2**53, and has the matrix product that int64 lacks
            "sop": sum(
                (rows @ s.fan_out.astype(np.float64)).astype(np.int64) for s, rows in presynaptic
            ),
            "bias_sop": always_on * layer.bias_fan_out,
            "spike_out": spike_out,
            "message": spike_in + always_on * (layer.bias_fan_out > 0) + to_host,
        }

    def _rows(self, values: Sequence[Any]) -> Counts:
        """Values of observations, layers and batch as rows (S, L)."""
        layers = len(self._program.layers)
        shaped = np.array(values, np.int64).reshape(-1, layers, self.batch)
        return np.asarray(shaped.swapaxes(1, 2).reshape(-1, layers))


class ActiveCount:
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


Rows = Literal["each", "total", "none"]

# observations that wait to be counted: many are counted in little more time than one
PENDING = 64


class LedgerBuilder:
    """Rows of counts, from observations that are counted when there are enough of them.

    rows: "each" keeps a row per control step; "total" adds them up; "none" keeps nothing.
    """

    def __init__(self, program: Program, rows: Rows = "each") -> None:
        if rows not in get_args(Rows):
            raise ConfigError(f"ledger {rows!r} is unknown. Choose 'each', 'total' or 'none'.")
        self.rows = rows
        self._program = program
        self._counts = np.zeros((1, len(program.layers), len(EVENTS)), np.int64)
        self._used = self._inferences = self._timesteps = self._steps = 0
        self._pending: list[WindowStats] = []
        self._tally: EventCounter | None = None

    @property
    def keeps(self) -> bool:
        """Whether it wants to know anything."""
        return self.rows != "none"

    def observe(self, tally: EventCounter, seen: WindowStats) -> None:
        """Take the observation of one inference, or step, of each of a batch."""
        if tally is not self._tally:
            self._count()
            self._tally = tally
        self._pending.append(seen)
        if len(self._pending) * tally.batch >= PENDING:
            self._count()

    def add(self, counts: Counts, timesteps: int, steps: int) -> None:
        """Take counts (S, L, E); each row took so many timesteps of a layer and of the chip."""
        self._count()
        self._append(counts, timesteps, steps)

    def ledger(self) -> Ledger:
        """Everything recorded so far."""
        self._count()
        return Ledger(
            layers=tuple(layer.name for layer in self._program.layers),
            neurons=tuple(layer.size for layer in self._program.layers),
            counts=self._counts[: self._used].copy(),
            inferences=self._inferences,
            timesteps=self._timesteps,
            steps=self._steps,
            several=self._program.chip.spikes_max > 1,
        )

    def _count(self) -> None:
        if self._tally and self._pending:
            pending, self._pending = self._pending, []
            self._append(self._tally.count(pending), self._tally.timesteps, self._tally.steps)

    def _append(self, counts: Counts, timesteps: int, steps: int) -> None:
        rows = len(counts)
        self._inferences += rows
        self._timesteps += rows * timesteps
        self._steps += rows * steps
        if self.rows == "total":
            # into memory that is there: a machine may come by a thousand times a second
            for row in counts:
                np.add(self._counts[0], row, self._counts[0])
            self._used = 1
            return
        end = self._used + len(counts)
        if end > len(self._counts):
            grown = np.zeros((2 * end, *self._counts.shape[1:]), np.int64)
            grown[: self._used] = self._counts[: self._used]
            self._counts = grown
        self._counts[self._used : end] = counts
        self._used = end
