"""Exceptions that a user can act on: the one line that each becomes, and the exit code."""

import errno
import sys

# package that a command may need -> the extra of pyproject.toml that installs it
EXTRAS = {
    "torch": "train",
    "snntorch": "train",
    "safetensors": "train",
    "onnx": "train",
    "numba": "fast",
    "ray": "sweep",
    "zmq": "serve",
}
_EXPECTED = (
    ("spikedeploy.errors", "SpikedeployError"),
    ("spikedeploy.envs.errors", "EnvError"),
    ("gymnasium.error", "Error"),
)


# exit codes, as of diff and grep: 1 is an answer, 2 a question that cannot be answered
DOES_NOT_FIT, BAD_INPUT = 1, 2


def exit_code(error: Exception) -> int:
    """DOES_NOT_FIT where a network breaks a rule of its chip, else BAD_INPUT."""
    return DOES_NOT_FIT if _is(error, "spikedeploy.runtime.errors", "RuleError") else BAD_INPUT


def one_line(error: Exception) -> str | None:
    """The line for the user; None where the exception is a bug, whose traceback is needed."""
    if isinstance(error, ModuleNotFoundError):
        return _missing(error.name or "")
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return f"{error.strerror}: the disk is full, or where the output goes"
    return " ".join(str(error).split()) if _expected(error) else None


def _missing(module: str) -> str | None:
    """How to install a missing module; None where no extra has it."""
    package = module.partition(".")[0]
    extra = EXTRAS.get(package)
    return extra and (
        f"this needs {package}, which is not installed: in the checkout of spikedeploy, "
        f'pip install ".[{extra}]"'
    )


def _expected(error: Exception) -> bool:
    """Return True if it is one of EXPECTED."""
    return any(_is(error, module, name) for module, name in _EXPECTED)


def _is(error: Exception, module: str, name: str) -> bool:
    """Return True if it is of a class; one whose module is not loaded cannot have been raised."""
    loaded = sys.modules.get(module)
    return loaded is not None and isinstance(error, getattr(loaded, name))
