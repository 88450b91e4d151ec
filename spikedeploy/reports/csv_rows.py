"""Rows of results as CSV."""

import csv
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from spikedeploy.files import replacing

Record = dict[str, Any]


def write_rows(found: Iterable[Record], columns: Sequence[str], path: Path) -> Path:
    """Write rows; missing fields stay empty, a field without a column raises ValueError."""
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n", extrasaction="raise")
        writer.writeheader()
        writer.writerows({name: _cell(value) for name, value in row.items()} for row in found)
    return path


def _cell(value: object) -> object:
    if isinstance(value, list):
        return json.dumps([float(f"{each:.7g}") for each in value], separators=(",", ":"))
    return f"{value:.10g}" if isinstance(value, float) else value
