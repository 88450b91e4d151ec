"""The compiled kernels: a window of a whole program in one call, equal to the interpreter.

Plain Python that Numba, where it is installed, compiles to vector instructions when a machine first
needs it. Nothing is allocated in here.

A timestep is tried in float64, which holds 24-bit states and their products with 12-bit decays
exactly. Where a number does not fit its register, the same timestep is computed again in int64 by
the specification, from the state before it, which is still there.
"""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

Array = Any  # the compiler sees the types
Number = Any

# events, in the order of runtime.emulator.ledger.EVENTS
(
    SPIKE_IN, SOP, BIAS_SOP, UPDATE, IDLE, SPIKE_OUT, MESSAGE, SATURATION, GRADED_SOP, LOST_SPIKE,
) = range(10)  # fmt: skip

# columns of Constants.layers; STATE is where the layer's states begin in a row of Memory.states,
# BIAS where its biases begin in Constants.weights; of a layer with NO_CURRENT nothing stays of a
# current, of one that is PROVEN no number can be too large, and one IN_INTEGERS is always computed
# in int64; of each layer that IS_OUTPUT the spikes leave the chip, and in each timestep so many
# membranes as are READ, and the one that LEAVES is what the kernel puts out; the bias axon of a
# layer is silent, and the host deaf to it, in HEAD rows first and in TAIL rows last
(
    SIZE, NEURON, STATE, FIRST_WIRE, LAST_WIRE, IS_NARROW, IN_INTEGERS, START, BIAS, BIAS_FAN_OUT,
    IS_OUTPUT, NO_CURRENT, PROVEN, READ, LEAVES, HEAD, TAIL,
) = range(17)  # fmt: skip
# columns of Constants.wires
SOURCE, LAG, WEIGHT, FAN_OUT = range(4)
# columns of Constants.sources; NEURONS of each, rows that it REMEMBERS, where its RASTER and its
# LENGTHS begin in a row of the memory
NEURONS, REMEMBERS, RASTER, LENGTHS = range(4)
# entries of Constants.chip
SHIFT, DECAY_BITS, REFRACTORY, SUBTRACT = range(4)
# rows of Constants.whole and of Constants.real
CURRENT_DECAY, MEMBRANE_DECAY, THRESHOLD, VOLTAGE_BIAS = range(4)
# what a register does when a number does not fit, in Constants.registers with its bits
OVERFLOWS = {"none": 0, "wrap": 1, "wrap-once": 2, "clip": 3}
NONE, WRAP, WRAP_ONCE, CLIP = OVERFLOWS.values()


class Constants(NamedTuple):
    """A program as arrays; those of its layers and synapses one after another.

    weights: (W,) mantissas, axon-major, and then the biases.
    fan_out: (A,) of each axon of each synapses.
    wires, layers, sources: a row for each, columns above; source 0 is the input, k + 1 layer k.
    chip: entries above.
    registers: (3, 2) what accumulator, current and membrane do, and their bits.
    whole: (4, N) rows above; decay factors in 1 / 2**decay_bits.
    real: (4, N) the same for float64; decay factors as fractions.
    rooms: state units per weight unit, and what float64 may hold of a current and of a membrane.
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


class Memory(NamedTuple):
    """Memory of a program, a row for each of the batch.

    rasters: (B, R) of each source the rows that are still on their way, then those of the window.
    lists: (B, R) of each of those rows the axons that spiked.
    lengths: (B, Q) how many.
    states: (B, K) of each layer slots of current and membrane, used in turn; slot 0 is now.
    refractory: (B, N) timesteps of refractory left.
    counts: (B, L, E) of the window.
    narrow, wide: (N,) what arrives in a timestep.
    """

    rasters: Array
    lists: Array
    lengths: Array
    states: Array
    refractory: Array
    counts: Array
    narrow: Array
    wide: Array


class Window(NamedTuple):
    """Arguments of `run` that hold for all layers."""

    timesteps: Number
    slots: Number
    step: Number
    counting: Number


class Neurons(NamedTuple):
    """The part of Constants that a timestep of a layer in float64 needs."""

    decay_current: Array
    decay_membrane: Array
    threshold: Array
    bias: Array
    rooms: Array
    subtract: Number
    watched: Number


Function = TypeVar("Function", bound=Callable[..., Any])


def jit(function: Function) -> Function:
    """The function as machine code, made when first called and built into what calls it.

    Without Numba the function itself: the module can then be read and imported, and NumbaPipeline
    refuses to run it, for it would take a thousand times longer.
    """
    return _compile(function, cache=False)


def kept_on_disk(function: Function) -> Function:
    """The same for the outermost function, whose machine code is kept on disk beside its source.

    Numba compiles anew when that one file changes, and knows of no other. So the name under which
    the code is kept says what all files of the kernels hold; it is not found by any other version.
    """
    sources = sorted(Path(__file__).parent.glob("numba_*.py"))
    digest = sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    function.__qualname__ = f"{function.__qualname__}_{digest[:12]}"
    try:
        return _compile(function, cache=True)
    except RuntimeError:
        # neither the package nor the user's cache folder can be written: compiled in every process
        return _compile(function, cache=False)


def _compile(function: Function, *, cache: bool) -> Function:
    try:
        import numba
    except ImportError:
        return function
    njit: Any = numba.njit
    compiled: Function = njit(
        function,
        cache=cache,
        nogil=True,
        error_model="numpy",
        # arguments are tuples of arrays, which take longer to hand over than a timestep to compute
        forceinline=True,
        # no arrays are made, so none are counted; what would allocate does not compile
        _nrt=False,
    )
    return compiled


@kept_on_disk
def run(
    weights: Array,
    fan_out: Array,
    wires: Array,
    layers: Array,
    sources: Array,
    chip: Array,
    registers: Array,
    whole: Array,
    real: Array,
    rooms: Array,
    rasters: Array,
    lists: Array,
    lengths: Array,
    states: Array,
    refractory: Array,
    counts: Array,
    narrow: Array,
    wide: Array,
    presynaptic: Array,
    slots: int,
    lag: int,
    steps: int,
    step: int,
    rowwise: bool,
    counting: bool,
    fresh: bool,
) -> bool:
    """One window of every layer, for each of a batch; whether the input held nothing but 0 and 1.

    The fields of Constants and Memory come one by one: handing them over takes a microsecond, and
    as two tuples it would take five.

    presynaptic: (T, B, N) spikes that leave the chip.
    slots: of each state; 2, or T + 1 to leave a trace.
    lag: rows by which what leaves the chip trails the output layer.
    steps: chip timesteps that the window stands for.
    step: chip timestep of a single row, in which layers may only wait; -1 runs all of them.
    rowwise: all layers in one timestep after another, which closes loops; else layer by layer.
    counting: whether the counts are wanted.
    fresh: whether to begin from zero.
    """
    constants = Constants(
        weights, fan_out, wires, layers, sources, chip, registers, whole, real, rooms
    )
    every = Memory(rasters, lists, lengths, states, refractory, counts, narrow, wide)
    timesteps, batch = presynaptic.shape[0], presynaptic.shape[1]
    window = Window(timesteps, slots, step, counting)
    if not zero_or_one(sources[0], rasters, timesteps):
        return False
    counts[:] = 0
    for b in range(batch):
        memory = _of_copy(every, b)
        if fresh:
            _forget(constants, memory)
        for row in range(timesteps):
            list_spikes(sources[0], memory, row)
    # the weights of a layer stay in the cache for the whole batch
    turns, rows = (timesteps, 1) if rowwise else (1, timesteps)
    for turn in range(turns):
        for layer in range(len(layers)):
            for b in range(batch):
                memory = _of_copy(every, b)
                _timesteps(constants, memory, window, layer, turn, turn + rows)
    for b in range(batch):
        memory = _of_copy(every, b)
        _leave(constants, memory, presynaptic, b, lag)
        if counting:
            count(constants, memory, window, steps)
        _remember(constants, memory, window)
    return True


@jit
def zero_or_one(source: Array, rasters: Array, timesteps: int) -> bool:
    """True where all values of the input are 0 or 1."""
    first, all_ = source[RASTER] + source[REMEMBERS] * source[NEURONS], 0
    for b in range(len(rasters)):
        for value in rasters[b, first : first + timesteps * source[NEURONS]]:
            all_ |= value
    return all_ <= 1


@jit
def _of_copy(memory: Array, b: int) -> Array:
    """The memory of one of the batch."""
    rasters, lists, lengths, states, refractory, counts, narrow, wide = memory
    return Memory(
        rasters[b], lists[b], lengths[b], states[b], refractory[b], counts[b], narrow, wide
    )


@jit
def _forget(constants: Array, memory: Array) -> None:
    """Zero states, and no spike in delivery."""
    for about in constants.layers:
        memory.states[about[STATE] : about[STATE] + 2 * about[SIZE]] = 0.0
    memory.refractory[:] = 0
    for source in constants.sources:
        rows, at = source[REMEMBERS], source[RASTER]
        memory.rasters[at : at + rows * source[NEURONS]] = 0
        memory.lengths[source[LENGTHS] : source[LENGTHS] + rows] = 0


@jit
def list_spikes(source: Array, memory: Array, row: int) -> None:
    """List the spikes of a source in a row of the window."""
    size, place = source[NEURONS], source[REMEMBERS] + row
    at = source[RASTER] + place * size
    spikes, axons = memory.rasters[at : at + size], memory.lists[at : at + size]
    found = 0
    for n in range(size):
        # written whether it spiked or not, and overwritten if not: no jumps to guess
        axons[found] = n
        found += spikes[n]
    memory.lengths[source[LENGTHS] + place] = found


@jit
def _timesteps(
    constants: Array, memory: Array, window: Array, layer: int, first: int, last: int
) -> None:
    """Some timesteps of one layer, with sums in numbers as small as the bounds allow."""
    about, own = constants.layers[layer], constants.sources[layer + 1]
    if 0 <= window.step < about[START]:
        _pause(about, own, memory, window, first, last)
    elif about[IS_NARROW]:
        _advance(constants, memory, memory.narrow, window, layer, first, last)
    else:
        _advance(constants, memory, memory.wide, window, layer, first, last)
    for row in range(first, last):
        list_spikes(own, memory, row)


@jit
def _pause(about: Array, own: Array, memory: Array, window: Array, first: int, last: int) -> None:
    """Timesteps in which a layer has not started."""
    size = about[SIZE]
    for row in range(first, last):
        before, after = _slots(about, row, window.slots)
        _copy(memory.states[before : before + 2 * size], memory.states[after : after + 2 * size])
        at = own[RASTER] + (own[REMEMBERS] + row) * size
        memory.rasters[at : at + size] = 0


@jit
def _slots(about: Array, row: int, slots: int) -> tuple[int, int]:
    """Offsets of the states before and after a row of the window."""
    # not row % slots, which is a division
    slot, next_slot = (row, row + 1) if slots > 2 else (row & 1, ~row & 1)
    return about[STATE] + slot * 2 * about[SIZE], about[STATE] + next_slot * 2 * about[SIZE]


@jit
def _advance(
    constants: Array, memory: Array, sums: Array, window: Array, layer: int, first: int, last: int
) -> None:
    """Timesteps in which a layer runs, of those of the window."""
    about, own = constants.layers[layer], constants.sources[layer + 1]
    size, neuron = about[SIZE], about[NEURON]
    neurons = Neurons(
        constants.real[CURRENT_DECAY, neuron : neuron + size],
        constants.real[MEMBRANE_DECAY, neuron : neuron + size],
        constants.real[THRESHOLD, neuron : neuron + size],
        constants.real[VOLTAGE_BIAS, neuron : neuron + size],
        constants.rooms,
        constants.chip[SUBTRACT] == 1,
        about[PROVEN] == 0,
    )
    for row in range(first, last):
        at, to = _slots(about, row, window.slots)
        before, after = memory.states[at : at + 2 * size], memory.states[to : to + 2 * size]
        at = own[RASTER] + (own[REMEMBERS] + row) * size
        spikes = memory.rasters[at : at + size]
        sum_weights(constants, memory, sums, about, row, window.timesteps)
        in_integers = about[IN_INTEGERS] == 1
        if not in_integers and about[NO_CURRENT]:
            in_integers = float_step(neurons, sums, before, after, spikes, False)
        elif not in_integers:
            in_integers = float_step(neurons, sums, before, after, spikes, True)
        if in_integers:
            refractory = memory.refractory[neuron : neuron + size]
            lost = integer_step(constants, sums, neuron, before, after, refractory, spikes)
            memory.counts[layer, SATURATION] += lost
        if window.counting:
            memory.counts[layer, UPDATE] += active(neurons.bias, before, after)


@jit
def sum_weights(
    constants: Array, memory: Array, sums: Array, about: Array, row: int, timesteps: int
) -> None:
    """Fill sums (N,) with those of the bias and of each axon that spiked."""
    wires, sources, size = constants.wires, constants.sources, about[SIZE]
    bias = constants.weights[about[BIAS] : about[BIAS] + size]
    if about[HEAD] <= row < timesteps - about[TAIL]:
        for n in range(size):
            sums[n] = bias[n]
    else:
        for n in range(size):
            sums[n] = 0
    for wire in range(about[FIRST_WIRE], about[LAST_WIRE]):
        source = sources[wires[wire, SOURCE]]
        place = source[REMEMBERS] + row - wires[wire, LAG]
        at = source[RASTER] + place * source[NEURONS]
        axons = memory.lists[at : at + memory.lengths[source[LENGTHS] + place]]
        _add_rows(sums, constants.weights, wires[wire, WEIGHT], size, axons)


@jit
def _add_rows(sums: Array, weights: Array, start: int, size: int, axons: Array) -> None:
    """Add the weights of some axons, four at a time: each sum is fetched a quarter as often."""
    whole = len(axons) // 4 * 4
    for k in range(0, whole, 4):
        at = start + axons[k] * size
        one = weights[at : at + size]
        at = start + axons[k + 1] * size
        two = weights[at : at + size]
        at = start + axons[k + 2] * size
        three = weights[at : at + size]
        at = start + axons[k + 3] * size
        four = weights[at : at + size]
        for n in range(size):
            sums[n] += one[n] + two[n] + three[n] + four[n]
    for k in range(whole, len(axons)):
        at = start + axons[k] * size
        one = weights[at : at + size]
        for n in range(size):
            sums[n] += one[n]


@jit
def float_step(
    neurons: Array, sums: Array, before: Array, after: Array, spikes: Array, has_current: bool
) -> bool:
    """A timestep in float64; whether a number was too large for it.

    has_current: whether anything stays of a current; a constant at every call, so that each has a
        loop of its own.
    """
    decay_current, decay_membrane, threshold, bias, rooms, subtract, watched = neurons
    unit, room, room_membrane = rooms[0], rooms[1], rooms[2]
    size, too_large = len(spikes), 0
    for n in range(size):
        current = sums[n] * unit
        if has_current:
            current += np.trunc(before[n] * decay_current[n])
        membrane = np.trunc(before[size + n] * decay_membrane[n]) + current + bias[n]
        if watched:
            too_large |= (abs(current) > room) | (abs(membrane) > room_membrane)
        fired = membrane > threshold[n]
        rest = membrane - threshold[n] if subtract else 0.0
        after[n] = current
        after[size + n] = rest if fired else membrane
        spikes[n] = fired
    return too_large != 0


@jit
def integer_step(
    constants: Array,
    sums: Array,
    first: int,
    before: Array,
    after: Array,
    refractory: Array,
    spikes: Array,
) -> int:
    """A timestep in int64, as the update of the interpreter; how many numbers did not fit."""
    chip, registers, whole = constants.chip, constants.registers, constants.whole
    size, bits, lost = len(spikes), chip[DECAY_BITS], 0
    for n in range(size):
        bias, threshold = whole[VOLTAGE_BIAS, first + n], whole[THRESHOLD, first + n]
        was_current, was_membrane = np.int64(before[n]), np.int64(before[size + n])
        wide = np.int64(sums[n]) << chip[SHIFT]
        drive = _fit(wide, registers[0])
        lost += drive != wide
        wide = _decay(was_current, whole[CURRENT_DECAY, first + n], bits) + drive
        current = _fit(wide, registers[1])
        lost += current != wide
        wide = _decay(was_membrane, whole[MEMBRANE_DECAY, first + n], bits) + current + bias
        membrane = _fit(wide, registers[2])
        lost += membrane != wide
        held = refractory[n] > 0
        fired = membrane > threshold and not held
        if held:
            membrane = 0
        elif fired:
            membrane = membrane - threshold if chip[SUBTRACT] == 1 else 0
        refractory[n] = chip[REFRACTORY] - 1 if fired else max(refractory[n] - 1, 0)
        after[n], after[size + n] = current, membrane
        spikes[n] = fired
    return lost


@jit
def _decay(x: Number, factor: Number, bits: Number) -> Number:
    """As decay of runtime.chips.registers."""
    left = abs(x) * factor >> bits
    return left if x >= 0 else -left


@jit
def _fit(x: Number, register: Array) -> Number:
    """As Register.fit."""
    overflow, half = register[0], np.int64(1) << (register[1] - 1)
    if overflow == WRAP:
        return (x + half) % (2 * half) - half
    if overflow == WRAP_ONCE:
        if x > half:
            return x - 2 * half
        return x + 2 * half if x <= -half else x
    if overflow == CLIP:
        return min(max(x, 1 - half), half - 1)
    return x


@jit
def active(bias: Array, before: Array, after: Array) -> int:
    """Neurons with a membrane, a current or a bias to add up."""
    size, busy = len(bias), 0
    for n in range(size):
        busy += (before[size + n] != 0.0) | (after[n] != 0.0) | (bias[n] != 0.0)
    return busy


@jit
def _copy(source: Array, target: Array) -> None:
    """Copy without the memory that assigning to a slice would take."""
    for n in range(len(target)):
        target[n] = source[n]


@jit
def _leave(constants: Array, memory: Array, presynaptic: Array, b: int, lag: int) -> None:
    """Copy what leaves the chip."""
    for layer in range(len(constants.layers)):
        if constants.layers[layer, LEAVES]:
            own = constants.sources[layer + 1]
            size = own[NEURONS]
            for row in range(len(presynaptic)):
                at = own[RASTER] + (own[REMEMBERS] + row - lag) * size
                _copy(memory.rasters[at : at + size], presynaptic[row, b])


@jit
def count(constants: Array, memory: Array, window: Array, steps: int) -> None:
    """The events of the window, as runtime.emulator.ledger.count_events."""
    layers, timesteps = constants.layers, window.timesteps
    for layer in range(len(layers)):
        about, events = layers[layer], memory.counts[layer]
        for wire in range(about[FIRST_WIRE], about[LAST_WIRE]):
            _count_sent(constants, memory, events, constants.wires[wire], timesteps)
        own = constants.sources[layer + 1]
        at = own[LENGTHS] + own[REMEMBERS]
        events[SPIKE_OUT] = memory.lengths[at : at + timesteps].sum()
        heard = timesteps - about[HEAD] - about[TAIL]
        always_on = 0 if 0 <= window.step < about[START] else heard
        events[BIAS_SOP] = always_on * about[BIAS_FAN_OUT]
        events[IDLE] = about[SIZE] * steps - events[UPDATE]
        events[MESSAGE] = events[SPIKE_IN] + always_on * (about[BIAS_FAN_OUT] > 0)
        if about[IS_OUTPUT]:
            events[MESSAGE] += events[SPIKE_OUT] + always_on * about[READ]


@jit
def _count_sent(
    constants: Array, memory: Array, events: Array, wire: Array, timesteps: int
) -> None:
    """Add spikes and synaptic operations of the rows that a source emitted in the window."""
    source = constants.sources[wire[SOURCE]]
    for row in range(timesteps):
        place = source[REMEMBERS] + row
        at = source[RASTER] + place * source[NEURONS]
        found = memory.lengths[source[LENGTHS] + place]
        events[SPIKE_IN] += found
        for axon in memory.lists[at : at + found]:
            events[SOP] += constants.fan_out[wire[FAN_OUT] + axon]


@jit
def _remember(constants: Array, memory: Array, window: Array) -> None:
    """Bring the last states to slot 0, and the last rows of sources before those of a window."""
    timesteps = window.timesteps
    last = timesteps if window.slots > 2 else timesteps & 1
    if last:
        for about in constants.layers:
            size, first = 2 * about[SIZE], about[STATE]
            at = first + last * size
            _copy(memory.states[at : at + size], memory.states[first : first + size])
    for source in constants.sources:
        size, rows = source[NEURONS], source[REMEMBERS]
        # forwards, since the rows may overlap
        start, shift = source[RASTER], timesteps * size
        for at in range(start, start + rows * size):
            memory.rasters[at] = memory.rasters[at + shift]
            memory.lists[at] = memory.lists[at + shift]
        start = source[LENGTHS]
        for at in range(start, start + rows):
            memory.lengths[at] = memory.lengths[at + timesteps]
