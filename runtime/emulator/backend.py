"""The backends: what computes a program; all of them compute the same."""

from importlib.util import find_spec
from typing import Literal, get_args

from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint

# "numpy" needs nothing else; "numba" compiles, several times faster; "auto" compiles where it can;
# "interpreter" is the specification of them all. What has no fast kernels is interpreted by "numpy"
# and "auto" too.
Backend = Literal["numpy", "numba", "auto", "interpreter"]
# what registers may do when a number does not fit, of all that `runtime.fixed` has
OVERFLOWS = ("none", "wrap", "wrap-once", "clip")


def compiles(program: Program, backend: Backend) -> bool:
    """Whether the program is to run compiled; the compiler itself is not loaded."""
    if backend not in get_args(Backend):
        choices = ", ".join(map(repr, get_args(Backend)))
        raise ConfigError(f"backend {backend!r} is unknown. Choose one of {choices}.")
    if backend in ("numpy", "interpreter"):
        return False
    obstacle = _obstacle(program)
    if obstacle and backend == "numba":
        raise ConfigError(f"backend 'numba': {obstacle} Or choose backend='numpy'.")
    return obstacle is None


def interprets(program: Program, backend: Backend) -> bool:
    """Whether the program is to run in the interpreter, by choice or for want of kernels."""
    return backend == "interpreter" or _only_interpreted(program) is not None


def _only_interpreted(program: Program) -> str | None:
    """Why no fast kernel computes the program."""
    chip = program.chip
    if chip.arithmetic.rounds and chip.fixed is None:
        kind = type(chip.arithmetic).__name__
        return f"chip {chip.name!r} computes with {kind}, which only the interpreter knows."
    for layer in program.layers:
        if any(synapses.shift for synapses in layer.synapses):
            return (
                f"layer {layer.name!r}: its weights have a negative exponent, by which "
                f"{chip.name} rounds sums, which only the interpreter knows."
            )
    return None


def _beyond(fixed: CubaFixedPoint) -> bool:
    """Whether registers do what only the interpreter and the NumPy kernels compute."""
    registers = fixed.accumulator, fixed.current, fixed.membrane
    strange = any(r.overflow not in OVERFLOWS or r.between is not None for r in registers)
    return strange or fixed.push.overflow != "none"


def _obstacle(program: Program) -> str | None:
    """Why the program cannot run compiled, and what to do."""
    if obstacle := _only_interpreted(program):
        return obstacle
    fixed = program.chip.fixed
    if fixed is None:
        return (
            f"chip {program.chip.name!r} has no integers, so its sums depend on their order, and "
            "compiled ones would not be equal. Choose a chip with integers."
        )
    if _beyond(fixed):
        return (
            f"chip {program.chip.name!r} has a register that the compiled kernels do not know: one "
            "that saturates, has a narrower range, or holds the push."
        )
    if find_spec("numba") is None:
        return "Numba is not installed. Install it with pip install 'spikedeploy[fast]'."
    return None
