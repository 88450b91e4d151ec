"""Rows of the robustness experiment as CSV, with what is kept of the undisturbed return."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lab.experiments.robustness.design import UNDISTURBED
from spikedeploy.comparison.statistics import grouped_ratio
from spikedeploy.reports.csv_rows import Record, read_rows, write_rows

_COLUMNS = (
    "env", "policy", "kind", "chip", "part", "name", "level", "number", "unit", "episodes",
    "return_mean", "success_rate", "kept", "kept_low", "kept_high", "hit", "of", "what",
    "groups", "returns", "successes",
)  # fmt: skip
_TEXT = ("env", "policy", "kind", "chip", "part", "name", "unit", "what")


def write(found: Iterable[Record], path: Path) -> Path:
    """Write rows; missing fields stay empty."""
    return write_rows(with_kept(list(found)), _COLUMNS, path)


def read(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    return read_rows(path, _TEXT)


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
