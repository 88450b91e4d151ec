"""Datasheets side by side: what the chips compute with, and what that was compared with."""

from collections.abc import Iterable

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint
from spikedeploy.runtime.families.cuba.free_width import CubaFreeWidth
from spikedeploy.runtime.families.cuba.spinnaker2 import CubaFloat32
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.xylo.arithmetic import XyloArithmetic

OVERFLOWS = {
    "none": "never full",
    "wrap": "wraps",
    "wrap-once": "wraps once",
    "clip": "clips",
    "saturate": "saturates",
}
COLUMNS = ("name", "neurons", "weights", "membrane", "resets", "compared with")


def rows(chips: Iterable[Chip]) -> list[tuple[str, ...]]:
    """A row of COLUMNS for each chip."""
    return [
        (chip.name, *_arithmetic(chip.arithmetic), ", ".join(chip.resets), chip.evidence)
        for chip in chips
    ]


def markdown(chips: Iterable[Chip]) -> str:
    """The same as a table of Markdown."""
    lines = [COLUMNS, ("---",) * len(COLUMNS), *rows(chips)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _arithmetic(
    numbers: CubaFixedPoint | XyloArithmetic | IntegrateAndFire | CubaFloat32 | None,
) -> tuple[str, str, str]:
    """Neurons, weights and membrane in a few words each."""
    if isinstance(numbers, CubaFreeWidth):
        signs = "with the sign" if numbers.sign_mode == "mixed" else "and sign"
        free = f"{numbers.weight_bits} bits {signs}, free"
        return "CuBa-LIF, free widths", free, f"{_register(numbers.membrane)}, free"
    if isinstance(numbers, CubaFixedPoint):
        signs = "with the sign" if numbers.sign_mode == "mixed" else "and sign"
        return "CuBa-LIF", f"{numbers.weight_bits} bits {signs}", _register(numbers.membrane)
    if isinstance(numbers, XyloArithmetic):
        bits = f"{numbers.weight_bits} bits with the sign"
        return "CuBa-LIF, event by event", bits, _register(numbers.state)
    if isinstance(numbers, IntegrateAndFire):
        return _steps(numbers)
    if isinstance(numbers, CubaFloat32):
        return "CuBa-LIF", f"{numbers.weight_bits} bits with the sign", "float32"
    return "CuBa-LIF", "float64", "float64"


def _steps(point: IntegrateAndFire) -> tuple[str, str, str]:
    leak = {
        "none": "IF",
        "linear": "IF, linear leak",
        "crossing": "IF, linear leak",
        "shift": "LIF, leak by a shift",
    }[point.leak]
    each = ", event by event" if point.adds == "event" else ""
    signs = "and the axon's sign" if point.signs == "axon" else "with the sign"
    types = f", {point.axon_types} a neuron" if point.axon_types else ""
    weights = f"{point.weight_bits} bits {signs}{types}"
    register = point.membrane
    if point.floor == 0:
        unsigned = f"{register.bits - 1} bits unsigned, {OVERFLOWS[register.overflow]}"
        return f"{leak}{each}", weights, unsigned
    return f"{leak}{each}", weights, _register(register)


def _register(register: Register) -> str:
    return f"{register.bits} bits, {OVERFLOWS[register.overflow]}"
