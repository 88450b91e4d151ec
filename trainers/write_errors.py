"""A file of a training that could not be written: a full disk, no right to; in a sentence."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from spikedeploy.runtime.errors import ConfigError


@contextmanager
def said(path: Path) -> Iterator[None]:
    """Say in a sentence why a file of a training could not be written: a full disk, no right to."""
    try:
        yield
    except _errors() as error:
        why = getattr(error, "strerror", None) or str(error)
        raise ConfigError(
            f"{path} could not be written: {why}. The last checkpoint is whole: make room, or copy "
            "the run where files can be written, and go on with --resume."
        ) from error


def _errors() -> tuple[type[Exception], ...]:
    """What writing raises; reports read metrics with this module where safetensors is missing."""
    module = sys.modules.get("safetensors")
    return (OSError,) if module is None else (OSError, module.SafetensorError)
