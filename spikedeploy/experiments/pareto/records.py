"""Rows of the pareto experiment as CSV, one file an environment, and read again for the page."""

from collections.abc import Iterable
from pathlib import Path

from spikedeploy.experiments.csv_rows import Record, read_rows, write_rows
from spikedeploy.experiments.pareto.costs import energies

_FIRST = (
    "env", "student", "trained_by", "seed", "level", "place", "part", "episodes", "return_mean",
    "falls", "lap_time", "crashes", "operations", "graded_operations", "bias_operations", "neurons",
    "neuron_updates", "readout_updates", "neuron_idle", "messages", "events", "spikes_out",
    "sparsity", "saturations", "observations", "constants", "on_host", "refusal",
)  # fmt: skip
_LAST = "scores"  # of the episodes, in the order of their seeds
_TEXT = ("env", "student", "trained_by", "place", "part", "refusal")


def write(found: Iterable[Record], path: Path) -> Path:
    """Write rows with their energies; missing fields stay empty."""
    rows = [row | energies(row) for row in found]
    names = dict.fromkeys(name for row in rows for name in row)
    return write_rows(
        rows, [*_FIRST, *(n for n in names if n not in _FIRST and n != _LAST), _LAST], path
    )


def read(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    return read_rows(path, _TEXT)
