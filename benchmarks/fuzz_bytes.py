"""Mutations of a file's bytes, whatever its format."""

from pathlib import Path
from typing import TypeAlias

import numpy as np

Rng: TypeAlias = np.random.Generator


def flip(path: Path, rng: Rng) -> None:
    """Some bytes are replaced."""
    content = bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 20)):
        content[rng.integers(len(content))] = rng.integers(256)
    path.write_bytes(content)


def cut(path: Path, rng: Rng) -> None:
    """The file is cut short."""
    content = path.read_bytes()
    path.write_bytes(content[: rng.integers(1, len(content) + 1)])


def overwrite(path: Path, rng: Rng) -> None:
    """A run of bytes is all ones or all zeros."""
    content = bytearray(path.read_bytes())
    first, length = int(rng.integers(len(content))), int(rng.integers(1, 64))
    length = min(length, len(content) - first)
    content[first : first + length] = bytes([rng.choice([0, 255])]) * length
    path.write_bytes(content)


def insert(path: Path, rng: Rng) -> None:
    """A piece of the file is duplicated."""
    content = path.read_bytes()
    first, length = int(rng.integers(len(content))), int(rng.integers(1, 64))
    at = int(rng.integers(len(content)))
    path.write_bytes(content[:at] + content[first : first + length] + content[at:])


BYTES = [flip, cut, overwrite, insert]
