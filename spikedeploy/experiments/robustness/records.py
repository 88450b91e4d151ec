"""Rows of the robustness experiment as CSV, with what is kept of the undisturbed return."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.comparison.statistics import grouped_ratio
from spikedeploy.experiments.robustness.design import UNDISTURBED
from spikedeploy.files import replacing

Record = dict[str, Any]
_COLUMNS = (
    "env", "policy", "kind", "chip", "part", "name", "level", "number", "unit", "episodes",
    "return_mean", "success_rate", "kept", "kept_low", "kept_high", "hit", "of", "what",
    "groups", "returns", "successes",
)  # fmt: skip
_TEXT = ("env", "policy", "kind", "chip", "part", "name", "unit", "what")


def write(found: Iterable[Record], path: Path) -> Path:
    """Write rows; missing fields stay empty."""
    rows = with_kept(list(found))
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, _COLUMNS, lineterminator="\n", extrasaction="raise")
        writer.writeheader()
        writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    return path


def read(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {name: _value(name, text) for name, text in row.items()} for row in csv.DictReader(file)
        ]


def with_kept(rows: Sequence[Record]) -> list[Record]:
    """The rows with the share of the undisturbed return that is kept, and its interval."""
    calm = {row["policy"]: row for row in rows if row["part"] == UNDISTURBED}
    return [row | _kept(row, calm.get(row["policy"])) for row in rows]


def _kept(row: Mapping[str, Any], calm: Mapping[str, Any] | None) -> Record:
    if calm is None or row["part"] == UNDISTURBED or np.sum(calm["returns"]) <= 0:
        return {}
    rng = np.random.default_rng(0)
    found = grouped_ratio(row["returns"], calm["returns"], row["groups"], rng)
    return {"kept": found.mean, "kept_low": found.ci95[0], "kept_high": found.ci95[1]}


def _cell(value: object) -> object:
    if isinstance(value, list):
        return json.dumps([float(f"{each:.7g}") for each in value], separators=(",", ":"))
    return f"{value:.10g}" if isinstance(value, float) else value


def _value(name: str, text: str) -> Any:  # noqa: ANN401
    if name in _TEXT:
        return text or None
    return json.loads(text) if text else None
