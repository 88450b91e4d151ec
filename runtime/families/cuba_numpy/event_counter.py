"""The events of a window: observed while it is in memory, and counted later for many at once."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import SavedState
from spikedeploy.runtime.emulator.ledger import EVENTS, Counts
from spikedeploy.runtime.families.cuba_numpy.raster import Raster


class LayerWindow(Protocol):
    """What is left of the window of a layer, as in LayerKernel."""

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
        """Whether it ran, and not in the interpreter."""

    @property
    def waiting(self) -> bool:
        """Whether the layer had not started."""

    @property
    def interpreted(self) -> bool:
        """Whether the interpreter ran it."""

    @property
    def overflows(self) -> Any:  # noqa: ANN401
        """(B,) numbers that did not fit, where it was interpreted."""

    def saved(self) -> SavedState:
        """Copies of the states."""

    def restore(self, saved: SavedState) -> None:
        """Continue from there."""


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
    """Counts the events of windows; its counts are those of runtime.emulator.ledger.count.

    kernels: of the layers, in their order.
    steps: chip timesteps that a window stands for, those in which a layer only waits included.
    heard: of each layer the timesteps in which its bias axon spikes and the host listens to it.
    """

    def __init__(
        self, program: Program, kernels: Sequence[LayerWindow], steps: int, heard: Sequence[int]
    ) -> None:
        self.steps = steps
        self._heard = heard
        self.timesteps, self.batch, _ = kernels[0].spikes.shape
        self._program, self._kernels = program, kernels
        self._active = [_ActiveCount(kernel) for kernel in kernels]

    def observe(self, output_spikes: Mapping[str, Raster]) -> WindowStats:
        """The windows that have just run, with the spikes of the input and of each layer."""
        overflows = running = None
        if not all([kernel.ordinary for kernel in self._kernels]):
            overflows = [kernel.overflows * kernel.interpreted for kernel in self._kernels]
            running = [not kernel.waiting for kernel in self._kernels]
        per_axon = [raster.per_axon() for raster in output_spikes.values()]
        return WindowStats(per_axon, [active() for active in self._active], overflows, running)

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
            events = self._events(layer, spikes, self._heard[index] * running[:, index])
            events["neuron_update"] = updates[:, index] * running[:, index]
            events["neuron_idle"] = layer.size * self.steps - events["neuron_update"]
            events["saturation"] = overflows[:, index]
            events["graded_sop"] = 0 * updates[:, index]  # only the interpreter runs such layers
            events["lost_spike"] = 0 * updates[:, index]  # likewise
            counts[:, index] = np.stack([events[name] for name in EVENTS], axis=1)
        return counts

    def _events(
        self, layer: Layer, spikes: Mapping[str, NDArray[Any]], heard: Counts
    ) -> dict[str, Counts]:
        """What follows from the spikes (S, N) of each neuron, and the timesteps (S,) heard."""
        presynaptic = [(synapses, spikes[synapses.source]) for synapses in layer.synapses]
        spike_in = sum(rows.sum(axis=1, dtype=np.int64) for _, rows in presynaptic)
        spike_out = spikes[layer.name].sum(axis=1, dtype=np.int64)
        sent = spike_out if layer.spiking else heard * layer.size
        to_host = sent * (layer.name in self._program.to_host)
        return {
            "spike_in": spike_in,
            # float64 is exact up to 2**53, and has the matrix product that int64 lacks
            "sop": sum(
                (rows @ s.fan_out.astype(np.float64)).astype(np.int64) for s, rows in presynaptic
            ),
            "bias_sop": heard * layer.bias_fan_out,
            "spike_out": spike_out,
            "message": spike_in + heard * (layer.bias_fan_out > 0) + to_host,
        }

    def _rows(self, values: Sequence[Any]) -> Counts:
        """Values of observations, layers and batch as rows (S, L)."""
        layers = len(self._program.layers)
        shaped = np.array(values, np.int64).reshape(-1, layers, self.batch)
        return np.asarray(shaped.swapaxes(1, 2).reshape(-1, layers))


class _ActiveCount:
    """Counts neuron-timesteps with a membrane, a current or a bias to add up."""

    def __init__(self, kernel: LayerWindow) -> None:
        self._kernel = kernel
        voltage_bias = kernel.layer.voltage_bias
        self._biased = voltage_bias != 0 if voltage_bias.any() else None
        self._nonzero = np.empty(kernel.states.shape, np.bool_)
        self._current, self._membrane_before = self._nonzero[1:, 0], self._nonzero[:-1, 1]
        self._active = np.empty_like(kernel.spikes)

    def __call__(self) -> Any:  # noqa: ANN401
        """Of the last window, (B,); a number where the batch is 1."""
        active = self._active
        np.not_equal(self._kernel.states, 0.0, self._nonzero)
        np.logical_or(self._current, self._membrane_before, active)
        if self._biased is not None:
            np.logical_or(active, self._biased, active)
        if active.shape[1] == 1:
            return np.count_nonzero(active)
        return np.count_nonzero(active, axis=(0, 2))
