"""Rows of the pareto experiment as CSV, one file an environment, and read again for the page."""

import csv
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from spikedeploy.experiments.pareto.costs import energies
from spikedeploy.files import replacing

Record = dict[str, Any]
_FIRST = (
    "env", "student", "trained_by", "seed", "level", "place", "part", "episodes", "return_mean",
    "falls", "lap_time", "crashes", "operations", "graded_operations",
    "bias_operations", "neurons",
    "neuron_updates", "readout_updates", "neuron_idle", "messages", "events", "spikes_out",
    "sparsity", "saturations", "observations", "constants", "on_host", "refusal",
)  # fmt: skip
_LAST = "scores"  # of the episodes, in the order of their seeds
_TEXT = ("env", "student", "trained_by", "place", "part", "refusal")


def write(found: Iterable[Record], path: Path) -> Path:
    """Write rows with their energies; missing fields stay empty."""
    rows = [row | energies(row) for row in found]
    names = dict.fromkeys(name for row in rows for name in row)
    order = [*_FIRST, *(n for n in names if n not in _FIRST and n != _LAST), _LAST]
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, order, lineterminator="\n")
        writer.writeheader()
        writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    return path


def read(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {name: _value(name, text) for name, text in row.items()} for row in csv.DictReader(file)
        ]


def _cell(value: object) -> object:
    if isinstance(value, list):
        return json.dumps([float(f"{each:.7g}") for each in value], separators=(",", ":"))
    return f"{value:.10g}" if isinstance(value, float) else value


def _value(name: str, text: str) -> Any:  # noqa: ANN401
    if not text:
        return None
    if name in _TEXT:
        return text
    return json.loads(text)
