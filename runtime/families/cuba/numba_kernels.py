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
from typing import Any, TypeVar

import numpy as np

from spikedeploy.runtime.families.cuba.numba_program import (
    BIAS,
    BIAS_FAN_OUT,
    BIAS_SOP,
    CLIP,
    CURRENT_DECAY,
    DECAY_BITS,
    FAN_OUT,
    FIRST_WIRE,
    HEAD,
    IDLE,
    IN_INTEGERS,
    IS_OUTPUT,
    LAG,
    LAST_WIRE,
    LEAVES,
    LENGTHS,
    MEMBRANE_DECAY,
    MESSAGE,
    NEURON,
    NEURONS,
    NO_CURRENT,
    PROVEN,
    RASTER,
    READ,
    REFRACTORY,
    REMEMBERS,
    ROOM_CURRENT,
    ROOM_MEMBRANE,
    SATURATION,
    SHIFT,
    SIZE,
    SOP,
    SOURCE,
    SPIKE_IN,
    SPIKE_OUT,
    START,
    STATE,
    SUBTRACT,
    SUM_BITS,
    TAIL,
    THRESHOLD,
    UNIT,
    UPDATE,
    VOLTAGE_BIAS,
    WEIGHT,
    WRAP,
    WRAP_ONCE,
    Array,
    Constants,
    KernelMemory,
    KernelNeurons,
    Number,
)

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


@jit
def float_step(
    neurons: Array, sums: Array, before: Array, after: Array, spikes: Array, has_current: bool
) -> bool:
    """A timestep in float64; whether a number was too large for it.

    has_current: whether anything stays of a current; a constant at every call, so that each has a
        loop of its own.
    """
    decay_current, decay_membrane, threshold, bias = neurons[:4]
    unit, room, room_membrane, subtract, watched = neurons[4:]
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
    layer: int,
    before: Array,
    after: Array,
    refractory: Array,
    spikes: Array,
) -> int:
    """A timestep in int64, as the update of the interpreter; how many numbers did not fit."""
    chip, registers = constants.chip, constants.registers
    size, first, bits = len(spikes), constants.layers[layer, NEURON], chip[DECAY_BITS]
    decay_current = constants.whole[CURRENT_DECAY, first : first + size]
    decay_membrane = constants.whole[MEMBRANE_DECAY, first : first + size]
    thresholds = constants.whole[THRESHOLD, first : first + size]
    biases = constants.whole[VOLTAGE_BIAS, first : first + size]
    lost = 0
    for n in range(size):
        bias, threshold = biases[n], thresholds[n]
        was_current, was_membrane = np.int64(before[n]), np.int64(before[size + n])
        wide = sums[n] << chip[SHIFT]
        drive = _fit(wide, registers[0])
        lost += drive != wide
        wide = _decay(was_current, decay_current[n], bits) + drive
        current = _fit(wide, registers[1])
        lost += current != wide
        wide = _decay(was_membrane, decay_membrane[n], bits) + current + bias
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
def active(bias: Array, before: Array, after: Array) -> int:
    """Neurons with a membrane, a current or a bias to add up."""
    size, busy = len(bias), 0
    for n in range(size):
        busy += (before[size + n] != 0.0) | (after[n] != 0.0) | (bias[n] != 0.0)
    return busy


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
def zero_or_one(constants: Array, memory: Array, batch: int, timesteps: int) -> bool:
    """True where all values of the input are 0 or 1."""
    source, all_ = constants.sources[0], 0
    first = source[RASTER] + source[REMEMBERS] * source[NEURONS]
    for b in range(batch):
        for value in memory.rasters[b, first : first + timesteps * source[NEURONS]]:
            all_ |= value
    return all_ <= 1


@jit
def list_spikes(constants: Array, memory: Array, b: int, source: int, row: int) -> None:
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
def sum_weights(
    constants: Array,
    memory: Array,
    sums: Array,
    bias: Array,
    b: int,
    layer: int,
    row: int,
    timesteps: int,
) -> None:
    """Fill sums (N,) with those of the bias and of each axon that spiked."""
    about, wires, sources = constants.layers[layer], constants.wires, constants.sources
    size = about[SIZE]
    if about[HEAD] <= row < timesteps - about[TAIL]:
        for n in range(size):
            sums[n] = bias[n]
    else:
        for n in range(size):
            sums[n] = 0
    for wire in range(about[FIRST_WIRE], about[LAST_WIRE]):
        source = wires[wire, SOURCE]
        place = sources[source, REMEMBERS] + row - wires[wire, LAG]
        at = sources[source, RASTER] + place * sources[source, NEURONS]
        found = memory.lengths[b, sources[source, LENGTHS] + place]
        _add_rows(
            sums, constants.weights, wires[wire, WEIGHT], size, memory.lists[b, at : at + found]
        )


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
def widen(wide: Array, sums: Array, size: int) -> None:
    """Bring the sums to int64."""
    for n in range(size):
        wide[n] = sums[n]


@jit
def count(
    constants: Array,
    memory: Array,
    counts: Array,
    b: int,
    timesteps: int,
    steps: int,
    step: int,
) -> None:
    """The events of the window, as runtime.emulator.ledger.count."""
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
        heard = timesteps - about[HEAD] - about[TAIL]
        always_on = 0 if 0 <= step < about[START] else heard
        events[BIAS_SOP] = always_on * about[BIAS_FAN_OUT]
        events[IDLE] = about[SIZE] * steps - events[UPDATE]
        events[MESSAGE] = events[SPIKE_IN] + always_on * (about[BIAS_FAN_OUT] > 0)
        if about[IS_OUTPUT]:
            events[MESSAGE] += events[SPIKE_OUT] + always_on * about[READ]


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

    The fields of Constants and KernelMemory come one by one: handing them over takes a microsecond,
    and as two tuples it would take five.

    counts: (B, L, E) of the window.
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
    memory = KernelMemory(rasters, lists, lengths, states, refractory, sums16, sums32, sums64)
    timesteps, batch = presynaptic.shape[0], presynaptic.shape[1]
    if not zero_or_one(constants, memory, batch, timesteps):
        return False
    counts[:] = 0
    for b in range(batch):
        if fresh:
            _forget(constants, memory, b, timesteps)
        for row in range(timesteps):
            list_spikes(constants, memory, b, 0, row)
    if rowwise:
        for b in range(batch):
            for row in range(timesteps):
                for layer in range(len(layers)):
                    _timesteps(
                        constants, memory, counts, b, layer, row, row + 1, timesteps, slots, step,
                        counting,
                    )  # fmt: skip
    else:
        # the weights of a layer stay in the cache for the whole batch
        for layer in range(len(layers)):
            for b in range(batch):
                _timesteps(
                    constants, memory, counts, b, layer, 0, timesteps, timesteps, slots, step,
                    counting,
                )  # fmt: skip
    for b in range(batch):
        _leave(constants, memory, presynaptic, b, timesteps, lag)
        if counting:
            count(constants, memory, counts, b, timesteps, steps, step)
        _remember(constants, memory, b, timesteps, slots)
    return True


@jit
def _forget(constants: Array, memory: Array, b: int, timesteps: int) -> None:
    """Zero states, and no spike in delivery."""
    layers, sources = constants.layers, constants.sources
    for layer in range(len(layers)):
        at = layers[layer, STATE]
        memory.states[b, at : at + 2 * layers[layer, SIZE]] = 0.0
    memory.refractory[b, :] = 0
    for source in range(len(sources)):
        rows = sources[source, REMEMBERS]
        at = sources[source, RASTER]
        memory.rasters[b, at : at + rows * sources[source, NEURONS]] = 0
        at = sources[source, LENGTHS]
        memory.lengths[b, at : at + rows] = 0


@jit
def _timesteps(
    constants: Array,
    memory: Array,
    counts: Array,
    b: int,
    layer: int,
    first: int,
    last: int,
    timesteps: int,
    slots: int,
    step: int,
    counting: bool,
) -> None:
    """Some timesteps of one layer, with sums in numbers as small as the bounds allow."""
    about = constants.layers[layer]
    if 0 <= step < about[START]:
        _pause(constants, memory, b, layer, first, last, slots)
    elif about[SUM_BITS] == 16:
        _run(
            constants, memory, memory.sums16, counts, b, layer, first, last, timesteps, slots,
            counting,
        )  # fmt: skip
    elif about[SUM_BITS] == 32:
        _run(
            constants, memory, memory.sums32, counts, b, layer, first, last, timesteps, slots,
            counting,
        )  # fmt: skip
    else:
        _run(
            constants, memory, memory.sums64, counts, b, layer, first, last, timesteps, slots,
            counting,
        )  # fmt: skip
    for row in range(first, last):
        list_spikes(constants, memory, b, layer + 1, row)


@jit
def _pause(
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
    timesteps: int,
    slots: int,
    counting: bool,
) -> None:
    """Timesteps in which a layer runs, of those of the window."""
    about, own, chip = constants.layers[layer], constants.sources[layer + 1], constants.chip
    size, neuron, rooms = about[SIZE], about[NEURON], constants.rooms[layer]
    neurons = KernelNeurons(
        constants.real[CURRENT_DECAY, neuron : neuron + size],
        constants.real[MEMBRANE_DECAY, neuron : neuron + size],
        constants.real[THRESHOLD, neuron : neuron + size],
        constants.real[VOLTAGE_BIAS, neuron : neuron + size],
        rooms[UNIT],
        rooms[ROOM_CURRENT],
        rooms[ROOM_MEMBRANE],
        chip[SUBTRACT] == 1,
        about[PROVEN] == 0,
    )
    bias = constants.weights[about[BIAS] : about[BIAS] + size]
    refractory = memory.refractory[b, neuron : neuron + size]
    states, rasters = memory.states[b], memory.rasters[b]
    for row in range(first, last):
        at, to = _slots(about, row, slots)
        before, after = states[at : at + 2 * size], states[to : to + 2 * size]
        at = own[RASTER] + (own[REMEMBERS] + row) * size
        spikes = rasters[at : at + size]
        sum_weights(constants, memory, sums, bias, b, layer, row, timesteps)
        in_integers = about[IN_INTEGERS] == 1
        if not in_integers and about[NO_CURRENT]:
            in_integers = float_step(neurons, sums, before, after, spikes, False)
        elif not in_integers:
            in_integers = float_step(neurons, sums, before, after, spikes, True)
        if in_integers:
            widen(memory.sums64, sums, size)
            lost = integer_step(constants, memory.sums64, layer, before, after, refractory, spikes)
            counts[b, layer, SATURATION] += lost
        if counting:
            counts[b, layer, UPDATE] += active(neurons.bias, before, after)


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
        if layers[layer, LEAVES]:
            own = sources[layer + 1]
            size = own[NEURONS]
            for row in range(timesteps):
                at = own[RASTER] + (own[REMEMBERS] + row - lag) * size
                _copy(memory.rasters[b, at : at + size], presynaptic[row, b])


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
