"""The Numba backend of Xylo: its neurons in compiled kernels, equal to `XyloArithmetic.update`.

Events are added as one sum where no part of it can saturate, else one after another. All that
follows is a pass over the neurons of a layer, in which the compiler makes vector instructions.
"""

from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.families.numba_kernels import (
    FIRST_WIRE,
    LAG,
    LAST_WIRE,
    LAYER,
    NEURON,
    SATURATION,
    SIZE,
    SOURCE,
    UPDATE,
    WEIGHT,
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
    sent,
    states_of,
    sum_weights,
    waits,
)
from spikedeploy.runtime.families.numba_pipeline import (
    Delays,
    NumbaPipeline,
    largest_weight,
    wire,
)
from spikedeploy.runtime.families.xylo import XyloArithmetic

Array = Any  # the compiler sees the types
Number = Any

# column of Constants.layers behind those of all families: spikes of a neuron in a timestep
SPIKES_MAX = len(LAYER)
# entries of Constants.rules: least and largest state, what decay adds to the least membrane where
# all of it is lost, the largest weight, and events of an input channel in a timestep
LOWEST, HIGHEST, TURNED, LARGEST, INPUT_MOST = range(5)
# rows of Constants.neurons
CURRENT_DASH, MEMBRANE_DASH, THRESHOLD, BIAS_OF = range(4)

_WIDEST = 28  # bits of a state, of which int32 holds sums of a few
_SMALL = (1 << 15) - 1  # largest weight that 16 bits hold


class Constants(NamedTuple):
    """A program as arrays; those of its layers and synapses one after another.

    weights to sources: as in Wiring.
    rules: entries above.
    neurons: (4, N) rows above.
    """

    weights: Array
    tables: Array
    wires: Array
    layers: Array
    sources: Array
    rules: Array
    neurons: Array


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
    constants = Constants(weights, tables, wires, layers, sources, rules, neurons)
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
    about, own = constants.layers[layer], constants.sources[layer + 1]
    size, first = about[SIZE], about[NEURON]
    if waits(about, call):
        pause(about, own, memory, call, row)
        list_spikes(own, memory, row)
        return
    before, after = states_of(about, memory, call, row)
    numbers = constants.neurons[:, first : first + size]
    current, membrane = after[:size], after[size:]
    lost = _add_events(constants, memory, call, about, row, before[:size], current)
    _decay(numbers[CURRENT_DASH], current)
    lost += _integrate(constants.rules, numbers, before[size:], current, membrane)
    spikes = memory.rasters[raster_at(own, row) :][:size]
    for n in range(size):
        spikes[n] = membrane[n] >= numbers[THRESHOLD, n]
    list_spikes(own, memory, row)
    fired, _ = sent(own, memory, row)
    for n in fired:
        # as many spikes as there are thresholds to take off
        times = min(membrane[n] // numbers[THRESHOLD, n], about[SPIKES_MAX])
        membrane[n] -= times * numbers[THRESHOLD, n]
        spikes[n] = times
    memory.counts[layer, SATURATION] += lost
    if call.counting:
        active = 0
        for n in range(size):
            active += (before[size + n] != 0) | (current[n] != 0) | (numbers[BIAS_OF, n] != 0)
        memory.counts[layer, UPDATE] += active


@jit
def _add_events(
    constants: Array,
    memory: Array,
    call: Array,
    about: Array,
    row: int,
    before: Array,
    after: Array,
) -> Number:
    """Currents (N,) with the events of a timestep; how many additions did not fit."""
    rules, size, whole = constants.rules, about[SIZE], after.dtype.type
    events, largest = 0, 0
    for k in range(about[FIRST_WIRE], about[LAST_WIRE]):
        wire = constants.wires[k]
        axons, counts = sent(constants.sources[wire[SOURCE]], memory, row - wire[LAG])
        for axon in axons:
            events += counts[axon]
    for n in range(size):
        largest = max(largest, abs(before[n]))
    if largest + events * rules[LARGEST] <= rules[HIGHEST]:
        # no partial sum can saturate, and so their order does not matter
        sum_weights(constants, memory, memory.wide, about, row, call, True)
        sums = memory.wide[0, :size]
        for n in range(size):
            after[n] = whole(before[n] + sums[n])
        return 0
    lost = 0
    for n in range(size):
        after[n] = before[n]
    for k in range(about[FIRST_WIRE], about[LAST_WIRE]):
        wire = constants.wires[k]
        axons, counts = sent(constants.sources[wire[SOURCE]], memory, row - wire[LAG])
        for axon in axons:
            at = wire[WEIGHT] + axon * size
            for _ in range(counts[axon]):
                lost += _add_event(rules, constants.weights[at : at + size], after)
    return lost


@jit
def _add_event(rules: Array, row: Array, current: Array) -> Number:
    """Add the weights of an event to currents; how many did not fit."""
    whole = current.dtype.type
    lowest, highest, lost = whole(rules[LOWEST]), whole(rules[HIGHEST]), whole(0)
    for n in range(len(row)):
        raised = whole(current[n] + row[n])
        held = min(max(raised, lowest), highest)
        lost = whole(lost + whole(held != raised))
        current[n] = held
    return lost


@jit
def _decay(dash: Array, states: Array) -> None:
    """States after the decay of a timestep."""
    whole = states.dtype.type
    for n in range(len(states)):
        states[n] = whole(states[n] - _loss(whole, states[n], dash[n]))


@jit
def _loss(whole: Any, x: Number, dash: Number) -> Number:  # noqa: ANN401
    """As shift_decay of runtime.chips.registers."""
    shifted = whole(x >> dash)
    sign = whole(whole(x > 0) - whole(x < 0))
    return shifted if shifted != 0 else sign


@jit
def _integrate(rules: Array, numbers: Array, before: Array, current: Array, after: Array) -> Number:
    """Write membranes (N,) before spikes; how many sums did not fit."""
    whole = after.dtype.type
    lowest, highest, turned = whole(rules[LOWEST]), whole(rules[HIGHEST]), whole(rules[TURNED])
    dash, bias, lost = numbers[MEMBRANE_DASH], numbers[BIAS_OF], whole(0)
    for n in range(len(after)):
        leak = whole(-_loss(whole, before[n], dash[n]))
        leak = turned if leak == -lowest else leak
        first = whole(current[n] + leak)
        change = min(max(first, lowest), highest)
        second = whole(change + bias[n])
        pushed = min(max(second, lowest), highest)
        third = whole(before[n] + pushed)
        held = min(max(third, lowest), highest)
        lost = whole(lost + whole(change != first) + whole(pushed != second) + whole(held != third))
        after[n] = held
    return lost


def _edges(register: Register) -> tuple[int, int] | None:
    """Least and largest number that it holds; None where it does not stop there."""
    if register.overflow not in ("saturate", "clip") or register.between is not None:
        return None
    low, high = register.fit(np.array([-(1 << 40), 1 << 40])).tolist()
    return low, high


@lru_cache(maxsize=8)
def constants(program: Program, rules: XyloArithmetic, delays: Delays, windows: bool) -> Constants:
    """As NumbaPipeline.constants; shared by the machines of a program."""
    layers = program.layers
    low, high = _edges(rules.state) or (0, 0)
    most = [
        rules.output_spikes_max
        if layer.name == program.output and program.output_apart
        else rules.spikes_max
        for layer in layers
    ]
    numbers = [
        np.stack(
            [
                np.broadcast_to(values, (layer.size,)).astype(np.int64)
                for values in (
                    layer.current_decay[0],
                    layer.membrane_decay,
                    # of neurons that never spike, beyond what int32 holds
                    np.minimum(layer.threshold, np.iinfo(np.int32).max),
                    layer.voltage_bias,
                )
            ]
        )
        for layer in layers
    ]
    largest = largest_weight(layers)
    (turned,) = rules.leak.fit(np.array([-low])).tolist()
    return Constants(
        *wire(
            program,
            delays,
            windows,
            XyloPipeline.states_of_neuron,
            [(each,) for each in most],
            np.int16 if largest <= _SMALL else np.int64,
        ),
        rules=np.array([low, high, turned, largest, program.chip.input_spikes_max], np.int64),
        neurons=np.concatenate(numbers, axis=1).astype(np.int32),
    )


class XyloPipeline(NumbaPipeline):
    """Xylo's layers as a Backend, whose neurons have one current each."""

    states_of_neuron: ClassVar[int] = 2
    kernel = staticmethod(run)

    @staticmethod
    def constants(program: Program, delays: Delays, windows: bool) -> Constants:
        """All that does not change while the program runs."""
        rules = cast("XyloArithmetic", program.chip.arithmetic)
        return constants(program, rules, delays, windows)

    @staticmethod
    def state_type(constants: Any) -> DTypeLike:  # noqa: ANN401
        """Number type of currents and membranes."""
        return np.int32

    @staticmethod
    def sum_types(constants: Any) -> tuple[DTypeLike, DTypeLike]:  # noqa: ANN401
        """Number types of the narrow sums, which it does not use, and of the wide."""
        return np.int32, np.int32

    @staticmethod
    def both(states: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Currents (B, ..., 1, N), of which neurons can have several, and membranes (B, ..., N)."""
        return states[0][..., None, :], states[-1]

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        rules = cast("XyloArithmetic", program.chip.arithmetic)
        edges = _edges(rules.state)
        if edges is None or rules.state.bits > _WIDEST or rules.leak.limit < edges[1]:
            return (
                f"chip {program.chip.name!r} has registers that the compiled kernels do not know: "
                "states that do not saturate, or a leak that is narrower than they are."
            )
        for layer in program.layers:
            several = len(layer.current_decay) > 1 or any(s.current for s in layer.synapses)
            if several or any(layer.aliases) or any(s.window for s in layer.synapses):
                return (
                    f"layer {layer.name!r}: neurons with several currents, spikes that are counted "
                    "for others, and kernels are supported by the interpreter alone."
                )
            if abs(layer.voltage_bias).max(initial=0) > rules.state.limit:
                return f"layer {layer.name!r}: its bias is beyond what a membrane holds."
        return NumbaPipeline.obstacle(program)
