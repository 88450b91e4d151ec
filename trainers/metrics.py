"""The metrics of a run as CSV: one row for each logging interval."""

import csv
from collections.abc import Mapping
from pathlib import Path

from spikedeploy.trainers.atomic import replacing


class Metrics:
    """A CSV file that grows by rows; a column that a row lacks stays empty.

    path: the file
    columns: names, the first of which is the step that rows are ordered by
    """

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        self.path = path
        self.columns = columns
        if not path.exists():
            self._write([])

    def add(self, row: Mapping[str, float]) -> None:
        """Append one row."""
        with self.path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self.columns).writerow(_rounded(row))

    def rewind(self, step: float) -> None:
        """Drop the rows after a step: a resumed run will write them again."""
        self._write([row for row in read(self.path) if row[self.columns[0]] <= step])

    def _write(self, rows: list[dict[str, float]]) -> None:
        with replacing(self.path) as temporary, temporary.open("w", newline="") as file:
            writer = csv.DictWriter(file, self.columns)
            writer.writeheader()
            writer.writerows(_rounded(row) for row in rows)


def read(path: Path) -> list[dict[str, float]]:
    """Return the rows of a metrics file, without the columns that are empty in them."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {key: float(value) for key, value in row.items() if value}
            for row in csv.DictReader(file)
        ]


def _rounded(row: Mapping[str, float]) -> dict[str, str]:
    return {key: f"{value:.10g}" for key, value in row.items()}
