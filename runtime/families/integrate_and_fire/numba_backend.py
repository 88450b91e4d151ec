"""The Numba backend of integrate-and-fire neurons: their rules for the compiled kernels."""

from functools import lru_cache
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import DTypeLike

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.neurons import (
    Integers,
    IntegrateAndFireRules,
    floor_of,
)
from spikedeploy.runtime.families.integrate_and_fire.numba_events import edges
from spikedeploy.runtime.families.integrate_and_fire.numba_kernels import (
    LEAKS,
    OVERFLOWS,
    Constants,
    Neurons,
    run,
)
from spikedeploy.runtime.families.numba_pipeline import (
    Delays,
    NumbaPipeline,
    largest_weight,
    wire,
)

_EXACT_INT16 = (1 << 15) - 1
_NARROW_BITS = 31  # of a membrane that int32 holds, with what the host may read of it


@lru_cache(maxsize=8)
def constants(
    program: Program, rules: IntegrateAndFireRules, delays: Delays, windows: bool
) -> Constants:
    """As NumbaPipeline.constants; shared by the machines of a program."""
    layers = program.layers
    numbers_of = [_numbers(rules, program.convention, a) for a in layers]
    rows = [
        (bool((a.bias + a.voltage_bias).any()), bool(a.voltage_bias.any()), _are_alike(each))
        for a, each in zip(layers, numbers_of, strict=True)
    ]
    weight_type = np.int16 if largest_weight(layers) <= _EXACT_INT16 else np.int64
    lowest, highest = edges(rules.membrane) or (0, 0)
    subtract = program.convention.reset == "subtract"
    several = rules.checks == "step" and (subtract or program.convention.spikes == "many")
    numbers = (
        LEAKS[rules.leak],
        rules.leak_order == "last",
        rules.adds == "event",
        rules.checks == "event",
        rules.spikes_max,
        rules.spikes_max if several else 1,
        rules.reset_at == "leak",
        subtract,
        OVERFLOWS[rules.membrane.overflow],
        rules.membrane.bits,
        lowest,
        highest,
        program.chip.input_spikes_max,
    )
    return Constants(
        *wire(
            program, delays, windows, IntegrateAndFirePipeline.states_of_neuron, rows, weight_type
        ),
        rules=np.array(numbers, np.int64),
        neurons=_narrowed(np.concatenate(numbers_of, axis=1), program, rules),
    )


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


def _are_alike(numbers: Integers) -> bool:
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


class IntegrateAndFirePipeline(NumbaPipeline):
    """Integrate-and-fire layers as a Backend, in timesteps."""

    states_of_neuron: ClassVar[int] = 1
    kernel = staticmethod(run)

    @staticmethod
    def constants(program: Program, delays: Delays, windows: bool) -> Constants:
        """All that does not change while the program runs."""
        rules = cast("IntegrateAndFire", program.chip.arithmetic)
        return constants(program, rules, delays, windows)

    @staticmethod
    def state_type(constants: Any) -> DTypeLike:  # noqa: ANN401
        """Number type of membranes, that of the neurons' own numbers."""
        return cast(DTypeLike, constants.neurons.dtype)

    @staticmethod
    def sum_types(constants: Any) -> tuple[DTypeLike, DTypeLike]:  # noqa: ANN401
        """Number types of the narrow sums, which it does not use, and of the wide."""
        return constants.neurons.dtype, constants.neurons.dtype

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
