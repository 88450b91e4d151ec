"""A program and the memory that it runs in, as the arrays that the compiled kernels take."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import SavedState
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.numpy_backend import EXACT_INT16, aligned, as_aligned
from spikedeploy.runtime.families.cuba.quantise import bounds, register_limit

Array = Any  # the compiler sees the types
Number = Any

# events, in the order of runtime.emulator.ledger.EVENTS
(
    SPIKE_IN, SOP, BIAS_SOP, UPDATE, IDLE, SPIKE_OUT, MESSAGE, SATURATION, GRADED_SOP, LOST_SPIKE,
) = range(10)  # fmt: skip

# columns of Constants.layers; STATE is where the layer's states begin in a row of
# KernelMemory.states, BIAS where its biases begin in Constants.weights; of a layer with NO_CURRENT
# nothing stays of a current, of one that is PROVEN no number can be too large, and one IN_INTEGERS
# is always computed in int64; of each layer that IS_OUTPUT the spikes leave the chip, and in each
# timestep so many membranes as are READ, and the one that LEAVES is what the kernel puts out; the
# bias axon of a layer is silent, and the host deaf to it, in HEAD rows first and in TAIL rows last
SIZE, NEURON, STATE, FIRST_WIRE, LAST_WIRE, SUM_BITS, IN_INTEGERS, START = range(8)
BIAS, BIAS_FAN_OUT, IS_OUTPUT, NO_CURRENT, PROVEN, READ, LEAVES, HEAD, TAIL = range(8, 17)
# columns of Constants.wires
SOURCE, LAG, WEIGHT, FAN_OUT = range(4)
# columns of Constants.sources; NEURONS of each, rows that it REMEMBERS, where its RASTER and its
# LENGTHS begin in a row of the memory
NEURONS, REMEMBERS, RASTER, LENGTHS = range(4)
# entries of Constants.chip
SHIFT, DECAY_BITS, REFRACTORY, SUBTRACT = range(4)
# rows of Constants.whole and of Constants.real
CURRENT_DECAY, MEMBRANE_DECAY, THRESHOLD, VOLTAGE_BIAS = range(4)
# columns of Constants.rooms
UNIT, ROOM_CURRENT, ROOM_MEMBRANE = range(3)
# what a register does, in Constants.registers with its bits
NONE, WRAP, WRAP_ONCE, CLIP = range(4)


class Constants(NamedTuple):
    """A program as arrays; those of its layers and synapses one after another.

    weights: (W,) mantissas, axon-major, and then the biases.
    fan_out: (A,) of each axon of each synapses.
    wires, layers, sources: a row for each, columns above; source 0 is the input, k + 1 layer k.
    chip: entries above.
    registers: (3, 2) what accumulator, current and membrane do, and their bits.
    whole: (4, N) rows above; decay factors in 1 / 2**decay_bits.
    real: (4, N) the same for float64; decay factors as fractions.
    rooms: (L, 3) columns above [state units].
    """

    weights: Array
    fan_out: Array
    wires: Array
    layers: Array
    sources: Array
    chip: Array
    registers: Array
    whole: Array
    real: Array
    rooms: Array


class KernelMemory(NamedTuple):
    """Memory of a program, a row for each of the batch.

    rasters: (B, R) of each source the rows that are still on their way, then those of the window.
    lists: (B, R) of each of those rows the axons that spiked.
    lengths: (B, Q) how many.
    states: (B, K) of each layer slots of current and membrane, used in turn; slot 0 is now.
    refractory: (B, N) timesteps of refractory left.
    sums16, sums32, sums64: (N,) what arrives in a timestep.
    """

    rasters: Array
    lists: Array
    lengths: Array
    states: Array
    refractory: Array
    sums16: Array
    sums32: Array
    sums64: Array


class KernelNeurons(NamedTuple):
    """The part of Constants that a timestep of a layer in float64 needs."""

    decay_current: Array
    decay_membrane: Array
    threshold: Array
    bias: Array
    unit: Number
    room_current: Number
    room_membrane: Number
    subtract: Number
    watched: Number


Integers = NDArray[np.int64]

_EXACT_INT8 = (1 << 7) - 1
_EXACT_INT32 = (1 << 31) - 1
# bits of every whole number that float64 holds
_EXACT_BITS = 53

# what registers may do when a number does not fit, of all that a Register can
OVERFLOWS = {
    "none": NONE,
    "wrap": WRAP,
    "wrap-once": WRAP_ONCE,
    "clip": CLIP,
}


@lru_cache(maxsize=8)
def constants(
    program: Program, fixed: CubaFixedPoint, delays: tuple[tuple[int, ...], ...], windows: bool
) -> Constants:
    """All that does not change while the program runs; shared by its machines.

    delays: rows by which each synapse of each layer delivers late.
    windows: whether what runs are windows, in which biases may start late, or single timesteps.
    """
    return Constants(
        weights=_weights(program),
        fan_out=np.concatenate([s.fan_out for a in program.layers for s in a.synapses]),
        wires=_wires(program, delays),
        layers=_layers(program, fixed, windows),
        sources=_sources(program, delays),
        chip=_chip(program, fixed),
        registers=_registers(fixed),
        whole=_stack_integers(program),
        real=_real(program, fixed),
        rooms=np.array([_rooms(fixed)] * len(program.layers)),
    )


def _weights(program: Program) -> NDArray[Any]:
    """(W,) in the smallest integers that hold them."""
    weights = [s.weight.ravel() for layer in program.layers for s in layer.synapses]
    all_ = np.concatenate([*weights, *(layer.bias for layer in program.layers)])
    largest = int(np.abs(all_.astype(np.int64)).max(initial=0))
    return as_aligned(all_, np.int8 if largest <= _EXACT_INT8 else _whole_type(largest))


def _whole_type(largest: int) -> Any:  # noqa: ANN401
    return np.int16 if largest <= EXACT_INT16 else np.int32 if largest <= _EXACT_INT32 else np.int64


def _wires(program: Program, delays: tuple[tuple[int, ...], ...]) -> Integers:
    index = {name: k for k, name in enumerate(program.sizes)}
    rows, weights, axons = [], 0, 0
    for layer, lags in zip(program.layers, delays, strict=True):
        for synapses, lag in zip(layer.synapses, lags, strict=True):
            rows.append((index[synapses.source], lag, weights, axons))
            weights += synapses.weight.size
            axons += len(synapses.weight)
    return np.array(rows, np.int64)


def _layers(program: Program, fixed: CubaFixedPoint, windows: bool) -> Integers:
    rows, neurons, wires = [], 0, 0
    biases = sum(s.weight.size for layer in program.layers for s in layer.synapses)
    for layer in program.layers:
        limits = bounds(program, layer, fixed, None)
        in_integers = fixed.refractory > 1 or _too_much(layer, fixed, limits.drive)
        bits = 8 * np.dtype(_whole_type(limits.partial)).itemsize
        end = wires + len(layer.synapses)
        output = layer.name in program.to_host
        forgets = not layer.current_decay.any()
        proven = max(limits.current, limits.above, limits.below) <= min(_rooms(fixed)[1:])
        about = (layer.start, biases + neurons, layer.bias_fan_out, output, forgets, proven)
        leaves = (layer.size if output and not layer.spiking else 0, layer.name == program.output)
        window = program.window(layer, program.rows(1)) if windows else slice(0, program.rows(1))
        silent = (window.start, program.rows(1) - window.stop)
        rows.append(
            (layer.size, neurons, 0, wires, end, bits, in_integers, *about, *leaves, *silent)
        )
        neurons, wires = neurons + layer.size, end
    return np.array(rows, np.int64)


def _too_much(layer: Layer, fixed: CubaFixedPoint, drive: float) -> bool:
    """True where a timestep could overflow the accumulator, or hide an inexact decay.

    Where it cannot, a sum that float64 may hold was made from a decay that it computed exactly.
    """
    bias = float(np.abs(layer.voltage_bias.astype(np.int64)).max(initial=0))
    return drive > register_limit(fixed.accumulator) or max(drive, bias) > _exact(fixed)


def _sources(program: Program, delays: tuple[tuple[int, ...], ...]) -> Integers:
    """Without places in memory, which depend on the timesteps."""
    remembered = dict.fromkeys(program.sizes, 0)
    for layer, lags in zip(program.layers, delays, strict=True):
        for synapses, lag in zip(layer.synapses, lags, strict=True):
            remembered[synapses.source] = max(remembered[synapses.source], lag)
    lag = program.readout.lag if program.readout else 0
    remembered[program.output] = max(remembered[program.output], lag)
    return np.array([(n, remembered[name], 0, 0) for name, n in program.sizes.items()], np.int64)


def _chip(program: Program, fixed: CubaFixedPoint) -> Integers:
    subtract = program.convention.reset == "subtract"
    return np.array([fixed.mantissa_shift, fixed.decay_bits, fixed.refractory, subtract], np.int64)


def _registers(fixed: CubaFixedPoint) -> Integers:
    all_ = (fixed.accumulator, fixed.current, fixed.membrane)
    return np.array([(OVERFLOWS[r.overflow], r.bits) for r in all_], np.int64)


def _stack_integers(program: Program) -> Integers:
    def order(layer: Layer) -> list[NDArray[Any]]:
        return [layer.current_decay, layer.membrane_decay, layer.threshold, layer.voltage_bias]

    return np.concatenate([np.stack(order(a)) for a in program.layers], axis=1).astype(np.int64)


def _real(program: Program, fixed: CubaFixedPoint) -> NDArray[np.floating]:
    """(4, N) in float32 if that holds them: a layer of 512 neurons then fits the nearest cache."""
    real: NDArray[np.float64] = _stack_integers(program) * np.array(
        [[1 / fixed.decay_one]] * 2 + [[1.0]] * 2
    )
    single = as_aligned(real, np.float32)
    return single if (single == real).all() else as_aligned(real, np.float64)


def _rooms(fixed: CubaFixedPoint) -> tuple[float, float, float]:
    """State units per weight unit, and what float64 may hold of a current and of a membrane."""

    def largest(register: Register) -> float:
        return float(min(register_limit(register), _exact(fixed)))

    return float(1 << fixed.mantissa_shift), largest(fixed.current), largest(fixed.membrane)


def _exact(fixed: CubaFixedPoint) -> int:
    """Largest magnitude of three that are added, so that float64 decays their sum exactly."""
    return 1 << (_EXACT_BITS - 2 - fixed.decay_bits)


class WindowMemory:
    """Memory for windows of T timesteps of a batch of B, with views of what is in it.

    constants: of the program; here they know their places.
    arrays: what the kernels take.
    slots: of each state; 2, or T + 1 to leave a trace.
    """

    def __init__(self, constants: Constants, timesteps: int, batch: int, slots: int) -> None:
        self.timesteps, self.batch, self.slots = timesteps, batch, slots
        layers, sources = constants.layers.copy(), constants.sources.copy()
        neurons, rows = sources[:, NEURONS], sources[:, REMEMBERS] + timesteps
        layers[:, STATE], states = _compute_offsets(2 * slots * layers[:, SIZE])
        sources[:, RASTER], spikes = _compute_offsets(neurons * rows)
        sources[:, LENGTHS], lengths = _compute_offsets(rows)
        self.constants = constants._replace(layers=layers, sources=sources)
        widest = int(layers[:, SIZE].max())
        self.arrays = KernelMemory(
            rasters=np.zeros((batch, spikes), np.uint8),
            lists=np.zeros((batch, spikes), np.int32),
            lengths=np.zeros((batch, lengths), np.int64),
            states=aligned((batch, states), np.float64),
            refractory=np.zeros((batch, int(layers[:, SIZE].sum())), np.int64),
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

    def saved(self) -> SavedState:
        """Copies of the states now, and of the spikes that have not arrived yet."""
        saved = {"refractory": self.arrays.refractory.copy()}
        for layer in range(len(self.constants.layers)):
            saved[f"states {layer}"] = self.states(layer)[:, 0].copy()
        for source in range(len(self.constants.sources)):
            for name, rows in self._late(source).items():
                saved[f"{name} {source}"] = rows.copy()
        return saved

    def restore(self, saved: SavedState) -> None:
        """Go on from there; T may be another."""
        self.arrays.refractory[:] = saved["refractory"]
        for layer in range(len(self.constants.layers)):
            self.states(layer)[:, 0] = saved[f"states {layer}"]
        for source in range(len(self.constants.sources)):
            for name, rows in self._late(source).items():
                rows[:] = saved[f"{name} {source}"]

    def _late(self, source: int) -> dict[str, NDArray[Any]]:
        """Views of the rows of a source that have not arrived."""
        _, past, _, at = self.constants.sources[source]
        return {
            "rasters": self._split(self.arrays.rasters, source)[:, :past],
            "lists": self._split(self.arrays.lists, source)[:, :past],
            "lengths": self.arrays.lengths[:, at : at + past],
        }

    def _split(self, array: NDArray[Any], source: int) -> NDArray[Any]:
        """(B, remembered + T, N) of the rasters or of the lists."""
        size, past, at, _ = self.constants.sources[source]
        rows = past + self.timesteps
        return array[:, at : at + rows * size].reshape(self.batch, rows, size)


def _compute_offsets(sizes: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Return the first index of each block, and the size of all."""
    ends = np.cumsum(sizes)
    return ends - sizes, int(ends[-1])
