"""Compressed .npz files, written atomically and without pickled objects."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.envs.errors import EnvError


def write(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Write the arrays atomically."""
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise EnvError(f"{path} is no plain file, and is not replaced")
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        with partial.open("wb") as file:
            np.savez_compressed(file, **arrays)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)


def read(path: str | os.PathLike[str], what: str) -> dict[str, Any]:
    """The arrays of a file; `what` names the expected kind of file in errors."""
    try:
        if not zipfile.is_zipfile(path) and Path(path).is_file():
            raise EnvError(f"{path}: not a whole {what}, which is a .npz archive")
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            return dict(archive)
    except FileNotFoundError:
        raise EnvError(f"{path}: no such {what}") from None
    except EnvError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise different types for broken files
        raise EnvError(f"{path}: not a whole {what} ({error})") from error
