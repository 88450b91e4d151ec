"""Stable-Baselines3's .zip files, read without unpickling anything that could run code.

    data        JSON; what JSON cannot say is pickled and base64 inside it, and stays unread
    policy.pth  the state dict, a zip of torch's that its reader of weights alone accepts

Sizes are bounded before anything is decompressed.
"""

import io
import json
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from spikedeploy.runtime.errors import ConfigError

_LARGEST = {"data": 2**24, "policy.pth": 2**28}  # bytes when decompressed: 16 and 256 MiB
_ZIP = (zipfile.BadZipFile, NotImplementedError, ValueError)  # of a damaged archive
# Stable-Baselines3 compresses nothing, and weights hardly compress
_FREE, _RATIO = 2**20, 16  # bytes that any file may unpack to, and more for each that it takes


@dataclass(frozen=True)
class Sb3File:
    """A saved model.

    path: of the file
    data: its JSON
    tensors: the policy's state dict
    """

    path: str
    data: Mapping[str, Any]
    tensors: Mapping[str, Tensor]


def read_sb3(path: str) -> Sb3File:
    """Return what a .zip file of Stable-Baselines3 says, or raise ConfigError."""
    raw = _members(path)
    try:
        data = json.loads(raw["data"])
    except (ValueError, RecursionError) as error:
        raise _damaged(path, f"data is no JSON: {error}") from error
    if not isinstance(data, dict):
        raise _damaged(path, "data is no table")
    return Sb3File(path, data, _tensors(path, raw["policy.pth"]))


def _members(path: str) -> dict[str, bytes]:
    """Return the bytes of the two files that are read."""
    try:
        with zipfile.ZipFile(path) as archive:
            if missing := sorted(_LARGEST.keys() - set(archive.namelist())):
                raise ConfigError(
                    f"{path} is no model of Stable-Baselines3: it has no {' and no '.join(missing)}"
                )
            return {name: _bounded(path, archive, name) for name in _LARGEST}
    # ValueError of names that are no text; what zipfile raises besides depends on the damage
    except (*_ZIP, zlib.error, EOFError, RuntimeError, OSError) as error:
        if isinstance(error, OSError) and error.filename is not None:
            raise  # there is no such file
        raise _damaged(path, str(error)) from error


def _bounded(path: str, archive: zipfile.ZipFile, name: str) -> bytes:
    """Return a file's bytes; more of them than the limit are neither read nor decompressed."""
    limit, member = _LARGEST[name], archive.getinfo(name)
    if member.file_size > limit:
        raise ConfigError(
            f"{path}: {name} has more than {limit >> 20} MiB; larger ones are not read. Export "
            "the policy to ONNX"
        )
    _check_ratio(path, name, [member])
    with archive.open(member) as file:
        return file.read(limit)  # which ends where the header says


def _check_ratio(path: str, name: str, members: Sequence[zipfile.ZipInfo]) -> None:
    """Refuse what would unpack to far more than it takes."""
    packed = sum(each.compress_size for each in members)
    whole = sum(each.file_size for each in members)
    if whole > _FREE + _RATIO * packed:
        raise _damaged(
            path,
            f"{name} would unpack from {packed:,} to {whole:,} bytes, more than {_RATIO} times as "
            "many. Save the model again without compression",
        )


def _tensors(path: str, raw: bytes) -> dict[str, Tensor]:
    """Return the state dict, read by torch's reader that runs no code."""
    _check_inside(path, raw)
    try:
        found = torch.load(io.BytesIO(raw), map_location="cpu", weights_only=True)
    except Exception as error:  # whatever a damaged file makes of torch's reader
        first = str(error).partition("\n")[0]
        raise _damaged(path, f"policy.pth holds more than weights, or is cut: {first}") from error
    if not isinstance(found, dict) or not all(isinstance(each, Tensor) for each in found.values()):
        raise _damaged(path, "policy.pth is no state dict")
    for name, each in found.items():
        _check_plain(path, str(name), each)
    if sum(each.numel() for each in found.values()) > _LARGEST["policy.pth"] // 4:
        raise _damaged(path, "policy.pth has tensors larger than their file")
    return {str(name): tensor for name, tensor in found.items()}


def _check_plain(path: str, name: str, tensor: Tensor) -> None:
    """Refuse tensors that are no arrays of numbers: sparse, nested, quantised or without data."""
    special = tensor.is_nested or tensor.is_quantized or tensor.device.type != "cpu"
    if special or tensor.layout != torch.strided:
        raise _damaged(path, f"its tensor {name:.60} is sparse, nested, quantised or without data")


def _check_inside(path: str, raw: bytes) -> None:
    """Refuse what torch would read by other ways than as weights: scripts, and its old format."""
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            members = archive.infolist()
    except _ZIP as error:
        raise _damaged(path, "policy.pth is in the format of torch before 1.6") from error
    if any(each.filename.endswith("constants.pkl") for each in members):
        raise _damaged(path, "policy.pth is a script of torch, which runs code")
    if sum(each.file_size for each in members) > _LARGEST["policy.pth"]:
        raise _damaged(path, "policy.pth says that it is larger than 256 MiB")
    _check_ratio(path, "policy.pth", members)


def _damaged(path: str, what: str) -> ConfigError:
    return ConfigError(f"{path} cannot be read as a model of Stable-Baselines3: {what}")
