"""A file of a training that could not be written: a full disk, no right to; in a sentence."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from safetensors import SafetensorError

from spikedeploy.runtime.errors import ConfigError


@contextmanager
def said(path: Path) -> Iterator[None]:
    """Say in a sentence why a file of a training could not be written: a full disk, no right to."""
    try:
        yield
    except (OSError, SafetensorError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise ConfigError(
            f"{path} could not be written: {why}. The last checkpoint is whole: make room, or copy "
            "the run where files can be written, and go on with --resume."
        ) from error
