"""Mutations of a JSON file's values."""

import json
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

Rng: TypeAlias = np.random.Generator


def json_value(path: Path, rng: Rng) -> None:
    """A value anywhere in the tree is replaced."""
    tree = json.loads(path.read_text())
    places: list[tuple[Any, Any]] = []
    _walk(tree, places)
    place, key = places[rng.integers(len(places))]
    values: list[Any] = [
        None, True, "text", "", [], {}, [[]], -1, 0, 1, 0.5, 10**6, 10**30, -(2**63), 1e308,
        float("nan"), float("inf"), [[1], [2, 3]], {"a": [1]}, "loihi2", [1] * 50,
    ]  # fmt: skip
    place[key] = values[rng.integers(len(values))]
    path.write_text(json.dumps(tree))


def json_missing(path: Path, rng: Rng) -> None:
    """A value anywhere in the tree is deleted."""
    tree = json.loads(path.read_text())
    places: list[tuple[Any, Any]] = []
    _walk(tree, places)
    place, key = places[rng.integers(len(places))]
    del place[key]
    path.write_text(json.dumps(tree))


def json_deep(path: Path, rng: Rng) -> None:
    """Deeply nested lists."""
    tree = json.loads(path.read_text())
    key = rng.choice(list(tree))
    depth = int(rng.choice([3, 40, 100_000]))
    text = json.dumps({**tree, key: "HERE"})
    path.write_text(text.replace('"HERE"', "[" * depth + "]" * depth))


def _walk(tree: Any, places: list[tuple[Any, Any]]) -> None:  # noqa: ANN401
    keys = tree if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in keys:
        places.append((tree, key))
        _walk(tree[key], places)


JSON = [json_value, json_value, json_missing, json_deep]
