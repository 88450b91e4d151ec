"""The Numba backend of Xylo: its neurons in compiled kernels, equal to `XyloArithmetic.update`.

Events are added as one sum where no part of it can saturate, else one after another. All that
follows is a pass over the neurons of a layer, in which the compiler makes vector instructions.
"""

from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.families import numba_frame as frame
from spikedeploy.runtime.families.numba_frame import Array, Number
from spikedeploy.runtime.families.numba_pipeline import (
    FamilyNumbers,
    NumbaPipeline,
    edges,
    largest_weight,
)
from spikedeploy.runtime.families.xylo import XyloArithmetic

# column of Constants.layers behind those of all families: spikes of a neuron in a timestep
SPIKES_MAX = len(frame.LAYER)
# entries of Constants.rules: least and largest state, what decay adds to the least membrane where
# all of it is lost, and the largest weight
LOWEST, HIGHEST, TURNED, LARGEST = range(1, 5)
# rows of Constants.neurons
CURRENT_DASH, MEMBRANE_DASH, THRESHOLD, BIAS = range(4)

_WIDEST = 28  # bits of a state, of which int32 holds sums of a few


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
    of_layer, own = constants.layers[layer], constants.sources[layer + 1]
    size, first = of_layer[frame.SIZE], of_layer[frame.NEURON]
    numbers = constants.neurons[:, first : first + size]
    current, membrane = after[:size], after[size:]
    lost = _add_events(constants, memory, call, of_layer, row, before[:size], current)
    _decay(numbers[CURRENT_DASH], current)
    lost += _integrate(constants.rules, numbers, before[size:], current, membrane)
    for n in range(size):
        spikes[n] = membrane[n] >= numbers[THRESHOLD, n]
    frame.list_spikes(own, memory, row)
    fired, _ = frame.spikes_of(own, memory, row)
    for n in fired:
        # as many spikes as there are thresholds to take off
        times = min(membrane[n] // numbers[THRESHOLD, n], of_layer[SPIKES_MAX])
        membrane[n] -= times * numbers[THRESHOLD, n]
        spikes[n] = times
    if not call.counting:
        return lost, 0
    return lost, frame.count_active(before[size:], current, numbers[BIAS])


@frame.jit
def _add_events(
    constants: Array,
    memory: Array,
    call: Array,
    of_layer: Array,
    row: int,
    before: Array,
    after: Array,
) -> Number:
    """Currents (N,) with the events of a timestep; how many additions did not fit."""
    rules, size, whole = constants.rules, of_layer[frame.SIZE], after.dtype.type
    events, largest = 0, 0
    for k in range(of_layer[frame.FIRST_WIRE], of_layer[frame.LAST_WIRE]):
        wire = constants.wires[k]
        axons, counts = frame.arrivals(constants, memory, wire, row)
        for axon in axons:
            events += counts[axon]
    for n in range(size):
        largest = max(largest, abs(before[n]))
    if largest + events * rules[LARGEST] <= rules[HIGHEST]:
        # no partial sum can saturate, and so their order does not matter
        frame.sum_weights(constants, memory, memory.wide, of_layer, row, call, True)
        sums = memory.wide[0, :size]
        for n in range(size):
            after[n] = whole(before[n] + sums[n])
        return 0
    lost = 0
    for n in range(size):
        after[n] = before[n]
    for k in range(of_layer[frame.FIRST_WIRE], of_layer[frame.LAST_WIRE]):
        wire = constants.wires[k]
        axons, counts = frame.arrivals(constants, memory, wire, row)
        for axon in axons:
            at = wire[frame.WEIGHT] + axon * size
            for _ in range(counts[axon]):
                lost += _add_event(rules, constants.weights[at : at + size], after)
    return lost


@frame.jit
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


@frame.jit
def _decay(dash: Array, states: Array) -> None:
    """States after the decay of a timestep."""
    whole = states.dtype.type
    for n in range(len(states)):
        states[n] = whole(states[n] - _loss(whole, states[n], dash[n]))


@frame.jit
def _loss(whole: Any, x: Number, dash: Number) -> Number:  # noqa: ANN401
    """Equal runtime.chips.registers.shift_decay."""
    shifted = whole(x >> dash)
    sign = whole(whole(x > 0) - whole(x < 0))
    return shifted if shifted != 0 else sign


@frame.jit
def _integrate(rules: Array, numbers: Array, before: Array, current: Array, after: Array) -> Number:
    """Write membranes (N,) before spikes; how many sums did not fit."""
    whole = after.dtype.type
    lowest, highest, turned = whole(rules[LOWEST]), whole(rules[HIGHEST]), whole(rules[TURNED])
    dash, bias, lost = numbers[MEMBRANE_DASH], numbers[BIAS], whole(0)
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


_run = frame.kernel(_step)


class XyloPipeline(NumbaPipeline):
    """Xylo's layers as a Backend, whose neurons have one current each."""

    states_of_neuron: ClassVar[int] = 2
    kernel = staticmethod(_run)

    @staticmethod
    def numbers(program: Program) -> FamilyNumbers:
        """Return dashes, thresholds and biases, and the edges of states."""
        rules, layers = cast("XyloArithmetic", program.chip.arithmetic), program.layers
        low, high = edges(rules.state) or (0, 0)
        (turned,) = rules.leak.fit(np.array([-low])).tolist()
        largest = largest_weight(layers)
        apart = {program.output} if program.output_apart else set()
        most = [
            rules.output_spikes_max if layer.name in apart else rules.spikes_max for layer in layers
        ]
        return FamilyNumbers(
            columns=[(each,) for each in most],
            weights=np.int32 if largest <= np.iinfo(np.int32).max else np.int64,
            states=np.int32,
            sums=(np.int32, np.int32),
            rules=[low, high, turned, largest],
            neurons=np.concatenate([_numbers(layer) for layer in layers], axis=1),
        )

    @staticmethod
    def both(states: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Currents (B, ..., 1, N), of which neurons can have several, and membranes (B, ..., N)."""
        return states[0][..., None, :], states[-1]

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        rules = cast("XyloArithmetic", program.chip.arithmetic)
        held = edges(rules.state)
        if held is None or rules.state.bits > _WIDEST or rules.leak.limit < held[1]:
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


def _numbers(layer: Layer) -> Array:
    """(4, N) of a layer; thresholds of neurons that never spike are beyond what int32 holds."""
    threshold = np.minimum(layer.threshold, np.iinfo(np.int32).max)
    each = (layer.current_decay[0], layer.membrane_decay, threshold, layer.voltage_bias)
    return np.stack([np.broadcast_to(values, (layer.size,)) for values in each]).astype(np.int32)
