"""Rows of the gymnasium experiment as CSV, and read again for the page; one row a training."""

from collections.abc import Iterable
from pathlib import Path

from lab.experiments.pareto.costs import INT8, column, energies
from spikedeploy.reports.csv_rows import Record, read_rows, write_rows

ENERGY = column(INT8, "updates")  # operations and neuron updates
_COLUMNS = (
    "env", "role", "seed", "place", "episodes", "return_mean", "terminated", "steps", "operations",
    "graded_operations", "bias_operations", "neurons", "neuron_updates", "readout_updates",
    "neuron_idle", "messages", "events", "spikes_out", "sparsity", "saturations", "observations",
    "constants", "on_host", ENERGY, "refusal", "scores",
)  # fmt: skip
_TEXT = ("env", "role", "place", "refusal")


def write(found: Iterable[Record], path: Path) -> Path:
    """Write rows with their energies; missing fields stay empty."""
    return write_rows([row | _energy(row) for row in found], _COLUMNS, path)


def _energy(row: Record) -> Record:
    """The energy of a new row; a row that was read again keeps its own."""
    if row.get(ENERGY) is not None:
        return {}
    return {name: joules for name, joules in energies(row).items() if name == ENERGY}


def read(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    return read_rows(path, _TEXT)
