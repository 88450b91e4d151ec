"""The Numba backend: a program as the arrays that the compiled kernels take, and their memory."""

from functools import lru_cache
from importlib.util import find_spec
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.registers import magnitude
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import Recording, SavedState, Schedule, not_spikes
from spikedeploy.runtime.emulator.ledger import EVENTS, LedgerBuilder
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.numba_kernels import (
    LENGTHS,
    NEURONS,
    OVERFLOWS,
    RASTER,
    REMEMBERS,
    SIZE,
    STATE,
    Constants,
    Memory,
    run,
)
from spikedeploy.runtime.families.cuba.numpy_backend import (
    EXACT_INT16,
    aligned_copy,
    aligned_zeros,
    unsupported_synapses,
)
from spikedeploy.runtime.families.cuba.quantise import bounds, register_limit

Numbers = NDArray[Any]
Delays = tuple[tuple[int, ...], ...]

_EXACT_INT8 = (1 << 7) - 1
# bits of every whole number that float64 holds
_EXACT_BITS = 53


@lru_cache(maxsize=8)
def constants(program: Program, fixed: CubaFixedPoint, delays: Delays, windows: bool) -> Constants:
    """All that does not change while the program runs; shared by its machines.

    delays: rows by which each synapse of each layer delivers late.
    windows: whether what runs are windows, in which biases may start late, or single timesteps.
    """
    layers, shift = program.layers, fixed.mantissa_shift
    synapses = [s for layer in layers for s in layer.synapses]
    # largest magnitude of three that are added, so that float64 decays their sum exactly
    exact = 1 << (_EXACT_BITS - 2 - fixed.decay_bits)
    room = [min(register_limit(register), exact) for register in (fixed.current, fixed.membrane)]
    index = {name: k for k, name in enumerate(program.sizes)}
    # the lag of each synapse, and where its weights and its axons begin
    lags = [lag for of_layer in delays for lag in of_layer]
    weights = np.cumsum([0, *(s.weight.size for s in synapses)]).tolist()
    axons = np.cumsum([0, *(len(s.weight) for s in synapses)]).tolist()
    wires = [(index[s.source], lags[k], weights[k], axons[k]) for k, s in enumerate(synapses)]
    remembered = dict.fromkeys(program.sizes, 0)
    remembered[program.output] = program.readout.lag if program.readout else 0
    for s, lag in zip(synapses, lags, strict=True):
        remembered[s.source] = max(remembered[s.source], lag)
    whole = np.concatenate(
        [
            np.stack([a.current_decay, a.membrane_decay, a.threshold, a.voltage_bias])
            for a in layers
        ],
        axis=1,
    ).astype(np.int64)
    real = whole * np.array([[1 / fixed.decay_one]] * 2 + [[1.0]] * 2)
    # in float32 a layer of 512 neurons fits the nearest cache
    single = aligned_copy(real, np.float32)
    all_ = np.concatenate([*(s.weight.ravel() for s in synapses), *(a.bias for a in layers)])
    limits = [bounds(program, layer, fixed, None) for layer in layers]
    largest = max(int(np.abs(all_.astype(np.int64)).max()), max(a.partial for a in limits) >> 16)
    registers = [(OVERFLOWS[r.overflow], r.bits) for r in _registers(fixed)]
    subtract = program.convention.reset == "subtract"
    rows, neurons, first = [], 0, 0
    for layer, limit in zip(layers, limits, strict=True):
        end, bias = first + len(layer.synapses), magnitude(layer.voltage_bias.astype(np.int64))
        # where a timestep could overflow the accumulator, or hide an inexact decay; where it
        # cannot, a sum that float64 may hold was made from a decay that it computed exactly
        too_much = limit.drive > register_limit(fixed.accumulator)
        too_much |= max(limit.drive, bias) > exact
        proven = max(limit.current, limit.above, limit.below) <= min(room)
        output, run_rows = layer.name in program.to_host, program.rows(1)
        window = program.window(layer, run_rows) if windows else slice(0, run_rows)
        rows.append(
            (
                layer.size,
                neurons,
                0,
                first,
                end,
                limit.partial <= EXACT_INT16,
                fixed.refractory > 1 or too_much,
                layer.start,
                weights[-1] + neurons,
                layer.bias_fan_out,
                output,
                not layer.current_decay.any(),
                proven,
                layer.size if output and not layer.spiking else 0,
                layer.name == program.output,
                window.start,
                run_rows - window.stop,
            )
        )
        neurons, first = neurons + layer.size, end
    return Constants(
        # the smallest that hold them, for fetching them takes longest
        weights=aligned_copy(all_, _weight_type(largest)),
        fan_out=np.concatenate([s.fan_out for s in synapses]),
        wires=np.array(wires, np.int64),
        layers=np.array(rows, np.int64),
        # without places in memory, which depend on the timesteps
        sources=np.array([(n, remembered[name], 0, 0) for name, n in program.sizes.items()]),
        chip=np.array([shift, fixed.decay_bits, fixed.refractory, subtract], np.int64),
        registers=np.array(registers, np.int64),
        whole=whole,
        real=single if (single == real).all() else aligned_copy(real, np.float64),
        rooms=np.array([1 << shift, *room], np.float64),
    )


def _weight_type(largest: int) -> Any:  # noqa: ANN401
    return np.int8 if largest <= _EXACT_INT8 else np.int16 if largest <= EXACT_INT16 else np.int64


def _registers(fixed: CubaFixedPoint) -> tuple[Any, ...]:
    return fixed.accumulator, fixed.current, fixed.membrane


class NumbaPipeline:
    """CuBa-LIF layers with integers as a Backend, in memory for windows of T timesteps of B."""

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None:
        self.schedule = schedule
        self._batch, timesteps = batch, schedule.timesteps
        self._names = [layer.name for layer in program.layers]
        fixed = cast("CubaFixedPoint", program.chip.arithmetic)
        known = constants(program, fixed, schedule.delays, schedule.mode != "step")
        # of each state; with a trace those after each timestep, else two that are used in turn
        self._slots = timesteps + 1 if schedule.trace else 2
        layers, sources = known.layers.copy(), known.sources.copy()
        neurons, rows = sources[:, NEURONS], sources[:, REMEMBERS] + timesteps
        layers[:, STATE], states = _compute_offsets(2 * self._slots * layers[:, SIZE])
        sources[:, RASTER], spikes = _compute_offsets(neurons * rows)
        sources[:, LENGTHS], lengths = _compute_offsets(rows)
        self._constants = known._replace(layers=layers, sources=sources)
        widest, is_short = int(layers[:, SIZE].max()), known.weights.dtype != np.int64
        self._memory = Memory(
            rasters=np.zeros((batch, spikes), np.uint8),
            lists=np.zeros((batch, spikes), np.int32),
            lengths=np.zeros((batch, lengths), np.int64),
            states=aligned_zeros((batch, states), np.float64),
            refractory=np.zeros((batch, int(layers[:, SIZE].sum())), np.int64),
            counts=np.zeros((batch, len(layers), len(EVENTS)), np.int64),
            narrow=aligned_zeros((widest,), np.int16 if is_short else np.int64),
            wide=aligned_zeros((widest,), np.int32 if is_short else np.int64),
        )
        self._presynaptic = np.zeros((timesteps, batch, program.layer(program.output).size))
        self._input = self._rows(0)
        # without a trace there is one timestep, whose states have become those of now
        after = slice(1, None) if schedule.trace else slice(1)
        self._membranes: dict[str, Numbers] = {
            name: self._states(k)[:, after, 1].swapaxes(0, 1) for k, name in enumerate(self._names)
        }
        self._fresh = True
        lag = program.readout.lag if program.readout else 0
        numbers = (self._presynaptic, self._slots, lag, schedule.steps)
        self._arguments = (*self._constants, *self._memory, *numbers)
        self._flags = (schedule.mode == "row", schedule.counting)
        # of a whole window from zero, which is what most calls ask for
        self._anew = (*self._arguments, -1, *self._flags, True)

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        if obstacle := unsupported_synapses(program):
            return obstacle
        fixed = cast("CubaFixedPoint", program.chip.arithmetic)
        odd = any(r.overflow not in OVERFLOWS or r.between for r in _registers(fixed))
        if odd or fixed.push.overflow != "none":
            return (
                f"chip {program.chip.name!r} has a register that the compiled kernels do not know: "
                "one that saturates, has a narrower range, or holds the push."
            )
        if find_spec("numba") is None:
            return "Numba is not installed. In the checkout of spikedeploy: pip install '.[fast]'."
        return None

    def reset(self) -> None:
        """Forget every current, membrane and spike."""
        self._fresh = True

    def run(self, rows: Numbers, step: int | None = None) -> NDArray[np.float64]:
        """Spikes (T, B, N) as they reach the readout, from those of the input (T, B, M)."""
        # a view, for numbers of one type are copied ten times faster than those of two
        values = rows.view(np.uint8) if rows.dtype.itemsize == 1 else np.minimum(rows, 2)
        self._input[...] = values.swapaxes(0, 1)
        arguments = self._anew
        if step is not None or not self._fresh:
            arguments = (*self._arguments, -1 if step is None else step, *self._flags, self._fresh)
        if not run(*arguments):
            raise not_spikes(rows)
        self._fresh = False
        return self._presynaptic

    def report(self, ledger: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""
        ledger.add(self._memory.counts, self.schedule.timesteps, self.schedule.steps)

    def recordings(self) -> dict[str, Recording]:
        """A recording of the last window of each layer."""
        recordings = {}
        for k, name in enumerate(self._names):
            # (B, T + 1, 2, N) to (2, B, T, N)
            states = self._states(k)[:, 1:].transpose(2, 0, 1, 3)
            current, membrane = states.astype(np.int64)
            recordings[name] = Recording(current, membrane, self._rows(k + 1).copy())
        return recordings

    def membranes(self, layer: str) -> Numbers:
        """Membranes (T, B, N) of a layer after each timestep of the last window [state units]."""
        return self._membranes[layer]

    def spikes(self, layer: str) -> Numbers:
        """Spikes (T, B, N) of a layer in the last window."""
        return np.asarray(self._rows(self._names.index(layer) + 1).swapaxes(0, 1))

    def states(self) -> dict[str, tuple[Numbers, Numbers]]:
        """Current and membrane (B, N) of each layer."""
        both = [self._states(k)[:, 0].astype(np.int64) for k in range(len(self._names))]
        return {name: (now[:, 0], now[:, 1]) for name, now in zip(self._names, both, strict=True)}

    def saved(self) -> SavedState:
        """Copies of all states, and of the spikes that have not arrived yet."""
        # a reset waits for the next window
        return {} if self._fresh else {name: each.copy() for name, each in self._kept().items()}

    def restore(self, saved: SavedState) -> None:
        """Go on from there; T may be another."""
        self._fresh = not saved
        for name, values in saved.items():
            self._kept()[name][...] = values

    def _kept(self) -> dict[str, Numbers]:
        """Views of the states now, and of the rows of sources that have not arrived."""
        kept: dict[str, Numbers] = {"refractory": self._memory.refractory}
        for k in range(len(self._names)):
            kept[f"states {k}"] = self._states(k)[:, 0]
        for k, (_, past, _, at) in enumerate(self._constants.sources):
            kept[f"rasters {k}"] = self._split(self._memory.rasters, k)[:, :past]
            kept[f"lists {k}"] = self._split(self._memory.lists, k)[:, :past]
            kept[f"lengths {k}"] = self._memory.lengths[:, at : at + past]
        return kept

    def _states(self, layer: int) -> Numbers:
        """(B, slots, 2, N) current and membrane."""
        size, at = self._constants.layers[layer, [SIZE, STATE]]
        flat: Numbers = self._memory.states[:, at : at + 2 * self._slots * size]
        return flat.reshape(self._batch, self._slots, 2, size)

    def _rows(self, source: int) -> Numbers:
        """(B, T, N) spikes of a source in the window."""
        return self._split(self._memory.rasters, source)[:, -self.schedule.timesteps :]

    def _split(self, array: Numbers, source: int) -> Numbers:
        """(B, remembered + T, N) of the rasters or of the lists."""
        size, past, at, _ = self._constants.sources[source]
        rows = past + self.schedule.timesteps
        return array[:, at : at + rows * size].reshape(self._batch, rows, size)


def _compute_offsets(sizes: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """The first index of each block, and the size of all."""
    ends = np.cumsum(sizes)
    return ends - sizes, int(ends[-1])
