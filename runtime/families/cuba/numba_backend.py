"""The Numba backend of CuBa-LIF layers with integers: their numbers for the compiled kernels."""

from functools import lru_cache
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import DTypeLike

from spikedeploy.runtime.chips.registers import magnitude
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import aligned_copy
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.numba_kernels import OVERFLOWS, Constants, run
from spikedeploy.runtime.families.cuba.numpy_backend import EXACT_INT16
from spikedeploy.runtime.families.cuba.quantise import bounds, register_limit
from spikedeploy.runtime.families.numba_pipeline import (
    Delays,
    NumbaPipeline,
    largest_weight,
    wire,
)

_EXACT_INT8 = (1 << 7) - 1
# bits of every whole number that float64 holds
_EXACT_BITS = 53


@lru_cache(maxsize=8)
def constants(program: Program, fixed: CubaFixedPoint, delays: Delays, windows: bool) -> Constants:
    """As NumbaPipeline.constants; shared by the machines of a program."""
    layers, shift = program.layers, fixed.mantissa_shift
    # largest magnitude of three that are added, so that float64 decays their sum exactly
    exact = 1 << (_EXACT_BITS - 2 - fixed.decay_bits)
    room = [min(register_limit(register), exact) for register in (fixed.current, fixed.membrane)]
    whole = np.concatenate(
        [
            np.stack([a.current_decay, a.membrane_decay, a.threshold, a.voltage_bias])
            for a in layers
        ],
        axis=1,
    ).astype(np.int64)
    real = whole * np.array([[1 / fixed.decay_one]] * 2 + [[1.0]] * 2)
    # in float32 a layer of 512 neurons fits the nearest cache
    single = aligned_copy(real, np.float32)
    limits = [bounds(program, layer, fixed, None) for layer in layers]
    largest = max(largest_weight(layers), max(a.partial for a in limits) >> 16)
    registers = [(OVERFLOWS[r.overflow], r.bits) for r in _registers(fixed)]
    subtract = program.convention.reset == "subtract"
    rows = []
    for layer, limit in zip(layers, limits, strict=True):
        bias = magnitude(layer.voltage_bias.astype(np.int64))
        # where a timestep could overflow the accumulator, or hide an inexact decay; where it
        # cannot, a sum that float64 may hold was made from a decay that it computed exactly
        too_much = limit.drive > register_limit(fixed.accumulator)
        too_much |= max(limit.drive, bias) > exact
        proven = max(limit.current, limit.above, limit.below) <= min(room)
        is_narrow, in_integers = limit.partial <= EXACT_INT16, fixed.refractory > 1 or too_much
        rows.append((is_narrow, in_integers, not layer.current_decay.any(), proven))
    states, weight_type = CubaPipeline.states_of_neuron, _weight_type(largest)
    return Constants(
        *wire(program, delays, windows, states, rows, weight_type),
        chip=np.array([shift, fixed.decay_bits, fixed.refractory, subtract], np.int64),
        registers=np.array(registers, np.int64),
        whole=whole,
        real=single if (single == real).all() else aligned_copy(real, np.float64),
        rooms=np.array([1 << shift, *room], np.float64),
    )


def _weight_type(largest: int) -> DTypeLike:
    """The smallest that holds them, for fetching them takes longest."""
    return np.int8 if largest <= _EXACT_INT8 else np.int16 if largest <= EXACT_INT16 else np.int64


def _registers(fixed: CubaFixedPoint) -> tuple[Any, ...]:
    return fixed.accumulator, fixed.current, fixed.membrane


class CubaPipeline(NumbaPipeline):
    """CuBa-LIF layers with integers as a Backend."""

    states_of_neuron: ClassVar[int] = 2
    kernel = staticmethod(run)

    @staticmethod
    def constants(program: Program, delays: Delays, windows: bool) -> Constants:
        """All that does not change while the program runs."""
        return constants(program, cast("CubaFixedPoint", program.chip.arithmetic), delays, windows)

    @staticmethod
    def state_type(constants: Any) -> DTypeLike:  # noqa: ANN401
        """Number type of currents and membranes."""
        return np.float64

    @staticmethod
    def sum_types(constants: Any) -> tuple[DTypeLike, DTypeLike]:  # noqa: ANN401
        """Number types of the narrow and the wide sums."""
        is_short = constants.weights.dtype != np.int64
        return (np.int16, np.int32) if is_short else (np.int64, np.int64)

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
