"""Mutations of a run folder: of one of its files, by what that is."""

from pathlib import Path
from typing import TypeAlias

import numpy as np
from safetensors.numpy import load_file, save_file

from benchmarks.fuzz_archives import ARCHIVES
from benchmarks.fuzz_bytes import BYTES, flip
from benchmarks.fuzz_json import JSON

Rng: TypeAlias = np.random.Generator


def _one(folder: Path, rng: Rng, *suffixes: str) -> Path:
    """A file in it."""
    found = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    fit = [path for path in found if path.suffix in suffixes or not suffixes]
    return fit[rng.integers(len(fit))]


def flip_inside(folder: Path, rng: Rng) -> None:
    """Bytes of a file in it are replaced, or an empty one is no longer empty."""
    path = _one(folder, rng)
    if path.stat().st_size:
        flip(path, rng)
    else:
        path.write_bytes(b"x")


def bytes_inside(folder: Path, rng: Rng) -> None:
    """Bytes of one of its files."""
    BYTES[rng.integers(len(BYTES))](_one(folder, rng), rng)


def json_inside(folder: Path, rng: Rng) -> None:
    """Values of one of its JSON files."""
    JSON[rng.integers(len(JSON))](_one(folder, rng, ".json"), rng)


def ghosts_inside(folder: Path, rng: Rng) -> None:
    """Arrays of its ghosts."""
    ARCHIVES[rng.integers(len(ARCHIVES))](_one(folder, rng, ".npz"), rng)


def tensor(folder: Path, rng: Rng) -> None:
    """A tensor of a checkpoint has other numbers, axes or another type, or is missing."""
    path = _one(folder, rng, ".safetensors")
    arrays, said = dict(load_file(path)), _metadata(path)
    name = sorted(arrays)[rng.integers(len(arrays))]
    old = arrays.pop(name)
    values = [
        None, np.full_like(old, np.nan), old[None].copy(), old.ravel()[:0], old.ravel()[:1],
        np.zeros(old.shape, np.int64), np.zeros((3, 3, 3)), np.full_like(old, np.inf),
        np.zeros(1 << 20, np.float32),
    ]  # fmt: skip
    value = values[rng.integers(len(values))]
    save_file(arrays if value is None else {**arrays, name: value}, path, metadata=said)


def state(folder: Path, rng: Rng) -> None:
    """A value of what a checkpoint says about itself."""
    path = _one(folder, rng, ".safetensors")
    arrays, said = dict(load_file(path)), _metadata(path)
    text = folder / "state.json"
    text.write_text(said["state"])
    JSON[rng.integers(len(JSON))](text, rng)
    save_file(arrays, path, metadata={"state": text.read_text()})
    text.unlink()


def missing_inside(folder: Path, rng: Rng) -> None:
    """A file is missing, or empty."""
    path = _one(folder, rng)
    if rng.random() < 0.5:
        path.unlink()
    else:
        path.write_bytes(b"")


def rows(folder: Path, rng: Rng) -> None:
    """A cell of the metrics is another."""
    path = folder / "metrics.csv"
    lines = [line.split(",") for line in path.read_text().splitlines()]
    cells = lines[rng.integers(len(lines))]
    values = ("", "nan", "inf", "x", "\0", "1e999", "-1", '"', "1,2", "9" * 5000, "0x1")
    cells[rng.integers(len(cells))] = str(rng.choice(values))
    path.write_text("\n".join(map(",".join, lines)) + "\n")


def _metadata(path: Path) -> dict[str, str]:
    from safetensors import safe_open

    with safe_open(path, "np") as file:
        return dict(file.metadata())


FOLDERS = [
    bytes_inside, json_inside, json_inside, ghosts_inside, tensor, state, state, missing_inside,
    rows,
]  # fmt: skip
