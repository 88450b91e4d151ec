"""Refusals: programs that the core does not compute."""

from typing import TYPE_CHECKING

from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint

if TYPE_CHECKING:
    from spikedeploy.exporters.verilog.image import CoreImage


def check_program(program: Program) -> None:
    """Refuse programs whose arithmetic the core has not."""
    arithmetic, chip = program.chip.arithmetic, program.chip.name
    if not isinstance(arithmetic, CubaFixedPoint):
        raise RuleError(f"--to verilog: rule arithmetic: {chip}")


def check_image(image: "CoreImage") -> None:
    """Refuse what is too large."""
