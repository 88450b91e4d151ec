"""Compressed .npz files, written atomically and without pickled objects."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.runtime.errors import EnvError
from spikedeploy.runtime.files import replacing

# bytes that an archive may unpack to for each of its own, and besides those
_MAX_EXPANSION = 100
_FREE_BYTES = 64 << 20


def write(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Write the arrays atomically."""
    with replacing(Path(path)) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _check_size(path: str | os.PathLike[str], what: str) -> None:
    """Refuse an archive that unpacks to far more than its size: zeros shrink a thousandfold."""
    with zipfile.ZipFile(path) as archive:
        claimed = sum(member.file_size for member in archive.infolist())
    if claimed > (most := _FREE_BYTES + _MAX_EXPANSION * Path(path).stat().st_size):
        raise EnvError(
            f"{path} unpacks to {claimed} bytes, at most {most} of a {what} of its size: it is "
            "damaged or made to fill the memory"
        )


def read(path: str | os.PathLike[str], what: str) -> dict[str, Any]:
    """The arrays of a file; `what` names the expected kind of file in errors."""
    try:
        if Path(path).exists() and not Path(path).is_file():
            raise EnvError(f"{path}: no file, so no {what}")
        if not zipfile.is_zipfile(path) and Path(path).is_file():
            raise EnvError(f"{path}: not a whole {what}, which is a .npz archive")
        _check_size(path, what)
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = dict(archive)
        for name, found in arrays.items():
            if not isinstance(found, np.ndarray):  # numpy gives the bytes of such a member
                raise EnvError(f"{path}: not a whole {what} ({name[:40]!r} is no array)")
        return arrays
    except FileNotFoundError:
        raise EnvError(f"{path}: no such {what}") from None
    except EnvError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise different types for broken files
        raise EnvError(f"{path}: not a whole {what} ({error})") from error
