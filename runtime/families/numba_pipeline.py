"""The Numba backend that families share: a program in the memory that the compiled kernels take."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.chips.layer import Layer, Recording, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.copies import NotCopyable
from spikedeploy.runtime.emulator.backend import (
    SavedState,
    Schedule,
    aligned_copy,
    aligned_zeros,
    check_counts,
    not_spikes,
    unsupported_synapses,
)
from spikedeploy.runtime.emulator.ledger import EVENTS, LedgerBuilder
from spikedeploy.runtime.families import numba_frame as frame
from spikedeploy.runtime.families.numba_frame import Constants, Kernel, Memory

Numbers = NDArray[Any]
Delays = tuple[tuple[int, ...], ...]

EXACT_INT16 = (1 << 15) - 1  # largest whole number that 16 bits hold


def edges(register: Register) -> tuple[int, int] | None:
    """Least and largest number of a register that holds these for any beyond; None of others."""
    none = np.iinfo(np.int64)
    if register.overflow == "none" and register.between is None:
        return int(none.min), int(none.max)
    if register.overflow not in ("clip", "saturate"):
        return None
    low, high = register.fit(np.array([none.min >> 1, none.max >> 1])).tolist()
    return low, high


def describe_register(register: Register) -> tuple[int, int, int, int]:
    """Entries of Constants.rules, as `fit` of the frame reads them."""
    if (held := edges(register)) is not None:
        return frame.CLAMP, register.bits, *held
    wraps = frame.WRAP if register.overflow == "wrap" else frame.WRAP_ONCE
    return wraps, register.bits, 0, 0


class FamilyNumbers(NamedTuple):
    """The part of a program's Constants that is a family's own.

    columns: of each layer, behind those of all families.
    weights: number type of weights.
    states: number type of states.
    sums: number types of the narrow and the wide sums.
    rules, neurons, floats: as in Constants; rules without the first.
    """

    columns: Sequence[Sequence[int]]
    weights: DTypeLike
    states: DTypeLike
    sums: tuple[DTypeLike, DTypeLike]
    rules: Sequence[int]
    neurons: Numbers
    floats: Numbers = np.zeros((0, 0))


@lru_cache(maxsize=8)
def constants(
    pipeline: type["NumbaPipeline"], program: Program, delays: Delays, windows: bool
) -> tuple[Constants, FamilyNumbers]:
    """The program as arrays, shared by its machines: all that does not change while it runs.

    delays: rows by which each synapse of each layer delivers late.
    windows: whether what runs are windows, in which biases may start late, or single timesteps.
    """
    layers, own = program.layers, pipeline.numbers(program)
    synapses = [s for layer in layers for s in layer.synapses]
    index = {name: k for k, name in enumerate(program.sizes)}
    # the lag of each synapse, and where its weights and its axons begin
    lags = [lag for of_layer in delays for lag in of_layer]
    weights = np.cumsum([0, *(s.weight.size for s in synapses)]).tolist()
    axons = np.cumsum([0, *(len(s.fan_out) for s in synapses)]).tolist()
    tables: list[Numbers] = [s.fan_out for s in synapses]
    wires = [
        (
            index[s.source],
            lags[k],
            weights[k],
            axons[k],
            s.window is not None,
            *describe(s.window, tables),
        )
        for k, s in enumerate(synapses)
    ]
    remembered = dict.fromkeys(program.sizes, 0)
    remembered[program.output] = program.readout.lag if program.readout else 0
    for s, lag in zip(synapses, lags, strict=True):
        remembered[s.source] = max(remembered[s.source], lag)
    rows, neurons, first = [], 0, 0
    for layer, columns in zip(layers, own.columns, strict=True):
        end = first + len(layer.synapses)
        output, run_rows = layer.name in program.output_layers, program.rows(1)
        window = program.window(layer, run_rows) if windows else slice(0, run_rows)
        rows.append(
            (
                layer.size,
                neurons,
                0,
                pipeline.states_of_neuron * layer.size,
                first,
                end,
                layer.start,
                weights[-1] + neurons,
                layer.bias_fan_out,
                output,
                layer.size if output and not layer.spiking else 0,
                layer.name == program.output,
                window.start,
                run_rows - window.stop,
                *columns,
            )
        )
        neurons, first = neurons + layer.size, end
    # biases that are no whole numbers are added by their family
    biases = [a.bias if a.bias.dtype.kind == "i" else 0 * a.bias for a in layers]
    made = Constants(
        weights=aligned_copy(np.concatenate([*map(_packed, synapses), *biases]), own.weights),
        tables=np.concatenate(tables),
        wires=np.array(wires, np.int64),
        layers=np.array(rows, np.int64),
        # without places in memory, which depend on the timesteps
        sources=np.array([(n, remembered[name], 0, 0) for name, n in program.sizes.items()]),
        rules=np.array([program.chip.input_spikes_max, *own.rules], np.int64),
        neurons=own.neurons,
        floats=own.floats,
    )
    return made, own


def largest_weight(layers: Sequence[Layer]) -> int:
    """The largest magnitude of a weight or a bias."""
    values = [v for layer in layers for v in (layer.bias, *(s.weight for s in layer.synapses))]
    return max(int(np.abs(v.astype(np.int64)).max(initial=0)) for v in values)


def _packed(synapses: Synapses) -> Numbers:
    """The weights as the kernels read them, one after another."""
    if (window := synapses.window) is None:
        return synapses.weight.ravel()
    # (G, O / G, I, ky, kx) to (G, I, ky, kx, O / G)
    parted = synapses.weight.reshape(window.groups, -1, *synapses.weight.shape[1:])
    return np.ascontiguousarray(np.moveaxis(parted, 1, -1)).ravel()


def describe(window: Window | None, tables: list[Numbers]) -> list[int]:
    """Columns of a wire from SOURCE_Y on; what rows and columns reach is put into the tables."""
    if window is None:
        return [0] * (len(frame.WIRE) - frame.SOURCE_Y)
    (channels, height, width), (features, target_y, target_x) = window.source, window.target
    starts = []
    for table, extent, pool in zip(window.reach, (height, width), window.pool, strict=True):
        starts.append(sum(map(len, tables)))
        # of the source as it sends: rows that a pool leaves over reach nothing
        whole = np.full((extent, table.shape[1]), -1, np.int64)
        whole[: len(table) * pool] = table.repeat(pool, axis=0)
        tables.append(whole.ravel())
    of_group = channels // window.groups, features // window.groups
    return [height, width, *starts, *window.kernel, *of_group, features, target_y, target_x]


class NumbaPipeline(NotCopyable, ABC):
    """A program as a Backend, in memory for windows of T timesteps of B.

    states_of_neuron: its membrane is the last.
    recorded: number type of recordings.
    kernel: runs a window of every layer; False where the input held too many spikes.
    """

    states_of_neuron: ClassVar[int]
    recorded: ClassVar[DTypeLike] = np.int64
    kernel: ClassVar[Kernel]
    instead = "Copy the Machine."

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None:
        self.schedule = schedule
        self._batch, timesteps = batch, schedule.timesteps
        self._names = [layer.name for layer in program.layers]
        self._most = program.chip.input_spikes_max
        known, own = constants(type(self), program, schedule.delays, schedule.mode != "step")
        # of each state; with a trace those after each timestep, else two that are used in turn
        self._slots = timesteps + 1 if schedule.trace else 2
        self._layers, self._sources = known.layers.copy(), known.sources.copy()
        neurons = self._sources[:, frame.NEURONS]
        rows = self._sources[:, frame.REMEMBERS] + timesteps
        widths = self._slots * self._layers[:, frame.WIDTH]
        self._layers[:, frame.STATE], states = _compute_offsets(widths)
        self._sources[:, frame.RASTER], spikes = _compute_offsets(neurons * rows)
        self._sources[:, frame.LENGTHS], lengths = _compute_offsets(rows)
        sizes = self._layers[:, frame.SIZE]
        narrow, wide = (aligned_zeros((2, int(sizes.max())), dtype) for dtype in own.sums)
        self._memory = Memory(
            rasters=np.zeros((batch, spikes), np.uint8),
            lists=np.zeros((batch, spikes), np.int32),
            lengths=np.zeros((batch, lengths), np.int64),
            states=aligned_zeros((batch, states), own.states),
            refractory=np.zeros((batch, int(sizes.sum())), np.int64),
            counts=np.zeros((batch, len(self._layers), len(EVENTS)), np.int64),
            narrow=narrow,
            wide=wide,
        )
        self._output = np.zeros((timesteps, batch, program.layer(program.output).size))
        self._input = self._rows(0)
        # without a trace there is one timestep, whose states have become those of now
        after = slice(1, None) if schedule.trace else slice(1)
        self._membranes: dict[str, Numbers] = {
            name: self._states(k)[:, after, -1].swapaxes(0, 1) for k, name in enumerate(self._names)
        }
        self._fresh = True
        lag = program.readout.lag if program.readout else 0
        self._arguments = (
            *known._replace(layers=self._layers, sources=self._sources),
            *self._memory,
            *(self._output, self._slots, lag, schedule.steps),
        )
        self._flags = (schedule.mode == "row", schedule.counting)
        # of a whole window from zero, which is what most calls ask for
        self._anew = (*self._arguments, -1, *self._flags, True)

    @staticmethod
    @abstractmethod
    def numbers(program: Program) -> FamilyNumbers:
        """Return the family's own numbers of a program."""

    @staticmethod
    def both(states: Numbers) -> tuple[Numbers, Numbers]:
        """Current and membrane; neurons without a current have one of 0."""
        current = states[0] if len(states) > 1 else np.zeros_like(states[0])
        return current, states[-1]

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        if obstacle := unsupported_synapses(program):
            return obstacle
        if find_spec("numba") is None:
            return "Numba is not installed. In the checkout of spikedeploy: pip install '.[fast]'."
        return None

    def reset(self) -> None:
        """Forget every current, membrane and spike."""
        self._fresh = True

    def run(self, rows: Numbers, step: int | None = None) -> NDArray[np.float64]:
        """Spikes (T, B, N) as they reach the readout, from those of the input (T, B, M)."""
        if rows.dtype.itemsize > 1:
            check_counts(rows, self._most)
        # a view, for numbers of one type are copied ten times faster than those of two
        values = rows.view(np.uint8) if rows.dtype.itemsize == 1 else rows
        self._input[...] = values.swapaxes(0, 1)
        arguments = self._anew
        if step is not None or not self._fresh:
            arguments = (*self._arguments, -1 if step is None else step, *self._flags, self._fresh)
        if not self.kernel(*arguments):
            raise not_spikes(rows, self._most)
        self._fresh = False
        return self._output

    def report(self, ledger: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""
        ledger.add(self._memory.counts, self.schedule.timesteps, self.schedule.steps)

    def recordings(self) -> dict[str, Recording]:
        """A recording of the last window of each layer."""
        recordings = {}
        for k, name in enumerate(self._names):
            # (B, T + 1, states, N) to (states, B, T, N)
            states = self._states(k)[:, 1:].transpose(2, 0, 1, 3).astype(self.recorded, "C")
            recordings[name] = Recording(*self.both(states), self._rows(k + 1).copy())
        return recordings

    def membranes(self, layer: str) -> Numbers:
        """Membranes (T, B, N) of a layer after each timestep of the last window [state units]."""
        return self._membranes[layer]

    def spikes(self, layer: str) -> Numbers:
        """Spikes (T, B, N) of a layer in the last window."""
        return np.asarray(self._rows(self._names.index(layer) + 1).swapaxes(0, 1))

    def states(self) -> dict[str, tuple[Numbers, Numbers]]:
        """Current and membrane (B, N) of each layer."""
        now = [self._states(k)[:, 0].astype(self.recorded) for k in range(len(self._names))]
        return {
            name: self.both(states.swapaxes(0, 1))
            for name, states in zip(self._names, now, strict=True)
        }

    def saved(self) -> SavedState:
        """Copies of all states, and of the spikes that have not arrived yet."""
        # a reset waits for the next window
        return {} if self._fresh else {name: each.copy() for name, each in self._kept().items()}

    def restore(self, saved: SavedState) -> None:
        """Continue from there; T may be another."""
        self._fresh = not saved
        for name, values in saved.items():
            self._kept()[name][...] = values

    def _kept(self) -> dict[str, Numbers]:
        """Views of the states now, and of the rows of sources that have not arrived."""
        kept: dict[str, Numbers] = {"refractory": self._memory.refractory}
        for k in range(len(self._names)):
            kept[f"states {k}"] = self._states(k)[:, 0]
        for k, (_, past, _, at) in enumerate(self._sources):
            kept[f"rasters {k}"] = self._split(self._memory.rasters, k)[:, :past]
            kept[f"lists {k}"] = self._split(self._memory.lists, k)[:, :past]
            kept[f"lengths {k}"] = self._memory.lengths[:, at : at + past]
        return kept

    def _states(self, layer: int) -> Numbers:
        """(B, slots, states of a neuron, N)."""
        width, at = self._layers[layer, [frame.WIDTH, frame.STATE]]
        flat: Numbers = self._memory.states[:, at : at + self._slots * width]
        return flat.reshape(self._batch, self._slots, self.states_of_neuron, -1)

    def _rows(self, source: int) -> Numbers:
        """(B, T, N) spikes of a source in the window."""
        return self._split(self._memory.rasters, source)[:, -self.schedule.timesteps :]

    def _split(self, array: Numbers, source: int) -> Numbers:
        """(B, remembered + T, N) of the rasters or of the lists."""
        size, past, at, _ = self._sources[source]
        rows = past + self.schedule.timesteps
        return array[:, at : at + rows * size].reshape(self._batch, rows, size)


def _compute_offsets(sizes: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """The first index of each block, and the size of all."""
    ends = np.cumsum(sizes)
    return ends - sizes, int(ends[-1])
