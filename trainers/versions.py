"""Installed versions, read from metadata without importing anything, and the commit."""

import platform
import re
import subprocess
from collections import Counter
from collections.abc import Iterable, Mapping
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
_NAMED = ("python", "torch", "numpy")
_VERSION = re.compile(r"[\w.+!-]+")


def versions() -> dict[str, str | None]:
    """What a run is made with: name -> version, None where it is not installed; and the commit."""
    return {
        "python": platform.python_version(),
        **{package: installed(package) for package in _PACKAGES},
        "commit": _commit(),
    }


def installed(package: str) -> str | None:
    """The version of a package, None where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def own() -> str:
    """The version of spikedeploy itself."""
    return installed("spikedeploy") or "not installed"


def in_words(found: Mapping[str, object]) -> str:
    """`python 3.11.7, torch 2.13.0, numpy 2.4.6`, of a record of versions."""
    texts = {name: str(found.get(name)) for name in _NAMED}
    return ", ".join(
        f"{name} {text if _VERSION.fullmatch(text) else 'unknown'}" for name, text in texts.items()
    )


def began_with(records: Iterable[Mapping[str, object] | str]) -> list[str]:
    """A line on the versions when trainings began, and of how many; the most frequent first.

    records  of each training, or the same in words; without any there is no line
    """
    found = Counter(each if isinstance(each, str) else in_words(each) for each in records)
    texts = [f"{versions} ({count} trainings)" for versions, count in found.most_common()]
    return [f"- versions when a training began: {'; '.join(texts)}"] if texts else []


def _commit() -> str | None:
    """Return the commit of the source tree, None where it is not a checkout."""
    command = ["git", "rev-parse", "HEAD"]
    folder = Path(__file__).parent
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
