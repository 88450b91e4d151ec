"""The compiled kernels of CuBa-LIF neurons: a window of a whole program, equal to the interpreter.

A timestep is tried in float64, which holds 24-bit states and their products with 12-bit decays
exactly. Where a number does not fit its register, the same timestep is computed again in int64 by
the specification, from the state before it, which is still there.
"""

from typing import Any, NamedTuple

import numpy as np

from spikedeploy.runtime.families.numba_kernels import (
    LAYER,
    NEURON,
    SATURATION,
    SIZE,
    UPDATE,
    Call,
    Memory,
    begin,
    end,
    jit,
    kept_on_disk,
    list_spikes,
    of_copy,
    pause,
    raster_at,
    states_of,
    sum_weights,
    waits,
)

Array = Any  # the compiler sees the types
Number = Any

# columns of Constants.layers behind those of all families; sums of a layer that IS_NARROW fit 16
# bits, one IN_INTEGERS is always computed in int64, of one with NO_CURRENT nothing stays of a
# current, and of one that is PROVEN no number can be too large
IS_NARROW, IN_INTEGERS, NO_CURRENT, PROVEN = range(len(LAYER), len(LAYER) + 4)
# entries of Constants.chip
SHIFT, DECAY_BITS, REFRACTORY, SUBTRACT = range(4)
# rows of Constants.whole and of Constants.real
CURRENT_DECAY, MEMBRANE_DECAY, THRESHOLD, VOLTAGE_BIAS = range(4)
# what a register does when a number does not fit, in Constants.registers with its bits
OVERFLOWS = {"none": 0, "wrap": 1, "wrap-once": 2, "clip": 3}
NONE, WRAP, WRAP_ONCE, CLIP = OVERFLOWS.values()


class Constants(NamedTuple):
    """A program as arrays; those of its layers and synapses one after another.

    weights to sources: as in Wiring.
    chip: entries above.
    registers: (3, 2) what accumulator, current and membrane do, and their bits.
    whole: (4, N) rows above; decay factors in 1 / 2**decay_bits.
    real: (4, N) the same for float64; decay factors as fractions.
    rooms: state units per weight unit, and what float64 may hold of a current and of a membrane.
    """

    weights: Array
    tables: Array
    wires: Array
    layers: Array
    sources: Array
    chip: Array
    registers: Array
    whole: Array
    real: Array
    rooms: Array


class Neurons(NamedTuple):
    """The part of Constants that a timestep of a layer in float64 needs."""

    decay_current: Array
    decay_membrane: Array
    threshold: Array
    bias: Array
    rooms: Array
    subtract: Number
    watched: Number


@kept_on_disk
def run(
    weights: Array,
    tables: Array,
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
    slots, step, counting: as in Call.
    lag: rows by which what leaves the chip trails the output layer.
    steps: chip timesteps that the window stands for.
    rowwise: all layers in one timestep after another, which closes loops; else layer by layer.
    fresh: whether to begin from zero.
    """
    constants = Constants(
        weights, tables, wires, layers, sources, chip, registers, whole, real,
        rooms,
    )  # fmt: skip
    every = Memory(rasters, lists, lengths, states, refractory, counts, narrow, wide)
    timesteps, batch = presynaptic.shape[0], presynaptic.shape[1]
    call = Call(timesteps, slots, step, counting)
    if not begin(constants, every, call, 1, fresh):
        return False
    # the weights of a layer stay in the cache for the whole batch
    turns, rows = (timesteps, 1) if rowwise else (1, timesteps)
    for turn in range(turns):
        for layer in range(len(layers)):
            for b in range(batch):
                memory = of_copy(every, b)
                _timesteps(constants, memory, call, layer, turn, turn + rows)
    end(constants, every, call, presynaptic, lag, steps)
    return True


@jit
def _timesteps(
    constants: Array, memory: Array, call: Array, layer: int, first: int, last: int
) -> None:
    """Some timesteps of one layer, with sums in numbers as small as the bounds allow."""
    about, own = constants.layers[layer], constants.sources[layer + 1]
    if waits(about, call):
        for row in range(first, last):
            pause(about, own, memory, call, row)
    elif about[IS_NARROW]:
        _advance(constants, memory, memory.narrow, call, layer, first, last)
    else:
        _advance(constants, memory, memory.wide, call, layer, first, last)
    for row in range(first, last):
        list_spikes(own, memory, row)


@jit
def _advance(
    constants: Array, memory: Array, scratch: Array, call: Array, layer: int, first: int, last: int
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
        before, after = states_of(about, memory, call, row)
        spikes = memory.rasters[raster_at(own, row) : raster_at(own, row) + size]
        sum_weights(constants, memory, scratch, about, row, call, False)
        sums = scratch[0, :size]
        in_integers = about[IN_INTEGERS] == 1
        if not in_integers and about[NO_CURRENT]:
            in_integers = float_step(neurons, sums, before, after, spikes, False)
        elif not in_integers:
            in_integers = float_step(neurons, sums, before, after, spikes, True)
        if in_integers:
            refractory = memory.refractory[neuron : neuron + size]
            lost = integer_step(constants, sums, neuron, before, after, refractory, spikes)
            memory.counts[layer, SATURATION] += lost
        if call.counting:
            memory.counts[layer, UPDATE] += active(neurons.bias, before, after)


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
