"""Mutations of a .npz archive's arrays, and of a TOML file's lines."""

import zipfile
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

Rng: TypeAlias = np.random.Generator


def _arrays(path: Path) -> dict[str, Any]:
    with path.open("rb") as file, np.load(file) as archive:
        return dict(archive)


def _write(path: Path, arrays: dict[str, Any]) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def other_array(path: Path, rng: Rng) -> None:
    """An array has other numbers, axes or another type."""
    arrays = _arrays(path)
    name = str(rng.choice(sorted(arrays)))
    old = arrays[name]
    values: list[Any] = [
        np.full(old.shape, np.nan), np.full(old.shape, -1), np.zeros(old.shape, complex),
        old[None], old.ravel()[:0], old.ravel()[:1], np.array("text"), np.array("[" * 100_000),
        np.full(old.shape, 2**62), np.array({}, dtype=object), np.zeros(old.shape, "M8[s]"),
        np.zeros((3, 3, 3)), np.array('{"version": 1, "env_id": 3, "options": []}'),
        np.zeros(1 << 20), np.zeros(old.shape, [("a", "f8")]),
    ]  # fmt: skip
    arrays[name] = values[rng.integers(len(values))]
    _write(path, arrays)


def missing_array(path: Path, rng: Rng) -> None:
    """An array is missing, or is there under another name."""
    arrays = _arrays(path)
    moved = arrays.pop(str(rng.choice(sorted(arrays))))
    _write(path, {**arrays, **({"../x": moved} if rng.random() < 0.5 else {})})


def archive_bomb(path: Path, rng: Rng) -> None:
    """A member that unpacks to hundreds of megabytes."""
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        name, size = f"more{rng.integers(1 << 30)}.npy", int(rng.choice([1 << 20, 70 << 20]))
        archive.writestr(name, bytes(size), compresslevel=1)


def toml_line(path: Path, rng: Rng) -> None:
    """A strange line, or a strange value."""
    lines = path.read_text().splitlines()
    values = [
        "[" * 5000,
        "9" * 5000,
        "nan",
        "-1",
        "1e999",
        "[[[]]]",
        "{}",
        "'x'",
        "2020-01-01",
        "[",
    ]
    value = str(rng.choice(values))
    keys = ("hidden", "count", "steps", "seed", "batch", "env", "x.y.z", "learning_rate")
    new = value if rng.random() < 0.2 else f"{rng.choice(keys)} = {value}"
    lines[int(rng.integers(len(lines)))] = new
    path.write_text("\n".join(lines))


ARCHIVES = [other_array, other_array, missing_array, archive_bomb]
TOML = [toml_line]
