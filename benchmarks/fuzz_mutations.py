"""Mutations of a file: of its bytes, and of its contents where its format is known."""

import shutil
from pathlib import Path

import numpy as np

from benchmarks.fuzz_bytes import flip
from benchmarks.fuzz_folders import flip_inside
from benchmarks.fuzz_formats import damages


def mutate(source: Path, target: Path, rng: np.random.Generator, name: str = "") -> str:
    """Write the source with one or several mutations; the names of those.

    name: of the format, which says how many of them are of bytes.
    """
    shutil.copytree(source, target) if source.is_dir() else shutil.copyfile(source, target)
    done = []
    for _ in range(1 + rng.geometric(0.6) if rng.random() < 0.4 else 1):
        choices = damages(source.suffix, rng, name)
        change = choices[rng.integers(len(choices))]
        try:
            with np.errstate(all="ignore"):
                change(target, rng)
        except Exception:
            change = flip_inside if target.is_dir() else flip
            change(target, rng)
        done.append(change.__name__)
        if change.__name__ == "huge_claim":  # of which another mutation might write gigabytes
            break
    return "+".join(done)
