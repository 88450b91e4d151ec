"""Metrics of a training: a journal that writes them, a reader of its CSV file, a learning curve."""

import csv
import io
import math
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import replacing
from spikedeploy.trainers.run_folder import RunFolder, write_errors

if TYPE_CHECKING:
    from spikedeploy.trainers.progress import ProgressBar

_CURVES = {"episode_return": "training", "eval_return": "validation"}
_MAX_BYTES = 100_000_000  # of a table, of which a training writes a thousandth
_OPERATIONS = "eval_operations"  # pruning lowers the return, too


class Journal:
    """Rows of metrics, to a CSV file, TensorBoard and the progress bar, while an algorithm learns.

    Columns that a row lacks stay empty in the file.
    """

    def __init__(
        self,
        run: RunFolder,
        columns: tuple[str, ...],
        bar: "ProgressBar",
        watch: Callable[[Path], None] | None = None,
    ) -> None:
        """columns: names, of which the first is the step; watch: called after each row."""
        self._run, self._columns, self._watch = run, columns, watch
        self.board = _TensorBoardLog(run.path)
        self.bar = bar
        if not run.metrics.exists():
            self._write([])

    def move_to(self, step: int, total: int) -> None:
        """Report progress."""
        self.bar.move_to(step, total)

    def add(self, row: Mapping[str, float]) -> None:
        """Report one row of metrics; values without a column are dropped."""
        known = {name: row[name] for name in self._columns if name in row}
        path = self._run.metrics
        with write_errors(path), path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self._columns).writerow(_rounded(known))
        shown = {}  # what TensorBoard and people see of a validation, and the CSV has not
        if (success := row.get("eval_success", row.get("eval_finish"))) is not None:
            shown["eval_success"] = success
        if (rate := spike_rate(row)) is not None:
            shown["spike_rate"] = rate
        self.board.add(int(row[self._columns[0]]), {**known, **shown})
        self.bar.show({**row, **shown})
        if self._watch is not None:
            self._watch(self._run.path)

    def rewind(self, step: int, logged: float | None) -> None:
        """Drop the rows after a step, which a resumed run writes again, and one that is cut off.

        logged: step of the last row that was written before; ConfigError where rows end earlier
        """
        path, name = self._run.metrics, self._columns[0]
        found = path.read_bytes()
        rows = _table(path, found[: found.rfind(b"\n") + 1])
        last = max((row.get(name, -math.inf) for row in rows), default=-math.inf)
        if rows and last < (logged or -math.inf):
            raise ConfigError(
                f"{path} is damaged: its rows end at {last:g}, and were written up to {logged:g}. "
                "Put it back, or move it away: then a new one begins. The policy is not affected."
            )
        if unknown := {key for row in rows for key in row} - set(self._columns):
            raise ConfigError(
                f"{path} has columns of another training ({', '.join(sorted(unknown))}). Put it "
                "back, or move it away: then a new one begins. The policy is not affected."
            )
        if logged is not None and not rows:
            print(f"{path} has no rows: they begin at {step:,}", file=sys.stderr)
        upto = -math.inf if logged is None else min(step, logged)
        self._write([row for row in rows if row.get(name, math.inf) <= upto])
        self.board.rewind(step)

    def close(self) -> None:
        """Close the files."""
        self.board.close()

    def _write(self, rows: Iterable[Mapping[str, float]]) -> None:
        path = self._run.metrics
        with (
            write_errors(path),
            replacing(path) as part,
            part.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.DictWriter(file, self._columns)
            writer.writeheader()
            writer.writerows(_rounded(row) for row in rows)


class _TensorBoardLog:
    """TensorBoard event file in the run folder; does nothing if TensorBoard is not installed."""

    def __init__(self, folder: Path) -> None:
        self._writer: Any = None
        self._folder = folder
        if find_spec("tensorboard") is not None:
            self._open()

    def _open(self, purge_step: int | None = None) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(self._folder), purge_step=purge_step)

    def rewind(self, step: int) -> None:
        """Let TensorBoard hide the points after a step."""
        if self._writer is not None:
            self._writer.close()
            self._open(step + 1)

    def add(self, step: int, row: Mapping[str, float]) -> None:
        """Add one point to the curve of each column."""
        if self._writer is not None:
            for name, value in row.items():
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Flush and close the file."""
        if self._writer is not None:
            self._writer.close()


def read_metrics(path: Path) -> list[dict[str, float]]:
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
    rows = read_metrics(metrics)
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
