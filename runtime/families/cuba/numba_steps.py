"""The Numba backends of CuBa-LIF layers, equal to `update` and `float_update` of the specification.

Integers: a timestep is tried in float64, which holds 24-bit states and their products with 12-bit
decays exactly. Where a number does not fit its register, the same timestep is computed again in
int64 by the specification, from the state before it, which is still there.

Floats: weights are whole numbers, whose sums float32 holds exactly below 2**24; everything else is
computed in the order of the specification, which the compiler keeps.
"""

from typing import ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import DTypeLike

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.registers import magnitude
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import aligned_copy
from spikedeploy.runtime.families import numba_frame as frame
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.quantise import bounds, register_limit
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
    IS_NARROW,  # whether its sums fit 16 bits
    IN_INTEGERS,  # whether it is always computed in int64
    NO_CURRENT,  # whether nothing stays of a current
    PROVEN,  # whether no number can be too large
    AXON_BIASED,  # whether it has biases that are floats
) = range(len(frame.LAYER), len(frame.LAYER) + 5)
# entries of Constants.rules; whether decays round toward zero; what float64 may hold of a current
# and of a membrane; from here on the registers, as in frame.fit
SHIFT, ROUNDS, DECAY_BITS, REFRACTORY, SUBTRACT, ROOM_CURRENT, ROOM_MEMBRANE = range(1, 8)
ACCUMULATOR, CURRENT, MEMBRANE = range(8, 8 + 3 * frame.REGISTER, frame.REGISTER)
# rows of Constants.neurons, with decays in 1 / 2**decay_bits, and of Constants.floats, as fractions
# and in the numbers of the states
CURRENT_DECAY, MEMBRANE_DECAY, THRESHOLD, VOLTAGE_BIAS, AXON_BIAS = range(5)

_EXACT_INT8 = (1 << 7) - 1
_EXACT_FLOAT32 = 1 << 24
# bits of every whole number that float64 holds
_EXACT_BITS = 53


class Neurons(NamedTuple):
    """The numbers of a layer that a timestep in floats needs."""

    decay_current: Array
    decay_membrane: Array
    threshold: Array
    bias: Array
    axon_bias: Array
    unit: Number
    room: Number
    room_membrane: Number
    subtract: Number
    watched: Number
    biased: Number


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
    """A timestep of a layer, with sums in numbers as small as the bounds allow."""
    if constants.layers[layer, IS_NARROW]:
        lost = _advance(constants, memory, memory.narrow, call, layer, row, before, after, spikes)
    else:
        lost = _advance(constants, memory, memory.wide, call, layer, row, before, after, spikes)
    frame.list_spikes(constants.sources[layer + 1], memory, row)
    if not call.counting:
        return lost, 0
    size, first = constants.layers[layer, frame.SIZE], constants.layers[layer, frame.NEURON]
    bias = constants.floats[VOLTAGE_BIAS, first : first + size]
    return lost, frame.count_active(before[size:], after[:size], bias)


@frame.jit
def _advance(
    constants: Array,
    memory: Array,
    scratch: Array,
    call: Array,
    layer: int,
    row: int,
    before: Array,
    after: Array,
    spikes: Array,
) -> int:
    """A timestep of a layer up to its spikes; how many numbers did not fit."""
    of_layer, rules, floats = constants.layers[layer], constants.rules, constants.floats
    size, first = of_layer[frame.SIZE], of_layer[frame.NEURON]
    frame.sum_weights(constants, memory, scratch, of_layer, row, call, False)
    sums = scratch[0, :size]
    neurons = Neurons(
        floats[CURRENT_DECAY, first : first + size],
        floats[MEMBRANE_DECAY, first : first + size],
        floats[THRESHOLD, first : first + size],
        floats[VOLTAGE_BIAS, first : first + size],
        floats[AXON_BIAS, first : first + size],
        after.dtype.type(1 << rules[SHIFT]),
        np.float64(rules[ROOM_CURRENT]),
        np.float64(rules[ROOM_MEMBRANE]),
        rules[SUBTRACT] == 1,
        of_layer[PROVEN] == 0,
        of_layer[AXON_BIASED] == 1 and frame.has_bias(of_layer, row, call.timesteps),
    )
    in_integers = of_layer[IN_INTEGERS] == 1
    if not rules[ROUNDS]:
        _float_step(neurons, sums, before, after, spikes, True, False)
    elif not in_integers and of_layer[NO_CURRENT]:
        in_integers = _float_step(neurons, sums, before, after, spikes, False, True)
    elif not in_integers:
        in_integers = _float_step(neurons, sums, before, after, spikes, True, True)
    if not in_integers:
        return 0
    refractory = memory.refractory[first : first + size]
    return _integer_step(constants, sums, first, before, after, refractory, spikes)


@frame.jit
def _float_step(
    neurons: Array,
    sums: Array,
    before: Array,
    after: Array,
    spikes: Array,
    has_current: bool,
    rounds: bool,
) -> bool:
    """A timestep in the floats of the states; whether a number was too large for them.

    has_current: whether anything stays of a current; a constant at every call, so that each has a
        loop of its own.
    rounds: whether decays round toward zero, likewise.
    """
    (
        decay_current, decay_membrane, threshold, bias, axon_bias, unit, room, room_membrane,
        subtract, watched, biased,
    ) = neurons  # fmt: skip
    size, too_large, number = len(spikes), 0, after.dtype.type
    for n in range(size):
        current = number(sums[n]) * unit
        if biased and not rounds:
            current += axon_bias[n]
        if has_current:
            kept = before[n] * decay_current[n]
            current += np.trunc(kept) if rounds else kept
        kept = before[size + n] * decay_membrane[n]
        membrane = (np.trunc(kept) if rounds else kept) + current + bias[n]
        if watched:
            too_large |= (abs(current) > room) | (abs(membrane) > room_membrane)
        fired = membrane > threshold[n]
        rest = membrane - threshold[n] if subtract else number(0)
        after[n] = current
        after[size + n] = rest if fired else membrane
        spikes[n] = fired
    return too_large != 0


@frame.jit
def _integer_step(
    constants: Array,
    sums: Array,
    first: int,
    before: Array,
    after: Array,
    refractory: Array,
    spikes: Array,
) -> int:
    """A timestep in int64, as the update of the interpreter; how many numbers did not fit."""
    rules, whole = constants.rules, constants.neurons
    size, bits, lost = len(spikes), rules[DECAY_BITS], 0
    for n in range(size):
        bias, threshold = whole[VOLTAGE_BIAS, first + n], whole[THRESHOLD, first + n]
        was_current, was_membrane = np.int64(before[n]), np.int64(before[size + n])
        wide = np.int64(sums[n]) << rules[SHIFT]
        drive = frame.fit(wide, rules, ACCUMULATOR)
        lost += drive != wide
        wide = _decay(was_current, whole[CURRENT_DECAY, first + n], bits) + drive
        current = frame.fit(wide, rules, CURRENT)
        lost += current != wide
        wide = _decay(was_membrane, whole[MEMBRANE_DECAY, first + n], bits) + current + bias
        membrane = frame.fit(wide, rules, MEMBRANE)
        lost += membrane != wide
        held = refractory[n] > 0
        fired = membrane > threshold and not held
        if held:
            membrane = 0
        elif fired:
            membrane = membrane - threshold if rules[SUBTRACT] == 1 else 0
        refractory[n] = rules[REFRACTORY] - 1 if fired else max(refractory[n] - 1, 0)
        after[n], after[size + n] = current, membrane
        spikes[n] = fired
    return lost


@frame.jit
def _decay(x: Number, factor: Number, bits: Number) -> Number:
    """Equal runtime.chips.registers.decay."""
    left = abs(x) * factor >> bits
    return left if x >= 0 else -left


_run = frame.kernel(_step)


class CubaPipeline(NumbaPipeline):
    """CuBa-LIF layers with integers as a Backend."""

    states_of_neuron: ClassVar[int] = 2
    kernel = staticmethod(_run)

    @staticmethod
    def numbers(program: Program) -> FamilyNumbers:
        """Return the registers, and what the bounds prove of each layer."""
        fixed = cast("CubaFixedPoint", program.chip.arithmetic)
        layers, shift = program.layers, fixed.mantissa_shift
        # largest magnitude of three that are added, so that float64 decays their sum exactly
        exact = 1 << (_EXACT_BITS - 2 - fixed.decay_bits)
        rooms = [min(register_limit(each), exact) for each in (fixed.current, fixed.membrane)]
        whole = np.concatenate([_rows(a, 0 * a.bias) for a in layers], axis=1).astype(np.int64)
        real = whole * np.array([[1 / fixed.decay_one]] * 2 + [[1.0]] * 3)
        # in float32 a layer of 512 neurons fits the nearest cache
        single = aligned_copy(real, np.float32)
        limits = [bounds(program, layer, fixed, None) for layer in layers]
        columns = []
        for layer, limit in zip(layers, limits, strict=True):
            bias = magnitude(layer.voltage_bias.astype(np.int64))
            # where a timestep could overflow the accumulator, or hide an inexact decay; where it
            # cannot, a sum that float64 may hold was made from a decay that it computed exactly
            too_much = limit.drive > register_limit(fixed.accumulator)
            too_much |= max(limit.drive, bias) > exact
            proven = max(limit.current, limit.above, limit.below) <= min(rooms)
            is_narrow, in_integers = limit.partial <= EXACT_INT16, fixed.refractory > 1 or too_much
            columns.append((is_narrow, in_integers, not layer.current_decay.any(), proven, False))
        largest = max(largest_weight(layers), max(a.partial for a in limits) >> 16)
        subtract = program.convention.reset == "subtract"
        registers = (fixed.accumulator, fixed.current, fixed.membrane)
        return FamilyNumbers(
            columns=columns,
            weights=_weight_type(largest),
            states=np.float64,
            sums=(np.int16, np.int32) if largest <= EXACT_INT16 else (np.int64, np.int64),
            rules=[
                *(shift, True, fixed.decay_bits, fixed.refractory, subtract, *rooms),
                *(x for register in registers for x in describe_register(register)),
            ],
            neurons=whole,
            floats=single if (single == real).all() else aligned_copy(real, np.float64),
        )

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        fixed = cast("CubaFixedPoint", program.chip.arithmetic)
        registers = fixed.accumulator, fixed.current, fixed.membrane
        odd = any(r.between and edges(r) is None for r in registers)
        if odd or fixed.push.overflow != "none":
            return (
                f"chip {program.chip.name!r} has a register that the compiled kernels do not know: "
                "one that wraps and has a narrower range, or holds the push."
            )
        return NumbaPipeline.obstacle(program)


class FloatPipeline(NumbaPipeline):
    """CuBa-LIF layers in float32 as a Backend."""

    states_of_neuron: ClassVar[int] = 2
    recorded: ClassVar[DTypeLike] = np.float32
    kernel = staticmethod(_run)

    @staticmethod
    def numbers(program: Program) -> FamilyNumbers:
        """Return decays, thresholds and biases in float32."""
        floats = np.concatenate([_rows(a, a.bias) for a in program.layers], axis=1)
        subtract = program.convention.reset == "subtract"
        return FamilyNumbers(
            columns=[(False, False, False, True, bool(a.bias.any())) for a in program.layers],
            weights=np.int16,
            states=np.float32,
            sums=(np.int32, np.int32),
            rules=[0, False, 0, 1, subtract, 0, 0, *[0] * 3 * frame.REGISTER],
            neurons=np.zeros(floats.shape, np.int64),
            floats=floats.astype(np.float32),
        )

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
            if fan_in * largest_weight([layer]) >= _EXACT_FLOAT32:
                return (
                    f"layer {layer.name!r}: sums of its weights are beyond the whole numbers that "
                    "float32 holds, and depend on their order."
                )
        return NumbaPipeline.obstacle(program)


def _rows(layer: Layer, axon_bias: Array) -> Array:
    """(5, N) of a layer, as in Constants.neurons and floats."""
    each = (layer.current_decay, layer.membrane_decay, layer.threshold, layer.voltage_bias)
    return np.stack([np.broadcast_to(a, (layer.size,)) for a in (*each, axon_bias)])


def _weight_type(largest: int) -> DTypeLike:
    """The smallest that holds them, for fetching them takes longest."""
    return np.int8 if largest <= _EXACT_INT8 else np.int16 if largest <= EXACT_INT16 else np.int64
