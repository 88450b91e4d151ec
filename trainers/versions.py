"""Installed versions, read from metadata without importing anything, and the commit."""

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = (
    "spikedeploy",
    "torch",
    "numpy",
    "gymnasium",
    "mujoco",
    "pymunk",
    "onnxruntime",
    "numba",
    "nir",
    "snntorch",
    "safetensors",
)


def versions() -> dict[str, str | None]:
    """Versions behind a run: name -> version, None where it is not installed; and the commit."""
    return {
        "python": platform.python_version(),
        **{package: installed_version(package) for package in _PACKAGES},
        "commit": _commit(),
    }


def installed_version(package: str) -> str | None:
    """The version of a package, None where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def own() -> str:
    """The version of spikedeploy itself."""
    return installed_version("spikedeploy") or "not installed"


def _commit() -> str | None:
    """Return the commit of the source tree, None where it is not a checkout."""
    command = ["git", "rev-parse", "HEAD"]
    folder = Path(__file__).parent
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
