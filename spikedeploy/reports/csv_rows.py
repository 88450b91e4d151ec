"""Rows of an experiment as CSV, and read again for its page."""

import csv
import json
from collections.abc import Collection, Iterable, Sequence
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


def read_rows(path: Path, texts: Collection[str]) -> list[Record]:
    """The rows of a CSV; missing fields are None. Columns other than `texts` hold JSON."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {name: _value(text, name in texts) for name, text in row.items()}
            for row in csv.DictReader(file)
        ]


def _cell(value: object) -> object:
    if isinstance(value, list):
        return json.dumps([float(f"{each:.7g}") for each in value], separators=(",", ":"))
    return f"{value:.10g}" if isinstance(value, float) else value


def _value(text: str, is_text: bool) -> Any:  # noqa: ANN401
    if not text:
        return None
    return text if is_text else json.loads(text)
