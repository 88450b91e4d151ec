"""The Numba backend of CuBa-LIF layers in float32, equal to `float_update` of the specification.

Weights are whole numbers, whose sums float32 holds exactly below 2**24; everything else is computed
in the order of the specification, which the compiler keeps.
"""

from typing import ClassVar

import numpy as np
from numpy.typing import DTypeLike

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.families import numba_frame as frame
from spikedeploy.runtime.families.numba_frame import Array, Number
from spikedeploy.runtime.families.numba_pipeline import (
    FamilyNumbers,
    NumbaPipeline,
    largest_weight,
)

# column of Constants.layers behind those of all families: whether neurons have biases of an axon
HAS_BIAS = len(frame.LAYER)
# entry of Constants.rules
SUBTRACT = 1
# rows of Constants.neurons
CURRENT_DECAY, MEMBRANE_DECAY, THRESHOLD, VOLTAGE_BIAS, AXON_BIAS = range(5)

_EXACT = 1 << 24  # whole numbers that float32 holds


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
    about = constants.layers[layer]
    size, first = about[frame.SIZE], about[frame.NEURON]
    numbers = constants.neurons[:, first : first + size]
    current, membrane = after[:size], after[size:]
    frame.sum_weights(constants, memory, memory.wide, about, row, call, False)
    biased = about[HAS_BIAS] and frame.has_bias(about, row, call.timesteps)
    _drive(numbers, memory.wide[0, :size], biased, before[:size], current)
    _integrate(numbers, before[size:], current, membrane)
    _fire(numbers[THRESHOLD], constants.rules[SUBTRACT], membrane, spikes)
    frame.list_spikes(constants.sources[layer + 1], memory, row)
    if not call.counting:
        return 0, 0
    return 0, frame.count_active(before[size:], current, numbers[VOLTAGE_BIAS])


@frame.jit
def _drive(numbers: Array, sums: Array, biased: Number, before: Array, after: Array) -> None:
    """Write I = a I + (bias + W s)."""
    decay, bias = numbers[CURRENT_DECAY], numbers[AXON_BIAS]
    whole = after.dtype.type
    if biased:
        for n in range(len(after)):
            after[n] = decay[n] * before[n] + (bias[n] + whole(sums[n]))
    else:
        for n in range(len(after)):
            after[n] = decay[n] * before[n] + whole(sums[n])


@frame.jit
def _integrate(numbers: Array, before: Array, current: Array, after: Array) -> None:
    """Write V = b V + I + bias."""
    decay, bias = numbers[MEMBRANE_DECAY], numbers[VOLTAGE_BIAS]
    for n in range(len(after)):
        after[n] = decay[n] * before[n] + current[n] + bias[n]


@frame.jit
def _fire(threshold: Array, subtract: Number, membrane: Array, spikes: Array) -> None:
    """Write spikes (N,), and reset membranes."""
    for n in range(len(membrane)):
        fired = membrane[n] > threshold[n]
        rest = membrane[n] - threshold[n] if subtract else membrane.dtype.type(0)
        membrane[n] = rest if fired else membrane[n]
        spikes[n] = fired


_run = frame.kernel(_step)


class FloatPipeline(NumbaPipeline):
    """CuBa-LIF layers in float32 as a Backend."""

    states_of_neuron: ClassVar[int] = 2
    recorded: ClassVar[DTypeLike] = np.float32
    kernel = staticmethod(_run)

    @staticmethod
    def numbers(program: Program) -> FamilyNumbers:
        """Return decays, thresholds and biases in float32."""
        return FamilyNumbers(
            columns=[(bool(layer.bias.any()),) for layer in program.layers],
            weights=np.int16,
            states=np.float32,
            sums=(np.int32, np.int32),
            rules=[program.convention.reset == "subtract"],
            neurons=np.concatenate([_numbers(layer) for layer in program.layers], axis=1),
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
            if fan_in * largest_weight([layer]) >= _EXACT:
                return (
                    f"layer {layer.name!r}: sums of its weights are beyond the whole numbers that "
                    "float32 holds, and depend on their order."
                )
        return NumbaPipeline.obstacle(program)


def _numbers(layer: Layer) -> Array:
    """(5, N) of a layer."""
    each = (
        layer.current_decay, layer.membrane_decay, layer.threshold, layer.voltage_bias, layer.bias
    )  # fmt: skip
    return np.stack([np.broadcast_to(a, (layer.size,)) for a in each]).astype(np.float32)
