"""Archives of arrays: compressed .npz files, whole or not there, with nothing pickled in them."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.envs.errors import EnvError


def write(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Write the arrays; the name appears only when the file is whole."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        with partial.open("wb") as file:
            np.savez_compressed(file, **arrays)
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)


def read(path: str | os.PathLike[str], what: str) -> dict[str, Any]:
    """The arrays of a file; `what` it should be is said in the error when it is not."""
    try:
        if not zipfile.is_zipfile(path) and Path(path).is_file():
            raise EnvError(f"{path}: not a whole {what}, which is a .npz archive")
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            return dict(archive)
    except FileNotFoundError:
        raise EnvError(f"{path}: no such {what}") from None
    except EnvError:
        raise
    except Exception as error:  # zipfile, zlib and numpy each have their own for a broken file
        raise EnvError(f"{path}: not a whole {what} ({error})") from error
