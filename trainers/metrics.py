"""Metrics of a run: CSV file, and learning curve drawn from it."""

import csv
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.atomic import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_RENAMED = {"hoist": "support_force"}  # columns of version 0.1
_CURVES = {"episode_return": "training", "eval_return": "validation"}
_OPERATIONS = "eval_operations"  # pruning lowers the return, too


class Metrics:
    """A CSV file to which rows are appended; columns that a row lacks stay empty.

    path: the file
    columns: names, of which the first is the step
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
        """Drop the rows after a step, which a resumed run writes again."""
        self._write([row for row in read(self.path) if row[self.columns[0]] <= step])

    def _write(self, rows: list[dict[str, float]]) -> None:
        with replacing(self.path) as temporary, temporary.open("w", newline="") as file:
            writer = csv.DictWriter(file, self.columns)
            writer.writeheader()
            writer.writerows(_rounded(row) for row in rows)


def read(path: Path) -> list[dict[str, float]]:
    """Return the rows of a metrics file, without empty values and under present names."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [_numbers(row) for row in csv.DictReader(file)]
    except (ValueError, TypeError, csv.Error) as error:  # bytes, words, or more cells than columns
        raise ConfigError(
            f"{path} is no table of numbers ({error}). Put it back, or move it away."
        ) from error


def _numbers(row: Mapping[str, str]) -> dict[str, float]:
    return {_RENAMED.get(key, key): float(value) for key, value in row.items() if value}


def check(path: Path, columns: tuple[str, ...], step: float, logged: float | None) -> None:
    """Refuse the metrics of a run to be resumed at `step` where rows before are damaged or lost.

    logged: step of the last row before the checkpoint; None where it is not known
    """
    unit = columns[0].replace("_", " ")
    if fault := _fault(path, columns, logged):
        raise ConfigError(
            f"{path} is damaged: {fault}. Put it back, or move it away: then a new one begins at "
            f"{step:g} {unit}. The policy is not affected."
        )
    if logged is not None and not (path.is_file() and read(path)):
        print(f"{path} has no rows: they begin at {step:g} {unit}", file=sys.stderr)


def _fault(path: Path, columns: tuple[str, ...], logged: float | None) -> str:
    """Return what is wrong with a metrics file; nothing where it is whole, missing or empty."""
    if not path.is_file():
        return ""
    try:
        rows = read(path)
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    except ConfigError:
        return "it is no table of numbers"
    head = [_RENAMED.get(name, name) for name in next(csv.reader(lines), [])]
    if columns[0] not in head:
        return f"its first line is not the names of columns, of which {columns[0]} is one"
    if other := sorted(set(head) - set(columns)):
        return f"it has a column {other[0]}, which this recipe does not write"
    widths = [len(cells) for cells in csv.reader(lines)]
    if not lines[-1].endswith("\n") or set(widths) != {len(head)}:
        return "a line is cut off"
    steps = [row.get(columns[0], math.nan) for row in rows]
    if not all(map(math.isfinite, steps)):
        return f"a row has no {columns[0]}"
    if logged is not None and steps and max(steps) < logged:
        return f"its rows end at {max(steps):g}, and were written up to {logged:g}"
    return ""


def _rounded(row: Mapping[str, float]) -> dict[str, str]:
    return {key: f"{value:.10g}" for key, value in row.items()}


def draw_curve(metrics: Path, picture: Path, title: str) -> bool:
    """Draw the returns of a metrics file as PNG, and operations where they are counted.

    Return whether there are returns.
    """
    rows = read(metrics)
    steps = next(iter(rows[0]), None) if rows else None
    if steps is None or not any(name in row for row in rows for name in _CURVES):
        return False
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    for name, label in _CURVES.items():
        points = [(row[steps], row[name]) for row in rows if name in row]
        if points:
            axes.plot(
                *zip(*points, strict=True), label=label, marker="." if len(points) < 80 else ""
            )
    axes.set(xlabel=steps.replace("_", " "), ylabel="return", title=title)
    axes.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], integer=True))
    axes.grid(alpha=0.3)
    _draw_operations(axes, [(r[steps], r[_OPERATIONS]) for r in rows if _OPERATIONS in r])
    axes.legend()
    with replacing(picture) as temporary:
        FigureCanvasAgg(figure)
        figure.savefig(temporary, format="png", dpi=120)
    return True


def _draw_operations(axes: "Axes", points: list[tuple[float, float]]) -> None:
    """Draw (step, operations of a control step) on an axis of their own, at the right."""
    if not points:
        return
    right, grey = axes.twinx(), "#8A939E"
    right.plot(*zip(*points, strict=True), "--", color=grey, linewidth=1)
    right.set_ylabel("operations of a control step (dashed)", color=grey)
    right.set_ylim(0, 1.15 * max(count for _, count in points) or 1.0)
    right.tick_params(axis="y", colors=grey)
