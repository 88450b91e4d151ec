"""Rows of the pareto experiment as CSV, one file an environment, and read again for the page.

Each row is of one training; `training_seeds` says how many trainings its policy has at that level
and place. `scores` are returns of walkers; of karts they are finishes, and `returns` stand beside.
"""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from lab.experiments.pareto.costs import energies
from spikedeploy.reports.csv_rows import Record, read_rows, write_rows

_FIRST = (
    "env", "student", "trained_by", "seed", "level", "place", "part", "episodes", "return_mean",
    "falls", "lap_time", "crashes", "operations", "graded_operations", "bias_operations", "neurons",
    "neuron_updates", "readout_updates", "neuron_idle", "messages", "events", "spikes_out",
    "sparsity", "saturations", "observations", "constants", "on_host", "refusal",
    "training_seeds",
)  # fmt: skip
_LAST = "scores"  # of the episodes, in the order of their seeds
_POINT = ("student", "trained_by", "level", "place", "part")  # rows that differ in the seed alone
_TEXT = ("env", "student", "trained_by", "place", "part", "refusal")


def write(found: Iterable[Record], path: Path) -> Path:
    """Write rows with their energies; missing fields stay empty."""
    rows = _counted([row | energies(row) for row in found])
    names = dict.fromkeys(name for row in rows for name in row)
    return write_rows(
        rows, [*_FIRST, *(n for n in names if n not in _FIRST and n != _LAST), _LAST], path
    )


def _counted(rows: list[Record]) -> list[Record]:
    """The rows with the number of trainings; those of shipped references have none."""
    trainings = Counter(map(_point, rows))
    return [
        row if row.get("level") is None else row | {"training_seeds": trainings[_point(row)]}
        for row in rows
    ]


def _point(row: Record) -> tuple[object, ...]:
    return tuple(row.get(name) for name in _POINT)


def read(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    return read_rows(path, _TEXT)
