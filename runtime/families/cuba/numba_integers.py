"""The Numba backend of CuBa-LIF layers with integers, equal to `update` of the specification.

A timestep is tried in float64, which holds 24-bit states and their products with 12-bit decays
exactly. Where a number does not fit its register, the same timestep is computed again in int64 by
the specification, from the state before it, which is still there.
"""

from typing import ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import DTypeLike

from spikedeploy.runtime.chips.registers import Register, magnitude
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
    largest_weight,
)

# columns of Constants.layers behind those of all families; sums of a layer that IS_NARROW fit 16
# bits, one IN_INTEGERS is always computed in int64, of one with NO_CURRENT nothing stays of a
# current, and of one that is PROVEN no number can be too large
IS_NARROW, IN_INTEGERS, NO_CURRENT, PROVEN = range(len(frame.LAYER), len(frame.LAYER) + 4)
# entries of Constants.rules; what float64 may hold of a current and of a membrane; from REGISTERS
# on what accumulator, current and membrane do where a number does not fit, and their bits
SHIFT, DECAY_BITS, REFRACTORY, SUBTRACT, ROOM_CURRENT, ROOM_MEMBRANE, REGISTERS = range(1, 8)
# rows of Constants.neurons, with decays in 1 / 2**decay_bits, and of Constants.floats, as fractions
CURRENT_DECAY, MEMBRANE_DECAY, THRESHOLD, VOLTAGE_BIAS = range(4)
# what a register does when a number does not fit
OVERFLOWS = {"none": 0, "wrap": 1, "wrap-once": 2, "clip": 3}
NONE, WRAP, WRAP_ONCE, CLIP = OVERFLOWS.values()

_EXACT_INT8 = (1 << 7) - 1
# bits of every whole number that float64 holds
_EXACT_BITS = 53


class Neurons(NamedTuple):
    """The numbers of a layer that a timestep in float64 needs."""

    decay_current: Array
    decay_membrane: Array
    threshold: Array
    bias: Array
    unit: Number
    room: Number
    room_membrane: Number
    subtract: Number
    watched: Number


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
    about, rules, floats = constants.layers[layer], constants.rules, constants.floats
    size, first = about[frame.SIZE], about[frame.NEURON]
    frame.sum_weights(constants, memory, scratch, about, row, call, False)
    sums = scratch[0, :size]
    neurons = Neurons(
        floats[CURRENT_DECAY, first : first + size],
        floats[MEMBRANE_DECAY, first : first + size],
        floats[THRESHOLD, first : first + size],
        floats[VOLTAGE_BIAS, first : first + size],
        np.float64(1 << rules[SHIFT]),
        np.float64(rules[ROOM_CURRENT]),
        np.float64(rules[ROOM_MEMBRANE]),
        rules[SUBTRACT] == 1,
        about[PROVEN] == 0,
    )
    in_integers = about[IN_INTEGERS] == 1
    if not in_integers and about[NO_CURRENT]:
        in_integers = _float_step(neurons, sums, before, after, spikes, False)
    elif not in_integers:
        in_integers = _float_step(neurons, sums, before, after, spikes, True)
    if not in_integers:
        return 0
    refractory = memory.refractory[first : first + size]
    return _integer_step(constants, sums, first, before, after, refractory, spikes)


@frame.jit
def _float_step(
    neurons: Array, sums: Array, before: Array, after: Array, spikes: Array, has_current: bool
) -> bool:
    """A timestep in float64; whether a number was too large for it.

    has_current: whether anything stays of a current; a constant at every call, so that each has a
        loop of its own.
    """
    (
        decay_current, decay_membrane, threshold, bias, unit, room, room_membrane, subtract,
        watched,
    ) = neurons  # fmt: skip
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
        drive = _fit(wide, rules, 0)
        lost += drive != wide
        wide = _decay(was_current, whole[CURRENT_DECAY, first + n], bits) + drive
        current = _fit(wide, rules, 1)
        lost += current != wide
        wide = _decay(was_membrane, whole[MEMBRANE_DECAY, first + n], bits) + current + bias
        membrane = _fit(wide, rules, 2)
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


@frame.jit
def _fit(x: Number, rules: Array, register: int) -> Number:
    """Equal Register.fit."""
    overflow, bits = rules[REGISTERS + 2 * register], rules[REGISTERS + 2 * register + 1]
    half = np.int64(1) << (bits - 1)
    if overflow == WRAP:
        return (x + half) % (2 * half) - half
    if overflow == WRAP_ONCE:
        if x > half:
            return x - 2 * half
        return x + 2 * half if x <= -half else x
    if overflow == CLIP:
        return min(max(x, 1 - half), half - 1)
    return x


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
        rows = [
            np.stack([a.current_decay, a.membrane_decay, a.threshold, a.voltage_bias])
            for a in layers
        ]
        whole = np.concatenate(rows, axis=1).astype(np.int64)
        real = whole * np.array([[1 / fixed.decay_one]] * 2 + [[1.0]] * 2)
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
            columns.append((is_narrow, in_integers, not layer.current_decay.any(), proven))
        largest = max(largest_weight(layers), max(a.partial for a in limits) >> 16)
        subtract = program.convention.reset == "subtract"
        registers = [x for r in _registers(fixed) for x in (OVERFLOWS[r.overflow], r.bits)]
        return FamilyNumbers(
            columns=columns,
            weights=_weight_type(largest),
            states=np.float64,
            sums=(np.int16, np.int32) if largest <= EXACT_INT16 else (np.int64, np.int64),
            rules=[shift, fixed.decay_bits, fixed.refractory, subtract, *rooms, *registers],
            neurons=whole,
            floats=single if (single == real).all() else aligned_copy(real, np.float64),
        )

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        fixed = cast("CubaFixedPoint", program.chip.arithmetic)
        odd = any(r.overflow not in OVERFLOWS or r.between for r in _registers(fixed))
        if odd or fixed.push.overflow != "none":
            return (
                f"chip {program.chip.name!r} has a register that the compiled kernels do not know: "
                "one that saturates, has a narrower range, or holds the push."
            )
        return NumbaPipeline.obstacle(program)


def _weight_type(largest: int) -> DTypeLike:
    """The smallest that holds them, for fetching them takes longest."""
    return np.int8 if largest <= _EXACT_INT8 else np.int16 if largest <= EXACT_INT16 else np.int64


def _registers(fixed: CubaFixedPoint) -> tuple[Register, Register, Register]:
    return fixed.accumulator, fixed.current, fixed.membrane
