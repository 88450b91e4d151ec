"""Rows of the lineup experiment as CSV, and read again for the page; one row a training.

Rows of trainings that are not here are kept as they are in the table.
"""

import csv
from collections.abc import Sequence
from pathlib import Path

from lab.experiments.lineup.design import LineupDesign
from lab.experiments.lineup.evaluation import all_rows, has_fields, key
from spikedeploy.reports.csv_rows import Record, read_rows, write_rows
from spikedeploy.runtime.errors import ConfigError

_COLUMNS = (
    "env", "policy", "seed", "shipped", "kind", "chip", "episodes", "return_mean", "success_rate",
    "falls", "cot", "speed_rmse", "turn_rmse", "sops_per_inference", "macs_dense",
    "macs_effective", "quick", "versions", "returns", "successes",
)  # fmt: skip
_TEXT = ("env", "policy", "shipped", "kind", "chip", "quick", "versions")


def write(design: LineupDesign, table: Path) -> None:
    """Write the complete rows, and those of the table so far that have no new one."""
    rows = _merged(list(all_rows(design)), kept(design, table))
    about = {"quick": "yes" if design.quick else ""}
    table.parent.mkdir(parents=True, exist_ok=True)
    write_rows(
        (row | {"shipped": "yes" if row["shipped"] else ""} | about for row in rows),
        _COLUMNS,
        table,
    )


def kept(design: LineupDesign, table: Path) -> list[Record]:
    """The rows of the table so far; ConfigError where they cannot stand beside those of the design.

    That is where they have other episodes, another chip, or quick trainings.
    """
    rows = read(table) if table.is_file() else []
    for row in rows:
        alike = row["episodes"] == design.episodes and bool(row["quick"]) == design.quick
        if not alike or row["chip"] not in (None, design.chip):
            raise ConfigError(
                f"{table} has rows of {row['episodes']} episodes"
                f"{', of quick trainings' if row['quick'] else ''}"
                f"{', on ' + row['chip'] if row['chip'] else ''}: name another folder with -o"
            )
    return rows


def read(table: Path) -> list[Record]:
    """The rows of the table; ConfigError where it is damaged."""
    try:
        rows = read_rows(table, _TEXT)
        for row in rows:
            if tuple(row) != _COLUMNS or not has_fields(row):
                raise ValueError(f"a row of {row.get('policy')}")
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"{table} is damaged ({error}): put it back, or move it away") from error
    return rows


def _merged(new: Sequence[Record], old: Sequence[Record]) -> list[Record]:
    here = {key(row) for row in new}
    rows = [*new, *(row for row in old if key(row) not in here)]
    return sorted(rows, key=lambda row: (row["env"], _size(row), row["policy"], row["seed"]))


def _size(row: Record) -> float:
    """Weights, by which policies are ordered; the same for all trainings of a policy."""
    return float(row.get("macs_dense") or 0)
