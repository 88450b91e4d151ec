"""Mutations of a file: of its bytes, and of its contents where its format is known."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from benchmarks.fuzz_archives import ARCHIVES, TOML
from benchmarks.fuzz_bytes import BYTES, flip
from benchmarks.fuzz_hdf5 import HDF5
from benchmarks.fuzz_json import JSON

Rng: TypeAlias = np.random.Generator
STRUCTURED: dict[str, list[Callable[[Path, Rng], None]]] = {
    ".nir": HDF5,
    ".json": JSON,
    ".config": JSON,
    ".npz": ARCHIVES,
    ".ghosts": ARCHIVES,
    ".rollout": ARCHIVES,
    ".toml": TOML,
}


def mutate(source: Path, target: Path, rng: Rng) -> str:
    """Write the source with one or several mutations; the names of those."""
    target.write_bytes(source.read_bytes())
    by_kind = STRUCTURED.get(source.suffix, [])
    done = []
    for _ in range(1 + rng.geometric(0.6) if rng.random() < 0.4 else 1):
        choices: list[Any] = by_kind if by_kind and rng.random() < 0.75 else BYTES
        change = choices[rng.integers(len(choices))]
        try:
            change(target, rng)
        except Exception:
            flip(target, rng)
            change = flip
        done.append(change.__name__)
    return "+".join(done)
