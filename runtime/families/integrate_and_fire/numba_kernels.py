"""The compiled kernels of integrate-and-fire neurons: a window of a whole program in one call.

A timestep as in `neurons`, in int64, rule by rule: passes over the neurons of a layer, whose sums
only the axons that spiked have touched; or event by event, where only neurons that an event reaches
are looked at. Loops that hold one rule each become vector instructions; spikes are counted, and
membranes reset, only where a threshold was passed.
"""

from typing import Any, NamedTuple

import numpy as np

from spikedeploy.runtime.families.numba_kernels import (
    BIAS,
    CHANNELS,
    FEATURES,
    FIRST_WIRE,
    IS_WINDOW,
    KERNEL_X,
    KERNEL_Y,
    LAG,
    LAST_WIRE,
    LAYER,
    NEURON,
    SATURATION,
    SIZE,
    SOURCE,
    TARGET_X,
    TARGET_Y,
    UPDATE,
    WEIGHT,
    Call,
    Memory,
    begin,
    end,
    is_heard,
    jit,
    kept_on_disk,
    list_spikes,
    locate,
    of_copy,
    pause,
    raster_at,
    sent,
    states_of,
    sum_weights,
    waits,
)

Array = Any  # the compiler sees the types
Number = Any

# columns of Constants.layers behind those of all families: whether its biases are an event, while
# the bias axon spikes and while it does not; whether its neurons have one threshold,
# floor and reset
HEARD_BIAS, UNHEARD_BIAS, ALIKE = range(len(LAYER), len(LAYER) + 3)
# entries of Constants.rules, as in IntegrateAndFireRules; of spikes AT_ONCE where the threshold is
# looked at once; a register holds LOWEST to HIGHEST
(
    LEAK, LEAKS_LAST, BY_EVENT, CHECKS_EVENTS, SPIKES_MAX, AT_ONCE, RESETS_LATE, SUBTRACT,
    OVERFLOW, BITS, LOWEST, HIGHEST, INPUT_MOST,
) = range(13)  # fmt: skip
LEAKS = {"none": 0, "linear": 1, "crossing": 2, "shift": 3}
NONE, LINEAR, CROSSING, SHIFT = LEAKS.values()
# what a register does when a number does not fit
OVERFLOWS = {"none": 0, "clip": 1, "saturate": 2, "wrap": 3, "wrap-once": 4}
WRAP, WRAP_ONCE = OVERFLOWS["wrap"], OVERFLOWS["wrap-once"]


class Constants(NamedTuple):
    """A program as arrays; those of its layers and synapses one after another.

    weights to sources: as in Wiring.
    rules: entries above.
    neurons: (6, N) fields of Neurons.
    """

    weights: Array
    tables: Array
    wires: Array
    layers: Array
    sources: Array
    rules: Array
    neurons: Array


class Neurons(NamedTuple):
    """Those of a layer, (N,) each.

    loss: leak of a timestep.
    threshold: what a spike subtracts.
    fires: least membrane that spikes.
    push: bias on the membrane.
    floor: least membrane.
    reset: membrane after a spike.
    """

    loss: Array
    threshold: Array
    fires: Array
    push: Array
    floor: Array
    reset: Array


@kept_on_disk
def run(
    weights: Array,
    tables: Array,
    wires: Array,
    layers: Array,
    sources: Array,
    rules: Array,
    neurons: Array,
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
    """One window of every layer; arguments and result as of the kernel of CuBa-LIF neurons."""
    constants = Constants(
        weights, tables, wires, layers, sources, rules, neurons
    )  # fmt: skip
    every = Memory(rasters, lists, lengths, states, refractory, counts, narrow, wide)
    timesteps, batch = presynaptic.shape[0], presynaptic.shape[1]
    call = Call(timesteps, slots, step, counting)
    if not begin(constants, every, call, rules[INPUT_MOST], fresh):
        return False
    turns, rows = (timesteps, 1) if rowwise else (1, timesteps)
    for turn in range(turns):
        for layer in range(len(layers)):
            for b in range(batch):
                memory = of_copy(every, b)
                for row in range(turn, turn + rows):
                    _timestep(constants, memory, call, layer, row)
    end(constants, every, call, presynaptic, lag, steps)
    return True


@jit
def _timestep(constants: Array, memory: Array, call: Array, layer: int, row: int) -> None:
    """A timestep of a layer, up to the list of its spikes."""
    about, own, rules = constants.layers[layer], constants.sources[layer + 1], constants.rules
    size, first = about[SIZE], about[NEURON]
    if waits(about, call):
        pause(about, own, memory, call, row)
        list_spikes(own, memory, row)
        return
    last, numbers = first + size, constants.neurons
    neurons = Neurons(
        numbers[0, first:last],
        numbers[1, first:last],
        numbers[2, first:last],
        numbers[3, first:last],
        numbers[4, first:last],
        numbers[5, first:last],
    )
    before, after = states_of(about, memory, call, row)
    spikes, arrived = memory.rasters[raster_at(own, row) :][:size], memory.wide[0, :size]
    if rules[BY_EVENT]:
        lost = _add_events(
            constants, memory, call, about, row, neurons, before, after, spikes, arrived
        )
    else:
        sum_weights(constants, memory, memory.wide, about, row, call, True)
        lost = _add_sums(rules, neurons, about, arrived, before, after, spikes)
    if rules[BY_EVENT] and not rules[CHECKS_EVENTS]:
        _fire(neurons, after, spikes)
    list_spikes(own, memory, row)
    if not rules[CHECKS_EVENTS]:
        fired, _ = sent(own, memory, row)
        for n in fired:
            _spike(rules, neurons, n, after, spikes)
    memory.counts[layer, SATURATION] += lost
    if call.counting:
        active = 0
        for n in range(size):
            active += (before[n] != 0) | (arrived[n] != 0)
        memory.counts[layer, UPDATE] += active


@jit
def _add_sums(
    rules: Array,
    neurons: Array,
    about: Array,
    sums: Array,
    before: Array,
    after: Array,
    spikes: Array,
) -> Number:
    """A timestep up to its spikes where all that arrives is one sum; how many did not fit.

    sums: (N,) of what arrives; biases on the membrane are added.
    """
    size, lost, leaks = len(sums), 0, rules[LEAK] != NONE
    lowest, highest = rules[LOWEST], rules[HIGHEST]
    start = before
    if rules[RESETS_LATE] or (leaks and not rules[LEAKS_LAST]):
        start = after
        _begin(rules, neurons, before, after)
    if about[UNHEARD_BIAS]:
        for n in range(size):
            sums[n] += neurons.push[n]
    if about[ALIKE] and rules[OVERFLOW] < WRAP and not rules[LEAKS_LAST]:
        # one pass over memory, of which large layers are a matter
        floor, fires = neurons.floor[0], neurons.fires[0]
        for n in range(size):
            raised = start[n] + sums[n]
            held = min(max(raised, lowest), highest)
            lost += held != raised
            kept = max(held, floor)
            after[n] = kept
            spikes[n] = kept >= fires
        return lost
    if rules[OVERFLOW] < WRAP:
        for n in range(size):
            raised = start[n] + sums[n]
            held = min(max(raised, lowest), highest)
            lost += held != raised
            after[n] = max(held, neurons.floor[n])
    else:
        for n in range(size):
            raised = start[n] + sums[n]
            held = _hold(rules, raised)
            lost += held != raised
            after[n] = max(held, neurons.floor[n])
    if rules[LEAKS_LAST]:
        _leak_all(rules, neurons, after, after)
    _fire(neurons, after, spikes)
    return lost


@jit
def _fire(neurons: Array, membranes: Array, spikes: Array) -> None:
    """Spikes (N,) of membranes that are high enough, one each."""
    for n in range(len(membranes)):
        spikes[n] = membranes[n] >= neurons.fires[n]


@jit
def _begin(rules: Array, neurons: Array, before: Array, after: Array) -> None:
    """The leak at the start of a timestep, and the resets that take its place."""
    _leak_all(rules, neurons, before, after)
    if rules[RESETS_LATE]:
        for n in range(len(after)):
            if before[n] >= neurons.fires[n]:
                after[n] = _after_spike(rules, neurons, n, before[n])


@jit
def _leak_all(rules: Array, neurons: Array, before: Array, after: Array) -> None:
    """As _leak of the specification."""
    leak = rules[LEAK]
    for n in range(len(after)):
        v, loss = before[n], neurons.loss[n]
        if leak == LINEAR:
            v = max(v - loss, 0) if v >= 0 else min(v + loss, 0)
        elif leak == CROSSING:
            v = v - loss if v > 0 else v + loss if v < 0 else v
        elif leak == SHIFT:
            v = v if loss < 0 else v - (v >> min(loss, 63))
        after[n] = v


@jit
def _add_events(
    constants: Array,
    memory: Array,
    call: Array,
    about: Array,
    row: int,
    neurons: Array,
    before: Array,
    after: Array,
    spikes: Array,
    arrived: Array,
) -> Number:
    """A timestep in which each spike is an event; how many numbers did not fit.

    arrived: (N,) memory for whether any weight did.
    """
    rules, weights, size, lost = constants.rules, constants.weights, about[SIZE], 0
    for n in range(size):
        after[n], spikes[n], arrived[n] = before[n], 0, 0
    if not rules[LEAKS_LAST]:
        _begin(rules, neurons, before, after)
        if rules[CHECKS_EVENTS] and rules[LEAK] != NONE:
            # the leak is an event, too
            for n in range(size):
                lost += _spike_once(rules, neurons, n, after, spikes)
    for k in range(about[FIRST_WIRE], about[LAST_WIRE]):
        wire = constants.wires[k]
        axons, counts = sent(constants.sources[wire[SOURCE]], memory, row - wire[LAG])
        for axon in axons:
            at = wire[WEIGHT] + axon * size
            for _ in range(counts[axon]):
                if wire[IS_WINDOW]:
                    lost += _arrive_through(constants, wire, axon, neurons, after, spikes, arrived)
                elif rules[OVERFLOW] < WRAP:
                    row_of = weights[at : at + size]
                    lost += _arrive_row(
                        rules, neurons, about[ALIKE], row_of, after, memory.wide[1, :size]
                    )
                else:
                    for n in range(size):
                        weight = weights[at + n]
                        lost += _arrive(rules, neurons, n, weight, after, spikes, arrived)
            if not wire[IS_WINDOW] and rules[OVERFLOW] < WRAP and call.counting:
                for n in range(size):
                    arrived[n] |= weights[at + n] != 0
        lost += _sum_spikes(rules, memory.wide[1, :size], spikes)
    heard = is_heard(about, row, call.timesteps)
    if about[HEARD_BIAS if heard else UNHEARD_BIAS]:
        for n in range(size):
            bias = neurons.push[n]
            if heard:
                bias += weights[about[BIAS] + n]
            lost += _arrive(rules, neurons, n, bias, after, spikes, arrived)
    if rules[LEAKS_LAST]:
        _leak_all(rules, neurons, after, after)
    return lost


@jit
def _arrive_through(
    constants: Array,
    wire: Array,
    axon: int,
    neurons: Array,
    membranes: Array,
    spikes: Array,
    arrived: Array,
) -> Number:
    """An event on an axon of a window; how many numbers did not fit."""
    tables, weights, rules, lost = constants.tables, constants.weights, constants.rules, 0
    channel, rows, columns = locate(wire, axon)
    features, places = wire[FEATURES], wire[TARGET_Y] * wire[TARGET_X]
    first = channel // wire[CHANNELS] * features * places
    at = wire[WEIGHT] + channel * wire[KERNEL_Y] * wire[KERNEL_X] * features
    for i in range(wire[KERNEL_Y]):
        for j in range(wire[KERNEL_X]):
            y, x = tables[rows + i], tables[columns + j]
            if y >= 0 and x >= 0:
                for feature in range(features):
                    n = first + feature * places + y * wire[TARGET_X] + x
                    weight = weights[at + (i * wire[KERNEL_X] + j) * features + feature]
                    lost += _arrive(rules, neurons, n, weight, membranes, spikes, arrived)
    return lost


@jit
def _arrive_row(
    rules: Array, neurons: Array, alike: Number, row: Array, membranes: Array, fired: Array
) -> Number:
    """An event that reaches neurons by a row of weights; how many numbers did not fit.

    fired: (N,) to which their spikes are added. Of neurons that are alike, numbers stay in the type
        of the membranes, and few arrays are read: so the compiler makes vector instructions.
    """
    whole = membranes.dtype.type
    lost = whole(0)
    lowest, highest = whole(rules[LOWEST]), whole(rules[HIGHEST])
    floor, fires, reset = neurons.floor[0], neurons.fires[0], neurons.reset[0]
    threshold = neurons.threshold[0]
    if not alike:
        for n in range(len(row)):
            raised = membranes[n] + row[n]
            held = min(max(raised, rules[LOWEST]), rules[HIGHEST])
            lost = whole(lost + (held != raised))
            membranes[n] = max(held, neurons.floor[n])
            if rules[CHECKS_EVENTS] and membranes[n] >= neurons.fires[n]:
                membranes[n] = _after_spike(rules, neurons, n, membranes[n])
                fired[n] += 1
    elif not rules[CHECKS_EVENTS]:
        for n in range(len(row)):
            raised = whole(membranes[n] + row[n])
            held = min(max(raised, lowest), highest)
            lost = whole(lost + whole(held != raised))
            membranes[n] = max(held, floor)
    elif rules[SUBTRACT]:
        for n in range(len(row)):
            raised = whole(membranes[n] + row[n])
            held = min(max(raised, lowest), highest)
            lost = whole(lost + whole(held != raised))
            v = max(held, floor)
            spikes = v >= fires
            membranes[n] = whole(v - threshold) if spikes else v
            fired[n] = whole(fired[n] + whole(spikes))
    else:
        for n in range(len(row)):
            raised = whole(membranes[n] + row[n])
            held = min(max(raised, lowest), highest)
            lost = whole(lost + whole(held != raised))
            v = max(held, floor)
            spikes = v >= fires
            membranes[n] = reset if spikes else v
            fired[n] = whole(fired[n] + whole(spikes))
    return lost


@jit
def _sum_spikes(rules: Array, fired: Array, spikes: Array) -> Number:
    """Add up spikes of events, and clear them; how many are more than can be counted."""
    most, lost = rules[SPIKES_MAX], 0
    for n in range(len(spikes)):
        total = spikes[n] + fired[n]
        lost += max(total - most, 0)
        spikes[n], fired[n] = min(total, most), 0
    return lost


@jit
def _arrive(
    rules: Array,
    neurons: Array,
    n: int,
    weight: int,
    membranes: Array,
    spikes: Array,
    arrived: Array,
) -> Number:
    """An event that reaches a neuron; how many numbers did not fit."""
    raised = membranes[n] + weight
    held = _hold(rules, raised)
    membranes[n] = max(held, neurons.floor[n])
    arrived[n] |= weight != 0
    lost = np.int64(held != raised)
    if rules[CHECKS_EVENTS]:
        lost += _spike_once(rules, neurons, n, membranes, spikes)
    return lost


@jit
def _spike(rules: Array, neurons: Array, n: int, membranes: Array, spikes: Array) -> None:
    """The spikes at the end of a timestep of a neuron that has some."""
    fired, left = 0, membranes[n]
    while fired < rules[AT_ONCE] and left >= neurons.fires[n]:
        fired, left = fired + 1, left - neurons.threshold[n]
        if not rules[RESETS_LATE]:
            membranes[n] = _after_spike(rules, neurons, n, membranes[n])
    spikes[n] = fired


@jit
def _spike_once(rules: Array, neurons: Array, n: int, membranes: Array, spikes: Array) -> Number:
    """A spike, if the membrane is high enough; 1 if it is more than can be counted."""
    if membranes[n] < neurons.fires[n]:
        return 0
    membranes[n] = _after_spike(rules, neurons, n, membranes[n])
    if spikes[n] >= rules[SPIKES_MAX]:
        return 1
    spikes[n] += 1
    return 0


@jit
def _after_spike(rules: Array, neurons: Array, n: int, v: Number) -> Number:
    """As _after_spike of the specification."""
    return v - neurons.threshold[n] if rules[SUBTRACT] else neurons.reset[n]


@jit
def _hold(rules: Array, x: Number) -> Number:
    """As Register.fit."""
    if rules[OVERFLOW] < WRAP:
        return min(max(x, rules[LOWEST]), rules[HIGHEST])
    half = np.int64(1) << (rules[BITS] - 1)
    if rules[OVERFLOW] == WRAP:
        return (x + half) % (2 * half) - half
    if x > half:
        return x - 2 * half
    return x + 2 * half if x <= -half else x
