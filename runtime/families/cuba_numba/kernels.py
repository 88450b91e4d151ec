"""The compiled kernels: a window of a whole program in one call, equal to the interpreter.

Plain Python that Numba compiles to vector instructions when a machine first needs it. Nothing is
allocated in here.

All of it is in one file on purpose, long as that is. Numba keeps what it compiled beside the file
of the outermost function and compiles anew when that file changes; it knows of no other. A kernel
or a constant that moved to a second file would go on running as it was when it is changed there.

A tick is tried in float64, which holds 24-bit states and their products with 12-bit decays exactly.
Where a number does not fit its register, the same tick is done again in int64 by the specification,
from the state before it, which is still there.

The compiler of runtime.native_kernels: Numba's, where it is installed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np

Function = TypeVar("Function", bound=Callable[..., Any])


def jit(function: Function) -> Function:
    """The function as machine code, made when first called and kept on disk beside the source.

    Without Numba the function itself: the module can then be read and imported, and runtime.backend
    refuses to run it, for it would take a thousand times longer.
    """
    try:
        import numba
    except ImportError:
        return function
    njit: Any = numba.njit
    options = {
        "nogil": True,
        "error_model": "numpy",
        # arguments are tuples of arrays, which take longer to hand over than a tick to compute
        "forceinline": True,
        # no arrays are made, so none are counted; what would allocate does not compile
        "_nrt": False,
    }
    try:
        compiled: Function = njit(function, cache=True, **options)
    except RuntimeError:
        # neither the package nor the user's cache folder can be written: compiled in every process
        compiled = njit(function, **options)
    return compiled


Array = Any  # the compiler sees the types
Number = Any

# events, in the order of runtime.ledger.EVENTS
SPIKE_IN, SOP, BIAS_SOP, UPDATE, IDLE, SPIKE_OUT, MESSAGE, SATURATION = range(8)

# columns of Constants.layers; STATE is where the layer's states begin in a row of Memory.states,
# BIAS where its biases begin in Constants.weights; one that FORGETS keeps nothing of a current, and
# of one that is PROVEN no number can be too large
SIZE, NEURON, STATE, FIRST_WIRE, LAST_WIRE, SUM_BITS, CAREFUL, START = range(8)
BIAS, BIAS_FAN_OUT, IS_OUTPUT, FORGETS, PROVEN = range(8, 13)
# columns of Constants.wires
SOURCE, LAG, WEIGHT, FAN_OUT = range(4)
# columns of Constants.sources; NEURONS of each, rows that it REMEMBERS, where its RASTER and its
# LENGTHS begin in a row of the memory
NEURONS, REMEMBERS, RASTER, LENGTHS = range(4)
# entries of Constants.chip
SHIFT, DECAY_BITS, REFRACTORY, SUBTRACT = range(4)
# rows of Constants.whole and of Constants.real
CURRENT_KEEP, MEMBRANE_KEEP, THRESHOLD, VOLTAGE_BIAS = range(4)
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
    whole: (4, N) rows above; keeps in 1 / 2**decay_bits.
    real: (4, N) the same for float64; keeps as fractions.
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
    """What a program remembers and works with, a row for each of the batch.

    rasters: (B, R) of each source the rows that are still on their way, then those of the window.
    lists: (B, R) of each of those rows the axons that spiked.
    lengths: (B, Q) how many.
    states: (B, K) of each layer slots of current and membrane, used in turn; slot 0 is now.
    silent: (B, N) timesteps of refractory left.
    sums16, sums32, sums64: (N,) what arrives in a tick.
    """

    rasters: Array
    lists: Array
    lengths: Array
    states: Array
    silent: Array
    sums16: Array
    sums32: Array
    sums64: Array


class KernelNeurons(NamedTuple):
    """What a tick of a layer in float64 needs of Constants.real and Constants.rooms."""

    keep_current: Array
    keep_membrane: Array
    threshold: Array
    bias: Array
    unit: Number
    room_current: Number
    room_membrane: Number
    subtract: Number
    watched: Number


@jit
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
    silent: Array,
    sums16: Array,
    sums32: Array,
    sums64: Array,
    counts: Array,
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

    The fields of Constants and of Memory come one by one: that takes a microsecond and two tuples
    would take five.

    counts: (B, L, E) of the window.
    heard: (T, B, N) spikes that leave the chip.
    slots: of each state; 2, or T + 1 to leave a trace.
    lag: rows by which what leaves the chip trails the output layer.
    steps: chip timesteps that the window stands for.
    step: chip timestep of a single row, in which layers may only wait; -1 runs all of them.
    rowwise: all layers in one timestep after another, which closes loops; else layer by layer.
    counting: whether somebody will look at the counts.
    fresh: whether to begin from zero.
    """
    constants = Constants(
        weights, fan_out, wires, layers, sources, chip, registers, whole, real, rooms
    )
    memory = KernelMemory(rasters, lists, lengths, states, silent, sums16, sums32, sums64)
    timesteps, batch = presynaptic.shape[0], presynaptic.shape[1]
    if not _spikes_only(constants, memory, batch, timesteps):
        return False
    counts[:] = 0
    for b in range(batch):
        if fresh:
            _forget(constants, memory, b, timesteps)
        for row in range(timesteps):
            _listen(constants, memory, b, 0, row)
    if rowwise:
        for b in range(batch):
            for row in range(timesteps):
                for layer in range(len(layers)):
                    _ticks(constants, memory, counts, b, layer, row, row + 1, slots, step, counting)
    else:
        # the weights of a layer stay in the cache for the whole batch
        for layer in range(len(layers)):
            for b in range(batch):
                _ticks(constants, memory, counts, b, layer, 0, timesteps, slots, step, counting)
    for b in range(batch):
        _leave(constants, memory, presynaptic, b, timesteps, lag)
        if counting:
            _count(constants, memory, counts, b, timesteps, steps, step)
        _remember(constants, memory, b, timesteps, slots)
    return True


@jit
def _spikes_only(constants: Array, memory: Array, batch: int, timesteps: int) -> bool:
    """Whether all values of the input are 0 or 1."""
    source, all_ = constants.sources[0], 0
    first = source[RASTER] + source[REMEMBERS] * source[NEURONS]
    for b in range(batch):
        for value in memory.rasters[b, first : first + timesteps * source[NEURONS]]:
            all_ |= value
    return all_ <= 1


@jit
def _forget(constants: Array, memory: Array, b: int, timesteps: int) -> None:
    """Zero states, and no spike on its way."""
    layers, sources = constants.layers, constants.sources
    for layer in range(len(layers)):
        at = layers[layer, STATE]
        memory.states[b, at : at + 2 * layers[layer, SIZE]] = 0.0
    memory.silent[b, :] = 0
    for source in range(len(sources)):
        rows = sources[source, REMEMBERS]
        at = sources[source, RASTER]
        memory.rasters[b, at : at + rows * sources[source, NEURONS]] = 0
        at = sources[source, LENGTHS]
        memory.lengths[b, at : at + rows] = 0


@jit
def _listen(constants: Array, memory: Array, b: int, source: int, row: int) -> None:
    """List the spikes of a source in a row of the window."""
    sources = constants.sources
    size, place = sources[source, NEURONS], sources[source, REMEMBERS] + row
    at = sources[source, RASTER] + place * size
    spikes, axons = memory.rasters[b, at : at + size], memory.lists[b, at : at + size]
    found = 0
    for n in range(size):
        # written whether it spiked or not, and overwritten if not: no jumps to guess
        axons[found] = n
        found += spikes[n]
    memory.lengths[b, sources[source, LENGTHS] + place] = found


@jit
def _ticks(
    constants: Array,
    memory: Array,
    counts: Array,
    b: int,
    layer: int,
    first: int,
    last: int,
    slots: int,
    step: int,
    counting: bool,
) -> None:
    """Some timesteps of one layer, with sums in numbers as small as the bounds allow."""
    about = constants.layers[layer]
    if 0 <= step < about[START]:
        _wait(constants, memory, b, layer, first, last, slots)
    elif about[SUM_BITS] == 16:
        _run(constants, memory, memory.sums16, counts, b, layer, first, last, slots, counting)
    elif about[SUM_BITS] == 32:
        _run(constants, memory, memory.sums32, counts, b, layer, first, last, slots, counting)
    else:
        _run(constants, memory, memory.sums64, counts, b, layer, first, last, slots, counting)
    for row in range(first, last):
        _listen(constants, memory, b, layer + 1, row)


@jit
def _wait(
    constants: Array, memory: Array, b: int, layer: int, first: int, last: int, slots: int
) -> None:
    """Timesteps in which a layer has not started."""
    about, own = constants.layers[layer], constants.sources[layer + 1]
    size, states = about[SIZE], memory.states[b]
    for row in range(first, last):
        before, after = _slots(about, row, slots)
        _copy(states[before : before + 2 * size], states[after : after + 2 * size])
        at = own[RASTER] + (own[REMEMBERS] + row) * size
        memory.rasters[b, at : at + size] = 0


@jit
def _slots(about: Array, row: int, slots: int) -> tuple[int, int]:
    """Where the states before and after a row of the window begin."""
    # not row % slots, which is a division
    slot, next_slot = (row, row + 1) if slots > 2 else (row & 1, ~row & 1)
    return about[STATE] + slot * 2 * about[SIZE], about[STATE] + next_slot * 2 * about[SIZE]


@jit
def _run(
    constants: Array,
    memory: Array,
    sums: Array,
    counts: Array,
    b: int,
    layer: int,
    first: int,
    last: int,
    slots: int,
    counting: bool,
) -> None:
    """Timesteps in which a layer runs."""
    about, own, chip = constants.layers[layer], constants.sources[layer + 1], constants.chip
    size, neuron, rooms = about[SIZE], about[NEURON], constants.rooms[layer]
    neurons = KernelNeurons(
        constants.real[CURRENT_KEEP, neuron : neuron + size],
        constants.real[MEMBRANE_KEEP, neuron : neuron + size],
        constants.real[THRESHOLD, neuron : neuron + size],
        constants.real[VOLTAGE_BIAS, neuron : neuron + size],
        rooms[UNIT],
        rooms[ROOM_CURRENT],
        rooms[ROOM_MEMBRANE],
        chip[SUBTRACT] == 1,
        about[PROVEN] == 0,
    )
    bias = constants.weights[about[BIAS] : about[BIAS] + size]
    silent = memory.silent[b, neuron : neuron + size]
    states, rasters = memory.states[b], memory.rasters[b]
    for row in range(first, last):
        at, to = _slots(about, row, slots)
        before, after = states[at : at + 2 * size], states[to : to + 2 * size]
        at = own[RASTER] + (own[REMEMBERS] + row) * size
        spikes = rasters[at : at + size]
        _arrive(constants, memory, sums, bias, b, layer, row)
        careful = about[CAREFUL] == 1
        if not careful and about[FORGETS]:
            careful = _leak(neurons, sums, before, after, spikes)
        elif not careful:
            careful = _leap(neurons, sums, before, after, spikes)
        if careful:
            _widen(memory.sums64, sums, size)
            lost = _walk(constants, memory.sums64, layer, before, after, silent, spikes)
            counts[b, layer, SATURATION] += lost
        if counting:
            counts[b, layer, UPDATE] += _busy(neurons.bias, before, after)


@jit
def _arrive(
    constants: Array, memory: Array, sums: Array, bias: Array, b: int, layer: int, row: int
) -> None:
    """Fill sums (N,) with those of the bias and of each axon that spiked."""
    about, wires, sources = constants.layers[layer], constants.wires, constants.sources
    size = about[SIZE]
    for n in range(size):
        sums[n] = bias[n]
    for wire in range(about[FIRST_WIRE], about[LAST_WIRE]):
        source = wires[wire, SOURCE]
        place = sources[source, REMEMBERS] + row - wires[wire, LAG]
        at = sources[source, RASTER] + place * sources[source, NEURONS]
        found = memory.lengths[b, sources[source, LENGTHS] + place]
        _gather(
            sums, constants.weights, wires[wire, WEIGHT], size, memory.lists[b, at : at + found]
        )


@jit
def _gather(sums: Array, weights: Array, start: int, size: int, axons: Array) -> None:
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
def _leap(neurons: Array, sums: Array, before: Array, after: Array, spikes: Array) -> bool:
    """A tick in float64; whether a number was too large for it."""
    keep_current, keep_membrane, threshold, bias, unit, room, room_membrane, subtract, watched = (
        neurons
    )
    size, too_large = len(spikes), 0
    for n in range(size):
        current = np.trunc(before[n] * keep_current[n]) + sums[n] * unit
        membrane = np.trunc(before[size + n] * keep_membrane[n]) + current + bias[n]
        if watched:
            too_large |= (abs(current) > room) | (abs(membrane) > room_membrane)
        fired = membrane > threshold[n]
        rest = membrane - threshold[n] if subtract else 0.0
        after[n] = current
        after[size + n] = rest if fired else membrane
        spikes[n] = fired
    return too_large != 0


@jit
def _leak(neurons: Array, sums: Array, before: Array, after: Array, spikes: Array) -> bool:
    """The same where nothing stays of a current."""
    _, keep_membrane, threshold, bias = neurons[:4]
    unit, room, room_membrane, subtract, watched = neurons[4:]
    size, too_large = len(spikes), 0
    for n in range(size):
        current = sums[n] * unit
        membrane = np.trunc(before[size + n] * keep_membrane[n]) + current + bias[n]
        if watched:
            too_large |= (abs(current) > room) | (abs(membrane) > room_membrane)
        fired = membrane > threshold[n]
        rest = membrane - threshold[n] if subtract else 0.0
        after[n] = current
        after[size + n] = rest if fired else membrane
        spikes[n] = fired
    return too_large != 0


@jit
def _busy(bias: Array, before: Array, after: Array) -> int:
    """Neurons with a membrane, a current or a bias to add up."""
    size, busy = len(bias), 0
    for n in range(size):
        busy += (before[size + n] != 0.0) | (after[n] != 0.0) | (bias[n] != 0.0)
    return busy


@jit
def _walk(
    constants: Array,
    sums: Array,
    layer: int,
    before: Array,
    after: Array,
    silent: Array,
    spikes: Array,
) -> int:
    """A tick in int64, as runtime.interpreter.update; how many numbers did not fit."""
    chip, registers = constants.chip, constants.registers
    size, first, bits = len(spikes), constants.layers[layer, NEURON], chip[DECAY_BITS]
    keep_current = constants.whole[CURRENT_KEEP, first : first + size]
    keep_membrane = constants.whole[MEMBRANE_KEEP, first : first + size]
    thresholds = constants.whole[THRESHOLD, first : first + size]
    biases = constants.whole[VOLTAGE_BIAS, first : first + size]
    lost = 0
    for n in range(size):
        bias, threshold = biases[n], thresholds[n]
        was_current, was_membrane = np.int64(before[n]), np.int64(before[size + n])
        wide = sums[n] << chip[SHIFT]
        drive = _fit(wide, registers[0])
        lost += drive != wide
        wide = _decayed(was_current, keep_current[n], bits) + drive
        current = _fit(wide, registers[1])
        lost += current != wide
        wide = _decayed(was_membrane, keep_membrane[n], bits) + current + bias
        membrane = _fit(wide, registers[2])
        lost += membrane != wide
        held = silent[n] > 0
        fired = membrane > threshold and not held
        if held:
            membrane = 0
        elif fired:
            membrane = membrane - threshold if chip[SUBTRACT] == 1 else 0
        silent[n] = chip[REFRACTORY] - 1 if fired else max(silent[n] - 1, 0)
        after[n], after[size + n] = current, membrane
        spikes[n] = fired
    return lost


@jit
def _decayed(x: Number, keep: Number, bits: Number) -> Number:
    """What runtime.fixed.decay leaves."""
    left = abs(x) * keep >> bits
    return left if x >= 0 else -left


@jit
def _fit(x: Number, register: Array) -> Number:
    """What runtime.fixed.Register.fit holds."""
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
def _widen(wide: Array, sums: Array, size: int) -> None:
    """Bring the sums to int64."""
    for n in range(size):
        wide[n] = sums[n]


@jit
def _copy(source: Array, target: Array) -> None:
    """Copy without the memory that assigning to a slice would take."""
    for n in range(len(target)):
        target[n] = source[n]


@jit
def _leave(
    constants: Array, memory: Array, presynaptic: Array, b: int, timesteps: int, lag: int
) -> None:
    """Copy what leaves the chip."""
    layers, sources = constants.layers, constants.sources
    for layer in range(len(layers)):
        if layers[layer, IS_OUTPUT]:
            own = sources[layer + 1]
            size = own[NEURONS]
            for row in range(timesteps):
                at = own[RASTER] + (own[REMEMBERS] + row - lag) * size
                _copy(memory.rasters[b, at : at + size], presynaptic[row, b])


@jit
def _count(
    constants: Array,
    memory: Array,
    counts: Array,
    b: int,
    timesteps: int,
    steps: int,
    step: int,
) -> None:
    """The events of the window, as runtime.ledger.count."""
    layers, wires, sources = constants.layers, constants.wires, constants.sources
    for layer in range(len(layers)):
        about, events = layers[layer], counts[b, layer]
        for wire in range(about[FIRST_WIRE], about[LAST_WIRE]):
            spikes, sops = _sent(constants, memory, b, wires[wire], timesteps)
            events[SPIKE_IN] += spikes
            events[SOP] += sops
        own = sources[layer + 1]
        at = own[LENGTHS] + own[REMEMBERS]
        events[SPIKE_OUT] = memory.lengths[b, at : at + timesteps].sum()
        always_on = 0 if 0 <= step < about[START] else timesteps
        events[BIAS_SOP] = always_on * about[BIAS_FAN_OUT]
        events[IDLE] = about[SIZE] * steps - events[UPDATE]
        events[MESSAGE] = events[SPIKE_IN] + always_on * (about[BIAS_FAN_OUT] > 0)
        if about[IS_OUTPUT]:
            events[MESSAGE] += events[SPIKE_OUT]


@jit
def _sent(constants: Array, memory: Array, b: int, wire: Array, timesteps: int) -> tuple[int, int]:
    """Spikes and synaptic operations of the rows that a source emitted in the window."""
    source = constants.sources[wire[SOURCE]]
    spikes, sops = 0, 0
    for row in range(timesteps):
        place = source[REMEMBERS] + row
        at = source[RASTER] + place * source[NEURONS]
        found = memory.lengths[b, source[LENGTHS] + place]
        spikes += found
        for axon in memory.lists[b, at : at + found]:
            sops += constants.fan_out[wire[FAN_OUT] + axon]
    return spikes, sops


@jit
def _remember(constants: Array, memory: Array, b: int, timesteps: int, slots: int) -> None:
    """Bring the last states to slot 0, and the last rows of sources before those of a window."""
    layers, sources = constants.layers, constants.sources
    last = timesteps if slots > 2 else timesteps & 1
    for layer in range(len(layers)):
        if last:
            size, first = 2 * layers[layer, SIZE], layers[layer, STATE]
            at = first + last * size
            _copy(memory.states[b, at : at + size], memory.states[b, first : first + size])
    for source in range(len(sources)):
        size, rows = sources[source, NEURONS], sources[source, REMEMBERS]
        # forwards, since the rows may overlap
        start, shift = sources[source, RASTER], timesteps * size
        for at in range(start, start + rows * size):
            memory.rasters[b, at] = memory.rasters[b, at + shift]
            memory.lists[b, at] = memory.lists[b, at + shift]
        start = sources[source, LENGTHS]
        for at in range(start, start + rows):
            memory.lengths[b, at] = memory.lengths[b, at + timesteps]
