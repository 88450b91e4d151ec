"""The NumPy backend: every layer's window, one after another, and the events of windows."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import (
    Recording,
    SavedState,
    Schedule,
    check_counts,
    concatenate_recordings,
)
from spikedeploy.runtime.emulator.ledger import EVENTS, Counts, LedgerBuilder
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.numpy_kernels import (
    LayerKernel,
    Raster,
    Scratch,
)


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
        self, program: Program, kernels: Sequence[LayerKernel], steps: int, heard: Sequence[int]
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
        """Events that follow from the spikes (S, N) of neurons, and the timesteps (S,) heard."""
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

    def __init__(self, kernel: LayerKernel) -> None:
        self._kernel = kernel
        voltage_bias = kernel.layer.voltage_bias
        self._bias_rows = voltage_bias != 0 if voltage_bias.any() else None
        self._nonzero = np.empty(kernel.states.shape, np.bool_)
        self._current, self._membrane_before = self._nonzero[1:, 0], self._nonzero[:-1, 1]
        self._active = np.empty_like(kernel.spikes)

    def __call__(self) -> Any:  # noqa: ANN401
        """Of the last window, (B,); a number where the batch is 1."""
        active = self._active
        np.not_equal(self._kernel.states, 0.0, self._nonzero)
        np.logical_or(self._current, self._membrane_before, active)
        if self._bias_rows is not None:
            np.logical_or(active, self._bias_rows, active)
        if active.shape[1] == 1:
            return np.count_nonzero(active)
        return np.count_nonzero(active, axis=(0, 2))


_IDLE = EVENTS.index("neuron_idle")


class _DelayBuffer:
    """Spikes that were emitted in earlier timesteps and have not arrived yet.

    sizes: neurons of each source.
    longest: longest delay, in rows.
    """

    def __init__(self, sizes: dict[str, int], longest: int, batch: int) -> None:
        self._longest = longest
        self._tails = {name: np.zeros((longest, batch, n), np.uint8) for name, n in sizes.items()}

    def reset(self) -> None:
        """Forget the spikes that have not arrived."""
        if self._longest:
            for tail in self._tails.values():
                tail.fill(0)

    def late_rows(
        self, source: str, delay: int, output_spikes: dict[str, Raster], timesteps: int
    ) -> Raster:
        """The T rows of a source that arrive in this window, at least one row late."""
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
        """Continue from there."""
        self._tails = {name: saved[name].copy() for name in self._tails}


class NumpyPipeline:
    """CuBa-LIF layers as a Backend; integers where the chip has them, else float64."""

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None:
        self.schedule = schedule
        self._program, self._batch = program, batch
        numbers = program.chip.arithmetic
        self._most = program.chip.input_spikes_max
        self._fixed = numbers if isinstance(numbers, CubaFixedPoint) else None
        # rows that a kernel runs at once
        self._rows = schedule.timesteps if schedule.mode == "window" else 1
        self._kernels = self._make_kernels()
        steps = schedule.steps if schedule.mode == "window" else 1
        heard = [len(range(self._rows)[self._bias_rows(a)]) for a in program.layers]
        self._counter = EventCounter(program, self._kernels, steps, heard)
        self._output_spikes: dict[str, Raster] = {}
        self._lag = program.readout.lag if program.readout else 0
        # a layer's kernel, and the sources of its synapses with the rows that they are late
        self._route = [
            (kernel.layer, kernel, list(zip(_sources(kernel.layer), delays, strict=True)))
            for kernel, delays in zip(self._kernels, schedule.delays, strict=True)
        ]
        longest = max(self._lag, *(max(delays) for delays in schedule.delays))
        self._buffer = _DelayBuffer(program.sizes, longest, batch)
        # of each row, where rows run one by one
        self._observed: list[WindowStats] = []
        self._recorded: list[dict[str, Recording]] = []

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        if program.clock == "free" and not program.feed_forward:
            for layer in program.layers:
                if layer.bias.any() or not layer.spiking:
                    return (
                        f"layer {layer.name!r}: its bias axon, or the host, has a window of its "
                        "own while layers run free; in a network with loops, which is computed "
                        "row by row, only the interpreter and Numba support that."
                    )
        return unsupported_synapses(program)

    def reset(self) -> None:
        """Forget every current, membrane and spike."""
        self._buffer.reset()
        if self.schedule.kept:
            for kernel in self._kernels:
                kernel.reset()

    def run(self, rows: NDArray[Any], step: int | None = None) -> NDArray[Any]:
        """Spikes (T, B, N) as they reach the readout, from those of the input (T, B, M)."""
        check_counts(rows, self._most)
        if self.schedule.mode == "row":
            return self._row_by_row(rows)
        return self._window(rows, step)

    def report(self, ledger: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""
        if self.schedule.mode != "row":
            ledger.observe(self._counter, self._counter.observe(self._output_spikes))
            return
        timesteps, steps = self.schedule.timesteps, self.schedule.steps
        counts = self._counter.count(self._observed)
        total = counts.reshape(timesteps, self._batch, -1, len(EVENTS)).sum(axis=0)
        total[:, :, _IDLE] += [(steps - timesteps) * a.size for a in self._program.layers]
        ledger.add(total, timesteps, steps)

    def recordings(self) -> dict[str, Recording]:
        """A recording of the last window of each layer."""
        return (
            concatenate_recordings(self._recorded, axis=1) if self._recorded else self._recordings()
        )

    def membranes(self, layer: str) -> NDArray[Any]:
        """Membranes (T, B, N) of a layer after each timestep of the last window [state units]."""
        if self._recorded:
            rows = [recording[layer].membrane[:, 0] for recording in self._recorded]
            return np.stack(rows)
        return next(each.states[1:, 1] for each in self._kernels if each.layer.name == layer)

    def spikes(self, layer: str) -> NDArray[Any]:
        """Spikes (T, B, N) of a layer in the last window."""
        if self._recorded:
            return np.stack([recording[layer].spikes[:, 0] for recording in self._recorded])
        return self._output_spikes[layer].rows

    def states(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        """Current and membrane (B, N) of each layer."""
        dtype = np.int64 if self._fixed else np.float64
        states = [(each.layer.name, each.states[-1].astype(dtype)) for each in self._kernels]
        return {name: (both[0], both[1]) for name, both in states}

    def saved(self) -> SavedState:
        """Copies of all states, and of the spikes that have not arrived yet."""
        saved = {f"spikes of {name}": rows for name, rows in self._buffer.saved().items()}
        for window in self._kernels:
            for name, values in window.saved().items():
                saved[f"{name} of {window.layer.name}"] = values
        return saved

    def restore(self, saved: SavedState) -> None:
        """Continue from there."""
        self._buffer.restore({name: saved[f"spikes of {name}"] for name in self._program.sizes})
        for window in self._kernels:
            of = f" of {window.layer.name}"
            window.restore({name: saved[name + of] for name in window.saved()})

    def _bias_rows(self, layer: Layer) -> slice:
        """Rows of a kernel's window in which the bias axon of a layer spikes."""
        whole = self.schedule.mode == "window"
        return self._program.window(layer, self._rows) if whole else slice(None)

    def _make_kernels(self) -> list[LayerKernel]:
        """A kernel for each layer; they share the memory that is needed only for a moment."""
        program, shape = self._program, (self._rows, self._batch)
        largest = max(s.weight.size for layer in program.layers for s in layer.synapses)
        scratch = Scratch(largest * np.dtype(np.float64).itemsize)
        return [
            LayerKernel(
                program,
                layer,
                self._fixed,
                shape,
                self.schedule.kept,
                scratch,
                self._bias_rows(layer),
            )
            for layer in program.layers
        ]

    def _window(self, rows: NDArray[Any], step: int | None) -> NDArray[Any]:
        """Run each layer once, for all rows."""
        output_spikes = {self._program.input: Raster(rows)}
        late_rows, timesteps = self._buffer.late_rows, self._rows
        for layer, kernel, synapses in self._route:
            if step is not None and step < layer.start:
                output_spikes[layer.name] = kernel.wait()
                continue
            # in most networks nothing is late
            presynaptic = [
                late_rows(source, delay, output_spikes, timesteps)
                if delay
                else output_spikes[source]
                for source, delay in synapses
            ]
            output_spikes[layer.name] = kernel.run(presynaptic)
        self._output_spikes = output_spikes
        spikes = output_spikes[self._program.output]
        if self._lag:
            spikes = late_rows(self._program.output, self._lag, output_spikes, timesteps)
        self._buffer.keep(output_spikes)
        return spikes.rows

    def _row_by_row(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Run all layers for one row after another, which closes loops."""
        self._observed, self._recorded, presynaptic = [], [], []
        for row in rows:
            # the kernels use their memory again for the next row
            presynaptic.append(self._window(row[None], None).copy())
            if self.schedule.counting:
                self._observed.append(self._counter.observe(self._output_spikes))
            if self.schedule.trace:
                self._recorded.append(self._recordings())
        return np.concatenate(presynaptic)

    def _recordings(self) -> dict[str, Recording]:
        """A recording of each layer's last run."""
        dtype = np.int64 if self._fixed else np.float64
        recordings = {}
        for window in self._kernels:
            # (T + 1, 2, B, N) to (2, B, T, N)
            current, membrane = window.states[1:].transpose(1, 2, 0, 3).astype(dtype)
            spikes = window.spikes.swapaxes(0, 1).astype(np.uint8)
            recordings[window.layer.name] = Recording(current, membrane, spikes)
        return recordings


def _sources(layer: Layer) -> list[str]:
    return [synapses.source for synapses in layer.synapses]


def unsupported_synapses(program: Program) -> str | None:
    """The reason why no kernel computes the program's synapses; None where kernels do."""
    for layer in program.layers:
        if layer.graded:
            return (
                f"layer {layer.name!r}: its sigma-delta neurons send graded spikes, which only "
                "the interpreter supports."
            )
        if any(synapses.shift for synapses in layer.synapses):
            return (
                f"layer {layer.name!r}: its weights have a negative exponent, by which "
                f"{program.chip.name} rounds sums, which only the interpreter supports."
            )
    return None
