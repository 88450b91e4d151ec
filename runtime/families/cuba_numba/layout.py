"""Array layout of the kernels."""

from typing import Any, NamedTuple

Array = Any  # the compiler sees the types
Number = Any

# events, in the order of runtime.emulator.ledger.EVENTS
(
    SPIKE_IN, SOP, BIAS_SOP, UPDATE, IDLE, SPIKE_OUT, MESSAGE, SATURATION, GRADED_SOP, LOST_SPIKE,
) = range(10)  # fmt: skip

# columns of Constants.layers; STATE is where the layer's states begin in a row of
# KernelMemory.states, BIAS where its biases begin in Constants.weights; of a layer with NO_CURRENT
# nothing stays of a current, of one that is PROVEN no number can be too large, and one IN_INTEGERS
# is always computed in int64; of each layer that IS_OUTPUT the spikes leave the chip, and in each
# timestep so many membranes as are READ, and the one that LEAVES is what the kernel puts out; the
# bias axon of a layer is silent, and the host deaf to it, in HEAD rows first and in TAIL rows last
SIZE, NEURON, STATE, FIRST_WIRE, LAST_WIRE, SUM_BITS, IN_INTEGERS, START = range(8)
BIAS, BIAS_FAN_OUT, IS_OUTPUT, NO_CURRENT, PROVEN, READ, LEAVES, HEAD, TAIL = range(8, 17)
# columns of Constants.wires
SOURCE, LAG, WEIGHT, FAN_OUT = range(4)
# columns of Constants.sources; NEURONS of each, rows that it REMEMBERS, where its RASTER and its
# LENGTHS begin in a row of the memory
NEURONS, REMEMBERS, RASTER, LENGTHS = range(4)
# entries of Constants.chip
SHIFT, DECAY_BITS, REFRACTORY, SUBTRACT = range(4)
# rows of Constants.whole and of Constants.real
CURRENT_DECAY, MEMBRANE_DECAY, THRESHOLD, VOLTAGE_BIAS = range(4)
# columns of Constants.rooms
UNIT, ROOM_CURRENT, ROOM_MEMBRANE = range(3)
# what a register does, in Constants.registers with its bits
NONE, WRAP, WRAP_ONCE, CLIP = range(4)


class Constants(NamedTuple):
    """A program as arrays; those of its layers and synapses one after another.

    weights: (W,) mantissas, axon-major, and then the biases.
    fan_out: (A,) of each axon of each synapses.
    wires, layers, sources: a row for each, columns above; source 0 is the input, k + 1 layer k.
    chip: entries above.
    registers: (3, 2) what accumulator, current and membrane do, and their bits.
    whole: (4, N) rows above; decay factors in 1 / 2**decay_bits.
    real: (4, N) the same for float64; decay factors as fractions.
    rooms: (L, 3) columns above [state units].
    """

    weights: Array
    fan_out: Array
    wires: Array
    layers: Array
    sources: Array
    chip: Array
    registers: Array
    whole: Array
    real: Array
    rooms: Array


class KernelMemory(NamedTuple):
    """What a program remembers and works with, a row for each of the batch.

    rasters: (B, R) of each source the rows that are still on their way, then those of the window.
    lists: (B, R) of each of those rows the axons that spiked.
    lengths: (B, Q) how many.
    states: (B, K) of each layer slots of current and membrane, used in turn; slot 0 is now.
    refractory: (B, N) timesteps of refractory left.
    sums16, sums32, sums64: (N,) what arrives in a timestep.
    """

    rasters: Array
    lists: Array
    lengths: Array
    states: Array
    refractory: Array
    sums16: Array
    sums32: Array
    sums64: Array


class KernelNeurons(NamedTuple):
    """What a timestep of a layer in float64 needs of Constants.real and Constants.rooms."""

    decay_current: Array
    decay_membrane: Array
    threshold: Array
    bias: Array
    unit: Number
    room_current: Number
    room_membrane: Number
    subtract: Number
    watched: Number
