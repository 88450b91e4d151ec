"""The formats that are fuzzed: the files of each, and how those are damaged."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from benchmarks.fuzz_archives import ARCHIVES, MODELS, NUMPY, TOML
from benchmarks.fuzz_bytes import BYTES
from benchmarks.fuzz_folders import FOLDERS
from benchmarks.fuzz_hdf5 import ARRAYS, HDF5
from benchmarks.fuzz_json import JSON
from benchmarks.fuzz_onnx import ONNX

Damage: TypeAlias = Callable[[Path, np.random.Generator], None]


@dataclass(frozen=True)
class Format:
    """Files that are fuzzed together.

    suffix: of the files that fuzzing starts from.
    contents: damages of what such files hold.
    bytes: part of the damages that are of bytes.
    """

    suffix: str
    contents: list[Damage]
    bytes: float = 0.25


FORMATS = {
    "nir": Format(".nir", HDF5, 0.0),
    "nir-bytes": Format(".nir", [], 1.0),
    "nirdata": Format(".h5", ARRAYS),
    "onnx": Format(".onnx", ONNX),
    "npz": Format(".npz", ARCHIVES),
    "npy": Format(".npy", NUMPY),
    "ghosts": Format(".ghosts", ARCHIVES),
    "rollouts": Format(".rollout", ARCHIVES),
    "tracks": Format(".track", JSON),
    "traces": Format(".trace", JSON),
    "json": Format(".json", JSON),
    "toml": Format(".toml", TOML),
    "sb3": Format(".zip", MODELS),
    "runs": Format(".run", FOLDERS, 0.0),
}


def damages(suffix: str, rng: np.random.Generator, name: str = "") -> list[Damage]:
    """Those from which one is drawn: of contents, or of bytes.

    name: of the format; by default the first with this suffix, with an eighth of bytes more.
    """
    found = FORMATS[name] if name else of_suffix(suffix)
    share = found.bytes if name or not found.contents else max(found.bytes, 0.25)
    plain = suffix != ".run" and rng.random() < share
    return list(BYTES) if plain or not found.contents else found.contents


def of_suffix(suffix: str) -> Format:
    """The first format with this suffix."""
    return next(each for each in FORMATS.values() if each.suffix == suffix)
