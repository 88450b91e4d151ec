"""Exceptions that a user can act on, and the one line that each becomes."""

import sys

# package that a command may need -> the extra of pyproject.toml that installs it
EXTRAS = {
    "torch": "train",
    "snntorch": "train",
    "pydantic": "train",
    "safetensors": "train",
    "onnx": "train",
    "tomli": "train",
    "numba": "fast",
}
_EXPECTED = (
    ("spikedeploy.runtime.errors", "SpikedeployError"),
    ("spikedeploy.envs.errors", "EnvError"),
    ("gymnasium.error", "Error"),
)


def one_line(error: Exception) -> str | None:
    """The line for the user; None where the exception is a bug, whose traceback is needed."""
    if isinstance(error, ModuleNotFoundError):
        return _missing(error.name or "")
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
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
    """Whether it is one of EXPECTED; a class whose module is not loaded cannot have been raised."""
    modules = ((sys.modules.get(module), name) for module, name in _EXPECTED)
    return any(module and isinstance(error, getattr(module, name)) for module, name in modules)
