"""The compiled kernels: a window of a whole program in one call, equal to the interpreter.

Plain Python that Numba compiles to vector instructions when a machine first needs it. Nothing is
allocated in here.

A timestep is tried in float64, which holds 24-bit states and their products with 12-bit decays
exactly. Where a number does not fit its register, the same timestep is computed again in int64 by
the specification, from the state before it, which is still there.
"""

from spikedeploy.runtime.families.cuba_numba.jit import jit, kept_on_disk
from spikedeploy.runtime.families.cuba_numba.layout import (
    BIAS,
    CURRENT_DECAY,
    IN_INTEGERS,
    LEAVES,
    LENGTHS,
    MEMBRANE_DECAY,
    NEURON,
    NEURONS,
    NO_CURRENT,
    PROVEN,
    RASTER,
    REMEMBERS,
    ROOM_CURRENT,
    ROOM_MEMBRANE,
    SATURATION,
    SIZE,
    START,
    STATE,
    SUBTRACT,
    SUM_BITS,
    THRESHOLD,
    UNIT,
    UPDATE,
    VOLTAGE_BIAS,
    Array,
    Constants,
    KernelMemory,
    KernelNeurons,
)
from spikedeploy.runtime.families.cuba_numba.neurons import active, float_step, integer_step
from spikedeploy.runtime.families.cuba_numba.spikes import (
    count,
    list_spikes,
    sum_weights,
    widen,
    zero_or_one,
)


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
