"""Metrics of a run: CSV file, and learning curve drawn from it."""

import csv
from collections.abc import Mapping
from pathlib import Path

from spikedeploy.trainers.atomic import replacing

_RENAMED = {"hoist": "support_force"}  # columns of version 0.1
_CURVES = {"episode_return": "training", "eval_return": "validation"}


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
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {_RENAMED.get(key, key): float(value) for key, value in row.items() if value}
            for row in csv.DictReader(file)
        ]


def _rounded(row: Mapping[str, float]) -> dict[str, str]:
    return {key: f"{value:.10g}" for key, value in row.items()}


def draw_curve(metrics: Path, picture: Path, title: str) -> bool:
    """Draw the returns of a metrics file as PNG; return whether there are any."""
    rows = read(metrics)
    steps = next(iter(rows[0]), None) if rows else None
    if steps is None or not any(name in row for row in rows for name in _CURVES):
        return False
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    for name, label in _CURVES.items():
        points = [(row[steps], row[name]) for row in rows if name in row]
        if points:
            axes.plot(
                *zip(*points, strict=True), label=label, marker="." if len(points) < 80 else ""
            )
    axes.set(xlabel=steps.replace("_", " "), ylabel="return", title=title)
    axes.grid(alpha=0.3)
    axes.legend()
    with replacing(picture) as temporary:
        FigureCanvasAgg(figure)
        figure.savefig(temporary, format="png", dpi=120)
    return True
