"""Exceptions that a user can act on: the one line that each becomes, and the exit code."""

import errno
import sys

from spikedeploy.runtime.errors import SpikedeployError
from spikedeploy.runtime.requirements import is_required, wrong_requirements

# package that a command may need -> the extra of pyproject.toml that installs it
EXTRAS = {
    "torch": "train",
    "snntorch": "train",
    "safetensors": "train",
    "onnx": "train",
    "numba": "fast",
    "zmq": "serve",
    "faery": "events",
}

# exit codes, as of diff and grep: 1 is an answer, 2 a question that cannot be answered
DOES_NOT_FIT, BAD_INPUT = 1, 2


def exit_code(error: Exception) -> int:
    """DOES_NOT_FIT where a network breaks a rule of its chip, else BAD_INPUT."""
    breaks = _is_instance(error, "spikedeploy.runtime.errors", "RuleError")
    return DOES_NOT_FIT if breaks else BAD_INPUT


def one_line(error: Exception) -> str | None:
    """The line for the user; None where the exception is a bug, whose traceback is needed."""
    if isinstance(error, ModuleNotFoundError):
        package = (error.name or "").partition(".")[0]
        extra = EXTRAS.get(package)
        if extra is None:
            broken = f"spikedeploy needs {package}, which cannot be imported: pip install ."
            return next(wrong_requirements(extras=True), broken if is_required(package) else None)
        return (
            f"this needs {package}, which is not installed: in the checkout of spikedeploy, "
            f'pip install ".[{extra}]"'
        )
    if isinstance(error, ImportError | AttributeError):
        # a bug, but where a package of another version lacks what is asked of it
        return next(wrong_requirements(extras=True), None)
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return f"{error.strerror}: the disk is full, or where the output goes"
    of_gymnasium = _is_instance(error, "gymnasium.error", "Error")
    expected = isinstance(error, SpikedeployError) or of_gymnasium
    return " ".join(str(error).split()) if expected else None


def _is_instance(error: Exception, module: str, name: str) -> bool:
    """Return True if it is of a class; one whose module is not loaded cannot have been raised."""
    loaded = sys.modules.get(module)
    return loaded is not None and isinstance(error, getattr(loaded, name))
