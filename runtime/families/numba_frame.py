"""The compiled frame of all families: a window of a whole program in one call.

Plain Python that Numba, where it is installed, compiles to vector instructions when a machine first
needs it. Nothing is allocated in here. `run_window` takes in the input, goes through layers and
timesteps, counts, and puts out what leaves the chip; what a layer does in a timestep is the `step`
of its family, which `kernel` puts in its place.

Sums are event-driven: only axons that spiked are looked at. In a matrix the weights of an axon are
a row. Those of a window (runtime.chips.convolution) are stored by channel of the source and the
channels of the target innermost, so that they are contiguous too, and are added to a plane in that
order.
"""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple, TypeVar

import numpy as np

Array = Any  # the compiler sees the types
Number = Any

# events, in the order of runtime.emulator.ledger.EVENTS; nothing here counts the last two
(
    SPIKE_IN, SOP, BIAS_SOP, UPDATE, IDLE, SPIKE_OUT, MESSAGE, SATURATION, GRADED_SOP, LOST_SPIKE,
) = range(10)  # fmt: skip

# columns of Constants.layers, behind which families have their own
(
    SIZE,  # neurons
    NEURON,  # its first neuron in Constants.neurons, Constants.floats and Memory.refractory
    STATE,  # where its states begin in a row of Memory.states
    WIDTH,  # numbers of a slot of these states
    FIRST_WIRE,  # its first synapses in Constants.wires
    LAST_WIRE,  # the first that are no longer its own
    START,  # chip timestep before which it waits
    BIAS,  # where its biases begin in Constants.weights
    BIAS_FAN_OUT,  # neurons that the axon of the biases reaches
    IS_OUTPUT,  # whether its spikes leave the chip
    READ,  # membranes that leave the chip in a timestep
    LEAVES,  # whether the kernel puts out its spikes; one layer's
    HEAD,  # first rows in which its bias axon is silent and none of its membranes is read
    TAIL,  # last rows in which that is so
) = LAYER = range(14)
# columns of Constants.wires, one for the synapses from a source to a layer; those from SOURCE_Y on
# describe a window
(
    SOURCE,  # row of Constants.sources
    LAG,  # rows by which they deliver late
    WEIGHT,  # where their weights begin in Constants.weights
    FAN_OUT,  # where the fan-out of their axons begins in Constants.tables
    IS_WINDOW,  # whether they are a window, and not a matrix
    SOURCE_Y,  # height of the source
    SOURCE_X,  # width of the source
    ROWS,  # where in Constants.tables begins what each row of the source reaches
    COLUMNS,  # the same of each column
    KERNEL_Y,  # height of the kernel
    KERNEL_X,  # width of the kernel
    CHANNELS,  # channels of a group in the source
    FEATURES,  # channels of a group in the target
    ALL_FEATURES,  # channels of all groups in the target
    TARGET_Y,  # height of the target
    TARGET_X,  # width of the target
) = WIRE = range(16)
# columns of Constants.sources
(
    NEURONS,  # of the source
    REMEMBERS,  # rows before the window that are still on their way
    RASTER,  # where its rows begin in a row of Memory.rasters and of Memory.lists
    LENGTHS,  # where their counts begin in a row of Memory.lengths
) = range(4)
# entry of Constants.rules: spikes of an input channel in a timestep, at most
INPUT_MOST = 0
# a REGISTER takes so many entries of Constants.rules: what happens to a number that does not fit,
# bits, and the least and the largest number where it stops there (CLAMP)
REGISTER = 4
CLAMP, WRAP, WRAP_ONCE = range(3)


class Constants(NamedTuple):
    """A program as arrays; those of its layers and synapses one after another.

    weights: (W,) axon-major, and then the biases; of windows (C, ky, kx, O / G).
    tables: (A,) fan-out of each axon of each synapses; of windows also the position that a row, or
        column, reaches by each element of the kernel, or -1.
    wires, layers, sources: a row for each, columns above; source 0 is the input, k + 1 layer k.
    rules: (R,) entries of the family behind INPUT_MOST.
    neurons: (K, N) numbers of neurons, rows of the family.
    floats: (F, N) the numbers that a family computes with in floats.
    """

    weights: Array
    tables: Array
    wires: Array
    layers: Array
    sources: Array
    rules: Array
    neurons: Array
    floats: Array


class Memory(NamedTuple):
    """Memory of a program, a row for each of the batch.

    rasters: (B, R) of each source the rows that are still on their way, then those of the window.
    lists: (B, R) of each of those rows the axons that spiked.
    lengths: (B, Q) how many.
    states: (B, K) of each layer slots of states, used in turn; slot 0 is now.
    refractory: (B, N) timesteps of refractory left.
    counts: (B, L, E) of the window.
    narrow, wide: (2, N) what arrives in a timestep, and the plane to which windows add, all 0.
    """

    rasters: Array
    lists: Array
    lengths: Array
    states: Array
    refractory: Array
    counts: Array
    narrow: Array
    wide: Array


class Call(NamedTuple):
    """Arguments of `run` that hold for all layers.

    timesteps: T of the window.
    slots: of each state; 2, or T + 1 to leave a trace.
    step: chip timestep of a single row, in which layers may only wait; -1 runs all of them.
    counting: whether the counts are wanted.
    """

    timesteps: Number
    slots: Number
    step: Number
    counting: Number


Function = TypeVar("Function", bound=Callable[..., Any])
Kernel = Callable[..., bool]


def jit(function: Function) -> Function:
    """Return the function as machine code that is built into other machine code, which calls it.

    Python cannot call it. Without Numba the function itself: the module can then be read and
    imported, and NumbaPipeline refuses to run it, for it would take a thousand times longer.
    """
    # a wrapper for calls from Python takes a tenth of the time to compile
    return _compile(function, no_cpython_wrapper=True)


def kept_on_disk(function: Function, folder: Path | None = None) -> Function:
    """Return a function that Python calls as machine code that is kept on disk.

    Numba compiles anew when the file of the function changes, and knows of no other. So the name
    under which the code is kept says what all files of the kernels hold, these and those in
    `folder`, by default the function's own; it is not found by any other version.
    """
    folders = Path(__file__).parent, folder or Path(function.__code__.co_filename).parent
    sources = [path for each in folders for path in sorted(each.glob("numba_*.py"))]
    digest = sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    function.__qualname__ = f"{function.__qualname__}_{digest[:12]}"
    try:
        return _compile(function, cache=True)
    except RuntimeError:
        # neither the package nor the user's cache folder can be written: compiled in every process
        return _compile(function)


def _compile(function: Function, **options: bool) -> Function:
    try:
        import numba
    except ImportError:
        return function
    njit: Any = numba.njit
    compiled: Function = njit(
        function,
        **options,
        no_cfunc_wrapper=True,
        nogil=True,
        error_model="numpy",
        # arguments are tuples of arrays, which take longer to hand over than a timestep to compute
        forceinline=True,
        # no arrays are made, so none are counted; what would allocate does not compile
        _nrt=False,
    )
    return compiled


def kernel(step: Callable[..., Any]) -> Kernel:
    """Return `run_window` with the step of a family, as machine code of its own.

    step: of (constants, memory, call, layer, row, before, after, spikes): write the states and the
        spikes of a layer after a timestep, and list the spikes; return how many numbers did not fit
        a register, and how many neurons had something to add up, where Call.counting.
    """
    # a copy, for Numba keeps no machine code on disk of what gets a function as an argument
    code, module = run_window.__code__, Path(step.__code__.co_filename)
    copy = FunctionType(code, {**globals(), "_step": step}, f"run_{module.stem}")
    copy.__qualname__ = copy.__name__
    return kept_on_disk(copy, module.parent)


def _step(*arguments: Any) -> tuple[int, int]:  # noqa: ANN401
    """Advance a layer by a timestep: the place that `kernel` fills."""
    raise NotImplementedError


def run_window(
    weights: Array,
    tables: Array,
    wires: Array,
    layers: Array,
    sources: Array,
    rules: Array,
    neurons: Array,
    floats: Array,
    rasters: Array,
    lists: Array,
    lengths: Array,
    states: Array,
    refractory: Array,
    counts: Array,
    narrow: Array,
    wide: Array,
    output: Array,
    slots: int,
    lag: int,
    steps: int,
    chip_step: int,
    rowwise: bool,
    counting: bool,
    fresh: bool,
) -> bool:
    """Run a window of every layer, for each of a batch; False where the input spiked too often.

    The fields of Constants and Memory come one by one: handing them over takes a microsecond, and
    as two tuples it would take five.

    output: (T, B, N) spikes that leave the chip.
    slots, chip_step, counting: as in Call.
    lag: rows by which what leaves the chip trails the output layer.
    steps: chip timesteps that the window stands for.
    rowwise: all layers in one timestep after another, which closes loops; else layer by layer.
    fresh: whether to begin from zero.
    """
    constants = Constants(weights, tables, wires, layers, sources, rules, neurons, floats)
    every = Memory(rasters, lists, lengths, states, refractory, counts, narrow, wide)
    timesteps, batch = output.shape[0], output.shape[1]
    call = Call(timesteps, slots, chip_step, counting)
    if _largest_input(constants, every, call) > rules[INPUT_MOST]:
        return False
    every.counts[:] = 0
    for b in range(batch):
        memory = memory_of(every, b)
        if fresh:
            _forget(constants, memory)
        for row in range(timesteps):
            list_spikes(sources[0], memory, row)
    # the weights of a layer stay in the cache for the whole batch
    turns, rows = (timesteps, 1) if rowwise else (1, timesteps)
    for turn in range(turns):
        for layer in range(len(layers)):
            of_layer, own = layers[layer], sources[layer + 1]
            for b in range(batch):
                memory = memory_of(every, b)
                for row in range(turn, turn + rows):
                    before, after = states_of(of_layer, memory, call, row)
                    spikes = memory.rasters[raster_at(own, row) :][: of_layer[SIZE]]
                    if has_started(of_layer, call):
                        lost, active = _step(
                            constants, memory, call, layer, row, before, after, spikes
                        )
                        memory.counts[layer, SATURATION] += lost
                        memory.counts[layer, UPDATE] += active
                    else:
                        _copy(before, after)
                        spikes[:] = 0
                        list_spikes(own, memory, row)
    for b in range(batch):
        memory = memory_of(every, b)
        _put_out(constants, memory, output, b, lag)
        if counting:
            _count(constants, memory, call, steps)
        _remember(constants, memory, call)
    return True


@jit
def _largest_input(constants: Array, every: Array, call: Array) -> Number:
    """Return the most spikes of an input channel in a timestep."""
    source, largest = constants.sources[0], 0
    first = source[RASTER] + source[REMEMBERS] * source[NEURONS]
    for b in range(len(every.rasters)):
        for value in every.rasters[b, first : first + call.timesteps * source[NEURONS]]:
            largest = max(largest, value)
    return largest


@jit
def memory_of(memory: Array, b: int) -> Array:
    """Return the memory of one of the batch."""
    rasters, lists, lengths, states, refractory, counts, narrow, wide = memory
    return Memory(
        rasters[b], lists[b], lengths[b], states[b], refractory[b], counts[b], narrow, wide
    )


@jit
def _forget(constants: Array, memory: Array) -> None:
    """Zero states, and no spike in delivery."""
    for of_layer in constants.layers:
        for n in range(of_layer[STATE], of_layer[STATE] + of_layer[WIDTH]):
            memory.states[n] = 0
    memory.refractory[:] = 0
    for source in constants.sources:
        rows, at = source[REMEMBERS], source[RASTER]
        memory.rasters[at : at + rows * source[NEURONS]] = 0
        memory.lengths[source[LENGTHS] : source[LENGTHS] + rows] = 0


@jit
def list_spikes(source: Array, memory: Array, row: int) -> None:
    """List the axons of a source that spiked in a row of the window."""
    size, place = source[NEURONS], source[REMEMBERS] + row
    at = source[RASTER] + place * size
    spikes, axons = memory.rasters[at : at + size], memory.lists[at : at + size]
    found = 0
    for n in range(size):
        # written whether it spiked or not, and overwritten if not: no jumps to guess
        axons[found] = n
        found += spikes[n] != 0
    memory.lengths[source[LENGTHS] + place] = found


@jit
def has_started(of_layer: Array, call: Array) -> Number:
    """Return False for a layer that only waits."""
    return call.step < 0 or call.step >= of_layer[START]


@jit
def states_of(of_layer: Array, memory: Array, call: Array, row: int) -> tuple[Array, Array]:
    """States of a layer before and after a row of the window."""
    width = of_layer[WIDTH]
    # not row % slots, which is a division
    slot, next_slot = (row, row + 1) if call.slots > 2 else (row & 1, ~row & 1)
    at, to = of_layer[STATE] + slot * width, of_layer[STATE] + next_slot * width
    return memory.states[at : at + width], memory.states[to : to + width]


@jit
def raster_at(source: Array, row: int) -> Number:
    """Offset of the spikes of a source in a row of the window, which may lie before it."""
    return source[RASTER] + (source[REMEMBERS] + row) * source[NEURONS]


@jit
def spikes_of(source: Array, memory: Array, row: int) -> tuple[Array, Array]:
    """Axons of a source that spiked in a row of the window, which may lie before it; all counts."""
    at, place = raster_at(source, row), source[LENGTHS] + source[REMEMBERS] + row
    return memory.lists[at : at + memory.lengths[place]], memory.rasters[at : at + source[NEURONS]]


@jit
def arrivals(constants: Array, memory: Array, wire: Array, row: int) -> tuple[Array, Array]:
    """Return what arrives through synapses in a row: axons that spiked, and all counts."""
    return spikes_of(constants.sources[wire[SOURCE]], memory, row - wire[LAG])


@jit
def count_active(membranes: Array, currents: Array, biases: Array) -> Number:
    """How many neurons had something to add up: a membrane before, a current now, or a bias."""
    active = 0
    for n in range(len(biases)):
        active += (membranes[n] != 0) | (currents[n] != 0) | (biases[n] != 0)
    return active


@jit
def fit(x: Number, rules: Array, at: Number) -> Number:
    """Equal Register.fit, for the register that begins at an entry of the rules."""
    if rules[at] == CLAMP:
        return min(max(x, rules[at + 2]), rules[at + 3])
    half = np.int64(1) << (rules[at + 1] - 1)
    if rules[at] == WRAP:
        return (x + half) % (2 * half) - half
    if x > half:
        return x - 2 * half
    return x + 2 * half if x <= -half else x


@jit
def has_bias(of_layer: Array, row: int, timesteps: int) -> Number:
    """Return True for the rows in which a layer's bias axon spikes."""
    return of_layer[HEAD] <= row < timesteps - of_layer[TAIL]


@jit
def sum_weights(
    constants: Array,
    memory: Array,
    scratch: Array,
    of_layer: Array,
    row: int,
    call: Array,
    many: bool,
) -> None:
    """Fill the first row of the scratch with sums of the bias and of each axon that spiked.

    many: whether a source may spike several times in a timestep; a constant at every call.
    """
    size = of_layer[SIZE]
    sums, plane = scratch[0, :size], scratch[1, :size]
    if has_bias(of_layer, row, call.timesteps):
        bias = constants.weights[of_layer[BIAS] : of_layer[BIAS] + size]
        for n in range(size):
            sums[n] = bias[n]
    else:
        for n in range(size):
            sums[n] = 0
    for k in range(of_layer[FIRST_WIRE], of_layer[LAST_WIRE]):
        wire = constants.wires[k]
        axons, spikes = arrivals(constants, memory, wire, row)
        if wire[IS_WINDOW]:
            for axon in axons:
                for _ in range(spikes[axon] if many else 1):
                    _add_window(plane, constants.weights, wire, constants.tables, axon)
            if len(axons):
                _add_plane(sums, plane, wire[ALL_FEATURES])
        else:
            _add_rows(sums, constants.weights, wire[WEIGHT], axons)
            if many:
                _add_more(sums, constants.weights, wire[WEIGHT], axons, spikes)


@jit
def _add_rows(sums: Array, weights: Array, start: int, axons: Array) -> None:
    """Add the weights of some axons, four at a time: each sum is fetched a quarter as often."""
    size, whole = len(sums), len(axons) // 4 * 4
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
def _add_more(sums: Array, weights: Array, start: int, axons: Array, spikes: Array) -> None:
    """Add the weights of axons for their spikes but the first."""
    size = len(sums)
    for axon in axons:
        more, at = spikes[axon] - 1, start + axon * size
        if more:
            row = weights[at : at + size]
            for n in range(size):
                sums[n] += more * row[n]


@jit
def locate(wire: Array, axon: Number) -> tuple[Number, Number, Number]:
    """Channel of an axon of a window, and where in the tables is what its row and column reach."""
    line, x = axon // wire[SOURCE_X], axon % wire[SOURCE_X]
    channel, y = line // wire[SOURCE_Y], line % wire[SOURCE_Y]
    return channel, wire[ROWS] + y * wire[KERNEL_Y], wire[COLUMNS] + x * wire[KERNEL_X]


@jit
def _add_window(plane: Array, weights: Array, wire: Array, tables: Array, axon: int) -> None:
    """Add the weights of an axon, as often as its window overlaps the target, to the plane."""
    channel, row, column = locate(wire, axon)
    features, elements, lines = wire[FEATURES], wire[KERNEL_X], wire[KERNEL_Y]
    first = channel // wire[CHANNELS] * features
    rows, columns = tables[row : row + lines], tables[column : column + elements]
    at = wire[WEIGHT] + channel * lines * elements * features
    for i in range(lines):
        if rows[i] >= 0:
            for j in range(elements):
                if columns[j] >= 0:
                    place = rows[i] * wire[TARGET_X] + columns[j]
                    to = place * wire[ALL_FEATURES] + first
                    sums = plane[to : to + features]
                    kernel = weights[at + (i * elements + j) * features :]
                    for feature in range(features):
                        sums[feature] += kernel[feature]


@jit
def _add_plane(sums: Array, plane: Array, features: int) -> None:
    """Add a plane (positions, features) to the sums, which are in C order, and clear it."""
    places = len(sums) // features
    for feature in range(features):
        # sums one after another: a stride is often a power of two, which few places in a cache have
        maps = sums[feature * places : (feature + 1) * places]
        for place in range(places):
            maps[place] += plane[place * features + feature]
    for n in range(len(sums)):
        plane[n] = 0


@jit
def _copy(source: Array, target: Array) -> None:
    """Copy without the memory that assigning to a slice would take."""
    for n in range(len(target)):
        target[n] = source[n]


@jit
def _put_out(constants: Array, memory: Array, output: Array, b: int, lag: int) -> None:
    """Copy what leaves the chip."""
    for layer in range(len(constants.layers)):
        if constants.layers[layer, LEAVES]:
            own = constants.sources[layer + 1]
            for row in range(len(output)):
                at = raster_at(own, row - lag)
                _copy(memory.rasters[at : at + own[NEURONS]], output[row, b])


@jit
def _count(constants: Array, memory: Array, call: Array, steps: int) -> None:
    """The events of the window, as runtime.emulator.ledger.count_events."""
    layers, timesteps = constants.layers, call.timesteps
    for layer in range(len(layers)):
        of_layer, events = layers[layer], memory.counts[layer]
        for k in range(of_layer[FIRST_WIRE], of_layer[LAST_WIRE]):
            wire = constants.wires[k]
            # of the rows that the source emitted, not of those that arrived
            source, fan_out = constants.sources[wire[SOURCE]], constants.tables[wire[FAN_OUT] :]
            for row in range(timesteps):
                axons, spikes = spikes_of(source, memory, row)
                for axon in axons:
                    events[SPIKE_IN] += spikes[axon]
                    events[SOP] += spikes[axon] * fan_out[axon]
        for row in range(timesteps):
            axons, spikes = spikes_of(constants.sources[layer + 1], memory, row)
            for axon in axons:
                events[SPIKE_OUT] += spikes[axon]
        biased = timesteps - of_layer[HEAD] - of_layer[TAIL]
        always_on = biased if has_started(of_layer, call) else 0
        events[BIAS_SOP] = always_on * of_layer[BIAS_FAN_OUT]
        events[IDLE] = of_layer[SIZE] * steps - events[UPDATE]
        events[MESSAGE] = events[SPIKE_IN] + always_on * (of_layer[BIAS_FAN_OUT] > 0)
        if of_layer[IS_OUTPUT]:
            events[MESSAGE] += events[SPIKE_OUT] + always_on * of_layer[READ]


@jit
def _remember(constants: Array, memory: Array, call: Array) -> None:
    """Bring the last states to slot 0, and the last rows of sources before those of a window."""
    timesteps = call.timesteps
    last = timesteps if call.slots > 2 else timesteps & 1
    if last:
        for of_layer in constants.layers:
            width, first = of_layer[WIDTH], of_layer[STATE]
            at = first + last * width
            _copy(memory.states[at : at + width], memory.states[first : first + width])
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
