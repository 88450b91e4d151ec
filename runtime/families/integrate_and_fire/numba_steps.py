"""The Numba backend of integrate-and-fire neurons, equal to `update` of the specification.

A timestep as in `neurons`, in whole numbers, rule by rule: passes over the neurons of a layer,
whose sums only the axons that spiked have touched; or event by event, where only neurons that an
event reaches are looked at. Loops that hold one rule each become vector instructions; spikes are
counted, and membranes reset, only where a threshold was passed.
"""

from typing import ClassVar, NamedTuple, cast

import numpy as np

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families import numba_frame as frame
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.neurons import (
    Integers,
    IntegrateAndFireRules,
    floor_of,
)
from spikedeploy.runtime.families.numba_frame import Array, Number
from spikedeploy.runtime.families.numba_pipeline import (
    EXACT_INT16,
    FamilyNumbers,
    NumbaPipeline,
    describe_register,
    edges,
    largest_weight,
)

# columns of Constants.layers behind those of all families
(
    AXON_BIASED,  # whether its biases are an event while the bias axon spikes
    BIASED,  # whether they are one while it does not
    ALIKE,  # whether its neurons have one threshold, floor and reset
) = range(len(frame.LAYER), len(frame.LAYER) + 3)
# entries of Constants.rules, as in IntegrateAndFireRules; of spikes AT_ONCE where the threshold is
# looked at once; the four entries of the membrane, as in frame.fit, are the last
(
    LEAK, LEAKS_LAST, BY_EVENT, CHECKS_EVENTS, SPIKES_MAX, AT_ONCE, RESETS_LATE, SUBTRACT,
    OVERFLOW, BITS, LOWEST, HIGHEST,
) = range(1, 13)  # fmt: skip
LEAKS = {"none": 0, "linear": 1, "crossing": 2, "shift": 3}
NONE, LINEAR, CROSSING, SHIFT = LEAKS.values()
_NARROW_BITS = 31  # of a membrane that int32 holds, with what the host may read of it


class Neurons(NamedTuple):
    """Numbers of the neurons of a layer, (N,) each: the rows of Constants.neurons.

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


@frame.jit
def _step(
    constants: Array,
    memory: Array,
    call: Array,
    layer: int,
    row: int,
    before: Array,
    after: Array,
    spikes: Array,
) -> tuple[int, int]:
    """A timestep of a layer."""
    of_layer, own, rules = constants.layers[layer], constants.sources[layer + 1], constants.rules
    size, first = of_layer[frame.SIZE], of_layer[frame.NEURON]
    last, numbers = first + size, constants.neurons
    neurons = Neurons(
        numbers[0, first:last],
        numbers[1, first:last],
        numbers[2, first:last],
        numbers[3, first:last],
        numbers[4, first:last],
        numbers[5, first:last],
    )
    arrived = memory.wide[0, :size]
    if rules[BY_EVENT]:
        lost = _add_events(
            constants, memory, call, of_layer, row, neurons, before, after, spikes, arrived
        )
    else:
        frame.sum_weights(constants, memory, memory.wide, of_layer, row, call, True)
        lost = _add_sums(rules, neurons, of_layer, arrived, before, after, spikes)
    if rules[BY_EVENT] and not rules[CHECKS_EVENTS]:
        _fire(neurons, after, spikes)
    frame.list_spikes(own, memory, row)
    if not rules[CHECKS_EVENTS]:
        fired, _ = frame.spikes_of(own, memory, row)
        for n in fired:
            _spike(rules, neurons, n, after, spikes)
    active = 0
    if call.counting:
        for n in range(size):
            active += (before[n] != 0) | (arrived[n] != 0)
    return lost, active


@frame.jit
def _add_sums(
    rules: Array,
    neurons: Array,
    of_layer: Array,
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
    if of_layer[BIASED]:
        for n in range(size):
            sums[n] += neurons.push[n]
    if of_layer[ALIKE] and rules[OVERFLOW] == frame.CLAMP and not rules[LEAKS_LAST]:
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
    if rules[OVERFLOW] == frame.CLAMP:
        for n in range(size):
            raised = start[n] + sums[n]
            held = min(max(raised, lowest), highest)
            lost += held != raised
            after[n] = max(held, neurons.floor[n])
    else:
        for n in range(size):
            raised = start[n] + sums[n]
            held = frame.fit(raised, rules, OVERFLOW)
            lost += held != raised
            after[n] = max(held, neurons.floor[n])
    if rules[LEAKS_LAST]:
        _leak_all(rules, neurons, after, after)
    _fire(neurons, after, spikes)
    return lost


@frame.jit
def _fire(neurons: Array, membranes: Array, spikes: Array) -> None:
    """Spikes (N,) of membranes that are high enough, one each."""
    for n in range(len(membranes)):
        spikes[n] = membranes[n] >= neurons.fires[n]


@frame.jit
def _begin(rules: Array, neurons: Array, before: Array, after: Array) -> None:
    """The leak at the start of a timestep, and the resets that take its place."""
    _leak_all(rules, neurons, before, after)
    if rules[RESETS_LATE]:
        for n in range(len(after)):
            if before[n] >= neurons.fires[n]:
                after[n] = _after_spike(rules, neurons, n, before[n])


@frame.jit
def _leak_all(rules: Array, neurons: Array, before: Array, after: Array) -> None:
    """Equal `_leak` of the specification."""
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


@frame.jit
def _add_events(
    constants: Array,
    memory: Array,
    call: Array,
    of_layer: Array,
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
    rules, weights, size, lost = constants.rules, constants.weights, of_layer[frame.SIZE], 0
    for n in range(size):
        after[n], spikes[n], arrived[n] = before[n], 0, 0
    if not rules[LEAKS_LAST]:
        _begin(rules, neurons, before, after)
        if rules[CHECKS_EVENTS] and rules[LEAK] != NONE:
            # the leak is an event, too
            for n in range(size):
                lost += _spike_once(rules, neurons, n, after, spikes)
    for k in range(of_layer[frame.FIRST_WIRE], of_layer[frame.LAST_WIRE]):
        wire = constants.wires[k]
        axons, counts = frame.arrivals(constants, memory, wire, row)
        for axon in axons:
            at = wire[frame.WEIGHT] + axon * size
            for _ in range(counts[axon]):
                if wire[frame.IS_WINDOW]:
                    lost += _arrive_through(constants, wire, axon, neurons, after, spikes, arrived)
                else:
                    for n in range(size):
                        weight = weights[at + n]
                        lost += _arrive(rules, neurons, n, weight, after, spikes, arrived)
    biased = frame.has_bias(of_layer, row, call.timesteps)
    if of_layer[AXON_BIASED if biased else BIASED]:
        for n in range(size):
            bias = neurons.push[n]
            if biased:
                bias += weights[of_layer[frame.BIAS] + n]
            lost += _arrive(rules, neurons, n, bias, after, spikes, arrived)
    if rules[LEAKS_LAST]:
        _leak_all(rules, neurons, after, after)
    return lost


@frame.jit
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
    channel, rows, columns = frame.locate(wire, axon)
    features, places = wire[frame.FEATURES], wire[frame.TARGET_Y] * wire[frame.TARGET_X]
    first = channel // wire[frame.CHANNELS] * features * places
    at = wire[frame.WEIGHT] + channel * wire[frame.KERNEL_Y] * wire[frame.KERNEL_X] * features
    for i in range(wire[frame.KERNEL_Y]):
        for j in range(wire[frame.KERNEL_X]):
            y, x = tables[rows + i], tables[columns + j]
            if y >= 0 and x >= 0:
                for feature in range(features):
                    n = first + feature * places + y * wire[frame.TARGET_X] + x
                    weight = weights[at + (i * wire[frame.KERNEL_X] + j) * features + feature]
                    lost += _arrive(rules, neurons, n, weight, membranes, spikes, arrived)
    return lost


@frame.jit
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
    held = frame.fit(raised, rules, OVERFLOW)
    membranes[n] = max(held, neurons.floor[n])
    arrived[n] |= weight != 0
    lost = np.int64(held != raised)
    if rules[CHECKS_EVENTS]:
        lost += _spike_once(rules, neurons, n, membranes, spikes)
    return lost


@frame.jit
def _spike(rules: Array, neurons: Array, n: int, membranes: Array, spikes: Array) -> None:
    """The spikes at the end of a timestep of a neuron that has some."""
    fired, left = 0, membranes[n]
    while fired < rules[AT_ONCE] and left >= neurons.fires[n]:
        fired, left = fired + 1, left - neurons.threshold[n]
        if not rules[RESETS_LATE]:
            membranes[n] = _after_spike(rules, neurons, n, membranes[n])
    spikes[n] = fired


@frame.jit
def _spike_once(rules: Array, neurons: Array, n: int, membranes: Array, spikes: Array) -> Number:
    """A spike, if the membrane is high enough; 1 if it is more than can be counted."""
    if membranes[n] < neurons.fires[n]:
        return 0
    membranes[n] = _after_spike(rules, neurons, n, membranes[n])
    if spikes[n] >= rules[SPIKES_MAX]:
        return 1
    spikes[n] += 1
    return 0


@frame.jit
def _after_spike(rules: Array, neurons: Array, n: int, v: Number) -> Number:
    """Equal `_after_spike` of the specification."""
    return v - neurons.threshold[n] if rules[SUBTRACT] else neurons.reset[n]


_run = frame.kernel(_step)


class IntegrateAndFirePipeline(NumbaPipeline):
    """Integrate-and-fire layers as a Backend, in timesteps."""

    states_of_neuron: ClassVar[int] = 1
    kernel = staticmethod(_run)

    @staticmethod
    def numbers(program: Program) -> FamilyNumbers:
        """Return the rules of the chip, and the numbers of neurons."""
        rules, layers = cast("IntegrateAndFire", program.chip.arithmetic), program.layers
        numbers = [_numbers(rules, program.convention, a) for a in layers]
        subtract = program.convention.reset == "subtract"
        several = rules.checks == "step" and (subtract or program.convention.spikes == "many")
        neurons = _narrowed(np.concatenate(numbers, axis=1), program, rules)
        return FamilyNumbers(
            columns=[
                (bool((a.bias + a.voltage_bias).any()), bool(a.voltage_bias.any()), _alike(each))
                for a, each in zip(layers, numbers, strict=True)
            ],
            weights=np.int16 if largest_weight(layers) <= EXACT_INT16 else np.int64,
            states=neurons.dtype,
            sums=(neurons.dtype, neurons.dtype),
            rules=[
                LEAKS[rules.leak],
                rules.leak_order == "last",
                rules.adds == "event",
                rules.checks == "event",
                rules.spikes_max,
                rules.spikes_max if several else 1,
                rules.reset_at == "leak",
                subtract,
                *describe_register(rules.membrane),
            ],
            neurons=neurons,
        )

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        rules = cast("IntegrateAndFire", program.chip.arithmetic)
        if rules.membrane.between and edges(rules.membrane) is None:
            return (
                f"chip {program.chip.name!r} has a membrane that the compiled kernels do not know: "
                "one that wraps and has a narrower range."
            )
        return NumbaPipeline.obstacle(program)


def _narrowed(numbers: Integers, program: Program, rules: IntegrateAndFireRules) -> Integers:
    """The numbers of neurons in the type that membranes and sums get, int32 where all fit in it.

    Numba adds integers in int64 whatever their types are; large layers take half the memory.
    """
    edge = np.iinfo(np.int32)
    times = dict.fromkeys(program.sizes, max(program.chip.input_spikes_max, rules.spikes_max))
    most = max(int((a.most_arriving(times) + abs(a.voltage_bias)).max()) for a in program.layers)
    bounded = rules.membrane.overflow not in ("none", "wrap-once") or rules.membrane.between
    if not bounded or rules.membrane.bits > _NARROW_BITS or most > edge.max:
        return numbers
    floorless = np.maximum(numbers, edge.min)  # a floor that is none may be lower
    return floorless.astype(np.int32) if floorless.max(initial=0) <= edge.max else numbers


def _alike(numbers: Integers) -> bool:
    """Return whether the neurons of a layer have one threshold, one floor and one reset."""
    neurons = Neurons(*numbers)
    return not any(np.ptp(each) for each in (neurons.fires, neurons.floor, neurons.reset))


def _numbers(rules: IntegrateAndFireRules, convention: Convention, layer: Layer) -> Integers:
    """(6, N) of a layer, as in Neurons."""
    each = Neurons(
        loss=layer.membrane_decay,
        threshold=layer.threshold,
        fires=layer.threshold + (rules.fires == "above"),
        push=layer.voltage_bias,
        floor=floor_of(rules, convention, layer),
        reset=layer.v_reset,
    )
    return np.stack([np.broadcast_to(values, (layer.size,)).astype(np.int64) for values in each])
