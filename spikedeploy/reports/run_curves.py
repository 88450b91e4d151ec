"""The curves of a training run: return, success, spike rate, operations, a panel for each."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spikedeploy.reports.curves import counted_by
from spikedeploy.reports.plots import BLUE, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = Mapping[str, float]
_GREY, _ORANGE, _GREEN = "#8A939E", "#E69F00", "#009E73"
_MOST = 500  # points of a line
_ENOUGH = 80  # points, above which they are not marked


@dataclass(frozen=True)
class CurvePanel:
    """One panel: what its axis is, and its lines.

    title  of the axis
    lines  column of the metrics -> name and colour
    of     what is drawn of a value
    share  whether the axis goes from 0 to 1
    """

    title: str
    lines: Mapping[str, tuple[str, str]]
    of: Callable[[float], float] = float
    share: bool = False


_PANELS = (
    CurvePanel(
        "return of an episode",
        {"episode_return": ("training", _GREY), "eval_return": ("validation", VERMILION)},
    ),
    CurvePanel(
        "validation episodes",
        {
            "eval_finish": ("succeed", _GREEN),
            "eval_crash": ("crash", VERMILION),
            "eval_falls": ("fall", _ORANGE),
        },
        share=True,
    ),
    CurvePanel(
        "spikes a neuron\nand timestep",
        {
            f"sparsity_lif{k}": (f"layer {k}", colour)
            for k, colour in enumerate((VERMILION, BLUE, _GREEN, _ORANGE, _GREY), start=1)
        },
        lambda sparsity: 1 - sparsity,
    ),
    CurvePanel(
        "operations\na control step",
        {
            "operations": ("training", _GREY),
            "eval_operations": ("validation", VERMILION),
            "goal": ("goal of pruning", BLUE),
        },
    ),
)


def curves_figure(rows: Sequence[Row]) -> "Figure | None":
    """The panels that the metrics fill, above one axis of steps; None where they fill none."""
    panels = [panel for panel in _PANELS if any(_points(rows, name) for name in panel.lines)]
    if not panels:
        return None
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter

    figure = Figure(figsize=(8, 0.6 + 1.9 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for each, panel in zip(axes, panels, strict=True):
        _draw(each, panel, rows)
    axes[-1].set_xlabel(counted_by(next(iter(rows[0]))))
    axes[-1].xaxis.set_major_formatter(EngFormatter(sep=""))
    return figure


def _points(rows: Sequence[Row], column: str) -> list[tuple[float, float]]:
    """(step, value) of a column, thinned where there are many."""
    steps = next(iter(rows[0])) if rows else ""
    found = [
        (row[steps], row[column]) for row in rows if column in row and math.isfinite(row[column])
    ]
    return found[:: max(1, -(-len(found) // _MOST))]


def _draw(axes: "Axes", panel: CurvePanel, rows: Sequence[Row]) -> None:
    values: list[float] = []
    for column, (name, colour) in panel.lines.items():
        if points := _points(rows, column):
            steps, found = zip(*points, strict=True)
            drawn = [panel.of(value) for value in found]
            values += drawn
            marker = "." if len(points) < _ENOUGH else ""
            axes.plot(steps, drawn, color=colour, marker=marker, linewidth=1.6, label=name)
    axes.set_ylabel(panel.title)
    axes.set_ylim(*_limits(panel, values))
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#E6E8EB")
    axes.set_axisbelow(True)
    axes.legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncols=5, frameon=False, fontsize=9)


def _limits(panel: CurvePanel, values: Sequence[float]) -> tuple[float | None, float | None]:
    """Ends of the axis: 0 to 1 for shares, and none so far away that it squashes the rest."""
    if panel.share:
        return -0.03, 1.03
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
    span = max(high - low, 1e-9 * max(abs(middle), 1))
    bottom = float(low - span) if min(values) < low - 2 * span else None
    return bottom, float(high + span) if max(values) > high + 2 * span else None
