"""The update of a layer's neurons in one timestep, in float64 and in int64."""

import numpy as np

from spikedeploy.runtime.families.cuba_numba.jit import jit
from spikedeploy.runtime.families.cuba_numba.layout import (
    CLIP,
    CURRENT_DECAY,
    DECAY_BITS,
    MEMBRANE_DECAY,
    NEURON,
    REFRACTORY,
    SHIFT,
    SUBTRACT,
    THRESHOLD,
    VOLTAGE_BIAS,
    WRAP,
    WRAP_ONCE,
    Array,
    Number,
)


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
        wide = _decayed(was_current, decay_current[n], bits) + drive
        current = _fit(wide, registers[1])
        lost += current != wide
        wide = _decayed(was_membrane, decay_membrane[n], bits) + current + bias
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
def _decayed(x: Number, factor: Number, bits: Number) -> Number:
    """What the decay of runtime.chips.registers leaves."""
    left = abs(x) * factor >> bits
    return left if x >= 0 else -left


@jit
def _fit(x: Number, register: Array) -> Number:
    """What a Register holds of x."""
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
