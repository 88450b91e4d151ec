"""Rasters: recorded input of a network, a row for each timestep, in .npy, .npz or NIRData."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.artifact.hdf5 import byte_budget
from spikedeploy.runtime.artifact.nir_data import EXPANSION, FREE, is_nir_data, read_nir_data
from spikedeploy.runtime.errors import ObservationError
from spikedeploy.runtime.files import replacing
from spikedeploy.runtime.graph.ports import check_unmasked, ports

Raster = NDArray[Any]

# letters of numpy for types of numbers that are no spikes
_KINDS = {"c": "complex numbers", "S": "text", "U": "text", "V": "records, not numbers",
          "M": "dates, not numbers", "m": "durations, not numbers"}  # fmt: skip


def read_rasters(path: Path) -> Raster | dict[str, Raster]:
    """(T, *shape) of a .npy file, or of each array in a .npz file, by the name of its Input.

    Spikes, and counts of them up to 255, in uint8; anything else in float64.
    """
    if not path.is_file():
        raise ObservationError(f"{path} is no file. Give a .npy or .npz file.")
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                claimed = sum(member.file_size for member in archive.infolist())
            _check_claim(path, claimed)
            # opened here, because numpy leaves it open where the archive is broken
            with path.open("rb") as file, np.load(file, allow_pickle=False) as members:
                arrays, most = dict(members), byte_budget(path, FREE, EXPANSION)
            if not arrays:
                raise ObservationError(f"{path} holds no array. Write at least one with numpy.")
            return {name: _checked(f"{path}: {name}", a, most) for name, a in arrays.items()}
        # memory-mapped: a header that claims more than the file holds takes no memory
        with np.errstate(over="raise"):  # of the product of a shape, which numpy only warns of
            raster = np.lib.format.open_memmap(path, mode="r")
        _check_claim(path, raster.nbytes)
        return _checked(str(path), raster, byte_budget(path, FREE, EXPANSION))
    except ObservationError:
        raise
    except FloatingPointError as error:
        raise ObservationError(f"{path} claims more numbers than any memory holds.") from error
    # zipfile, zlib and numpy raise their own exceptions for a broken file
    except Exception as error:
        raise ObservationError(
            f"{path} is not a .npy or .npz file with plain arrays: {error}. Write it with numpy."
        ) from error


def read_inputs(path: Path, artifact: Artifact) -> Raster | dict[str, Raster]:
    """The rasters of a network's Inputs: of a .npy or .npz file, or of NIRData in HDF5."""
    if not is_nir_data(path):
        return read_rasters(path)
    shapes = {port.name: port.shape for port in ports(artifact.graph.inputs)}
    found = read_nir_data(path, shapes, artifact.convention.dt)
    most = byte_budget(path, FREE, EXPANSION)
    return {name: _checked(f"{path}: {name}", rows, most) for name, rows in found.items()}


def write_rasters(path: Path, arrays: Mapping[str, Raster], remark: str) -> None:
    """Write arrays by name to a .npz file, whose comment is a remark."""
    with (
        replacing(path) as part,
        zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive,
    ):
        archive.comment = remark.encode()
        for name, rows in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(rows), allow_pickle=False)


def _check_claim(path: Path, claimed: int) -> None:
    """Refuse what takes far more memory than disk: holes and zeros."""
    if claimed > (most := byte_budget(path, FREE, EXPANSION)):
        raise ObservationError(
            f"{path} would be {claimed} bytes when unpacked; the limit of a file of its size is "
            f"{most}. Split it, and play the parts one by one."
        )


def _checked(where: str, found: object, most: int | None = None) -> Raster:
    """The raster, if it is one that takes at most so many bytes."""
    if not isinstance(found, np.ndarray) or found.ndim < 1 or not found.size:
        shape = f"shape {found.shape}" if isinstance(found, np.ndarray) else type(found).__name__
        raise ObservationError(f"{where} must hold an array (T, *shape), found {shape}")
    wanted = "it must hold spikes, 0 or 1, or other finite numbers"
    if found.dtype.kind not in "biuf":
        raise ObservationError(
            f"{where} holds {_KINDS.get(found.dtype.kind, 'no numbers')}; {wanted}"
        )
    if found.dtype.kind == "f" and not np.isfinite(found).all():
        raise ObservationError(f"{where} holds NaN or infinity; {wanted}")
    counts = found.min() >= 0 and found.max() <= 255
    counts = counts and (found.dtype.kind != "f" or (found == np.rint(found)).all())
    if not counts and most is not None and 8 * found.size > most:
        raise ObservationError(
            f"{where} holds {found.size} numbers, which take 8 bytes each; the limit of a file of "
            f"its size is {most} bytes. Split it, and play the parts one by one."
        )
    return found.astype(np.uint8 if counts else np.float64)


def in_batch(rasters: Raster | Mapping[str, Raster]) -> Raster | dict[str, Raster]:
    """The rasters as a batch of one, (1, T, *shape)."""
    if isinstance(rasters, Mapping):
        return {name: rows[None] for name, rows in rasters.items()}
    return rasters[None]


def as_raster(found: object) -> Raster:
    """The raster (T, *shape) that an array is, in the type that a file of it would have."""
    check_unmasked(found)
    if getattr(found, "requires_grad", False):
        raise ObservationError(
            "the raster is a tensor that requires grad, which a run does not compute. Give "
            "raster.detach(); sd.on_chip has gradients."
        )
    return _checked("the raster", np.asarray(found))
