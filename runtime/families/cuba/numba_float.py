"""The Numba backend of CuBa-LIF layers in float32, equal to `float_update` of the specification.

Weights are whole numbers, whose sums float32 holds exactly below 2**24; everything else is computed
in the order of the specification, which the compiler keeps.
"""

from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.families.numba_kernels import (
    LAYER,
    NEURON,
    SIZE,
    UPDATE,
    Call,
    Memory,
    begin,
    end,
    is_heard,
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
from spikedeploy.runtime.families.numba_pipeline import (
    Delays,
    NumbaPipeline,
    largest_weight,
    wire,
)

Array = Any  # the compiler sees the types
Number = Any

# column of Constants.layers behind those of all families: whether neurons have biases of an axon
HAS_BIAS = len(LAYER)
# rows of Constants.neurons
CURRENT_DECAY, MEMBRANE_DECAY, THRESHOLD, VOLTAGE_BIAS, BIAS_OF = range(5)

_EXACT = 1 << 24  # whole numbers that float32 holds


class Constants(NamedTuple):
    """A program as arrays; those of its layers and synapses one after another.

    weights to sources: as in Wiring, without biases.
    neurons: (5, N) rows above, float32.
    subtract: (1,) whether a spike takes the threshold off.
    """

    weights: Array
    tables: Array
    wires: Array
    layers: Array
    sources: Array
    neurons: Array
    subtract: Array


@kept_on_disk
def run(
    weights: Array,
    tables: Array,
    wires: Array,
    layers: Array,
    sources: Array,
    neurons: Array,
    subtract: Array,
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
    """One window of every layer; arguments and result as of the kernel in integers."""
    constants = Constants(weights, tables, wires, layers, sources, neurons, subtract)
    every = Memory(rasters, lists, lengths, states, refractory, counts, narrow, wide)
    timesteps, batch = presynaptic.shape[0], presynaptic.shape[1]
    call = Call(timesteps, slots, step, counting)
    if not begin(constants, every, call, 1, fresh):
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
    spikes = memory.rasters[raster_at(own, row) :][:size]
    sum_weights(constants, memory, memory.wide, about, row, call, False)
    biased = about[HAS_BIAS] and is_heard(about, row, call.timesteps)
    _drive(numbers, memory.wide[0, :size], biased, before[:size], current)
    _integrate(numbers, before[size:], current, membrane)
    _fire(numbers[THRESHOLD], constants.subtract[0], membrane, spikes)
    list_spikes(own, memory, row)
    if call.counting:
        active = 0
        for n in range(size):
            bias = numbers[VOLTAGE_BIAS, n]
            active += (before[size + n] != 0) | (current[n] != 0) | (bias != 0)
        memory.counts[layer, UPDATE] += active


@jit
def _drive(numbers: Array, sums: Array, biased: Number, before: Array, after: Array) -> None:
    """Write I = a I + (bias + W s)."""
    decay, bias = numbers[CURRENT_DECAY], numbers[BIAS_OF]
    whole = after.dtype.type
    if biased:
        for n in range(len(after)):
            after[n] = decay[n] * before[n] + (bias[n] + whole(sums[n]))
    else:
        for n in range(len(after)):
            after[n] = decay[n] * before[n] + whole(sums[n])


@jit
def _integrate(numbers: Array, before: Array, current: Array, after: Array) -> None:
    """Write V = b V + I + bias."""
    decay, bias = numbers[MEMBRANE_DECAY], numbers[VOLTAGE_BIAS]
    for n in range(len(after)):
        after[n] = decay[n] * before[n] + current[n] + bias[n]


@jit
def _fire(threshold: Array, subtract: Number, membrane: Array, spikes: Array) -> None:
    """Write spikes (N,), and reset membranes."""
    for n in range(len(membrane)):
        fired = membrane[n] > threshold[n]
        rest = membrane[n] - threshold[n] if subtract else membrane.dtype.type(0)
        membrane[n] = rest if fired else membrane[n]
        spikes[n] = fired


@lru_cache(maxsize=8)
def constants(program: Program, delays: Delays, windows: bool) -> Constants:
    """As NumbaPipeline.constants; shared by the machines of a program."""
    layers = program.layers
    known = wire(
        program,
        delays,
        windows,
        FloatPipeline.states_of_neuron,
        [(bool(layer.bias.any()),) for layer in layers],
        np.int16,
    )
    known.weights[-sum(layer.size for layer in layers) :] = 0  # biases are no whole numbers
    return Constants(
        *known,
        neurons=np.concatenate([_numbers(layer) for layer in layers], axis=1),
        subtract=np.array([program.convention.reset == "subtract"]),
    )


def _numbers(layer: Layer) -> Array:
    """(5, N) of a layer."""
    each = (
        layer.current_decay, layer.membrane_decay, layer.threshold, layer.voltage_bias, layer.bias
    )  # fmt: skip
    return np.stack([np.broadcast_to(a, (layer.size,)) for a in each]).astype(np.float32)


class FloatPipeline(NumbaPipeline):
    """CuBa-LIF layers in float32 as a Backend."""

    states_of_neuron: ClassVar[int] = 2
    recorded: ClassVar[DTypeLike] = np.float32
    kernel = staticmethod(run)

    @staticmethod
    def constants(program: Program, delays: Delays, windows: bool) -> Constants:
        """All that does not change while the program runs."""
        return constants(program, delays, windows)

    @staticmethod
    def state_type(constants: Any) -> DTypeLike:  # noqa: ANN401
        """Number type of currents and membranes."""
        return np.float32

    @staticmethod
    def sum_types(constants: Any) -> tuple[DTypeLike, DTypeLike]:  # noqa: ANN401
        """Number types of the narrow sums, which it does not use, and of the wide."""
        return np.int32, np.int32

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        for layer in program.layers:
            if layer.bias.any() and len(layer.synapses) > 1:
                return (
                    f"layer {layer.name!r}: its bias and spikes of several sources are added in "
                    "float32 one after another, which only the interpreter supports."
                )
            fan_in = sum(s.shape[0] for s in layer.synapses)
            if fan_in * largest_weight([layer]) >= _EXACT:
                return (
                    f"layer {layer.name!r}: sums of its weights are beyond the whole numbers that "
                    "float32 holds, and depend on their order."
                )
        return NumbaPipeline.obstacle(program)
