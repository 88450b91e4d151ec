"""The backends: what computes a program; all of them compute the same."""

from importlib.util import find_spec
from typing import Literal, get_args

from runtime.errors import ConfigError
from runtime.program import Program

# "numpy" needs nothing else; "numba" compiles, several times faster; "auto" compiles where it can
Backend = Literal["numpy", "numba", "auto"]


def compiles(program: Program, backend: Backend) -> bool:
    """Whether the program is to run compiled; the compiler itself is not loaded."""
    if backend not in get_args(Backend):
        raise ConfigError(f"backend {backend!r} is unknown. Choose 'numpy', 'numba' or 'auto'.")
    if backend == "numpy":
        return False
    obstacle = _obstacle(program)
    if obstacle and backend == "numba":
        raise ConfigError(f"backend 'numba': {obstacle} Or choose backend='numpy'.")
    return obstacle is None


def _obstacle(program: Program) -> str | None:
    """Why the program cannot run compiled, and what to do."""
    if program.chip.fixed is None:
        return (
            f"chip {program.chip.name!r} has no integers, so its sums depend on their order, and "
            "compiled ones would not be equal. Choose a chip with integers."
        )
    if find_spec("numba") is None:
        return "Numba is not installed. Install it with pip install 'spikedeploy[fast]'."
    return None
