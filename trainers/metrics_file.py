"""Tables of numbers that a training appends to, as CSV files, and the learning curve of one."""

import csv
import io
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import flush, replacing
from spikedeploy.trainers.run_folder import write_errors

_CURVES = {"episode_return": "training", "eval_return": "validation"}
_MAX_BYTES = 100_000_000  # of a table, of which a training writes a thousandth
_OPERATIONS = "eval_operations"  # pruning lowers the return, too


class Metrics:
    """A CSV file to which rows are appended; columns that a row lacks stay empty.

    path: path of the file
    columns: names, of which the first is the step
    """

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        self.path, self.columns = path, columns

    def begin(self) -> None:
        """Write a file without rows, unless there is a file."""
        if not self.path.exists():
            self._write([])

    def add(self, row: Mapping[str, float]) -> None:
        """Append one row."""
        with write_errors(self.path), self.path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self.columns).writerow(_rounded(row))

    def rewind(self, step: float) -> None:
        """Drop the rows after a step, which a resumed run writes again, and one that is cut off."""
        found = self.path.read_bytes()
        rows = _table(self.path, found[: found.rfind(b"\n") + 1])
        self._write([row for row in rows if row.get(self.columns[0], math.inf) <= step])

    def flush(self) -> None:
        """Put the rows onto the disk, before a checkpoint relies on them."""
        if self.path.is_file():
            flush(self.path)

    def _write(self, rows: Iterable[Mapping[str, float]]) -> None:
        with (
            write_errors(self.path),
            replacing(self.path) as part,
            part.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.DictWriter(file, self.columns)
            writer.writeheader()
            writer.writerows(_rounded(row) for row in rows)


def read(path: Path) -> list[dict[str, float]]:
    """Return the rows of a metrics file, without empty values."""
    if not path.is_file():
        what = "is no plain file" if path.exists() else "is missing"
        raise ConfigError(f"{path} {what}: a run has its returns there. Put it back from the run.")
    if (size := path.stat().st_size) > _MAX_BYTES:
        raise ConfigError(f"{path} has {size:,} bytes; at most {_MAX_BYTES:,}. Move it away.")
    return _table(path, path.read_bytes())


def _table(path: Path, content: bytes) -> list[dict[str, float]]:
    try:
        return [
            {key: float(value) for key, value in row.items() if value}
            for row in csv.DictReader(io.StringIO(content.decode(), newline=""))
        ]
    except (ValueError, TypeError, csv.Error) as error:  # bytes, words, or more cells than columns
        raise ConfigError(
            f"{path} is no table of numbers ({error}). Put it back, or move it away."
        ) from error


def spike_rate(row: Mapping[str, Any]) -> float | None:
    """Return the spikes of a row for each neuron and timestep, the mean of its layers."""
    silent = [value for name, value in row.items() if name.startswith("sparsity_lif")]
    return 1.0 - sum(silent) / len(silent) if silent else None


def _rounded(row: Mapping[str, float]) -> dict[str, str]:
    return {key: f"{value:.10g}" for key, value in row.items()}


def draw_curve(metrics: Path, picture: Path, title: str) -> None:
    """Draw the returns of a metrics file, if any, as PNG, and operations where they are counted."""
    rows = read(metrics)
    steps = next(iter(rows[0]), None) if rows else None
    if steps is None or not any(name in row for row in rows for name in _CURVES):
        return
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    for name, label in _CURVES.items():
        if points := [(row[steps], row[name]) for row in rows if name in row]:
            marker = "." if len(points) < 80 else ""
            axes.plot(*zip(*points, strict=True), label=label, marker=marker)
    axes.set(xlabel=steps.replace("_", " "), ylabel="return", title=title)
    axes.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], integer=True))
    axes.grid(alpha=0.3)
    if points := [(row[steps], row[_OPERATIONS]) for row in rows if _OPERATIONS in row]:
        right, grey = axes.twinx(), "#8A939E"
        right.plot(*zip(*points, strict=True), "--", color=grey, linewidth=1)
        right.set_ylabel("operations of a control step (dashed)", color=grey)
        right.set_ylim(0, 1.15 * max(count for _, count in points) or 1.0)
        right.tick_params(axis="y", colors=grey)
    axes.legend()
    with replacing(picture) as part:
        FigureCanvasAgg(figure)
        figure.savefig(part, format="png", dpi=120)
