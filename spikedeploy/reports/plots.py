"""Figures of comparisons, trainings and drifts, as PNG files and as SVG for pages.

No display is needed.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from spikedeploy.reports.columns import format_return, has_few_episodes, label
from spikedeploy.reports.table import Row
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import replacing
from spikedeploy.trainers.metrics_file import read_metrics

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# blue and vermilion of Okabe and Ito 2008; all are colours of page.css by day
BLUE, _PURPLE, VERMILION, _GREY = "#0072B2", "#94469B", "#D55E00", "#7B848E"
_LIGHT_GREY, _ORANGE, _GREEN, _GRID = "#8A939E", "#E69F00", "#009E73", "#E6E8EB"
_MARKERS = "osD^vP"  # of energy tables
_MOST = 500  # points of a line
_ENOUGH = 80  # points, above which they are not marked
_SVG_WIDTH = re.compile(r'viewBox="0 0 ([\d.]+) ')  # [pt]
# colours of the plots -> those of page.css
_CSS_COLOURS = {
    "#0072b2": "var(--ann)",
    "#94469b": "var(--snn)",
    "#e69f00": "var(--snn)",
    "#d55e00": "var(--chip)",
    "#7b848e": "var(--control)",
    "#8a939e": "var(--control)",
    "#009e73": "var(--green)",
    "#cc79a7": "var(--pink)",
    "#56b4e9": "var(--sky)",
    "#f0e442": "var(--yellow)",
    "#e6e8eb": "var(--line)",
    "#000000": "var(--ink)",
    "#222222": "var(--ink)",
    "#333333": "var(--ink)",
    "#555555": "var(--soft)",
}


# comparisons


def _colour(row: Row) -> str:
    if row["kind"] == "snn":
        return _PURPLE if row["chip"] == "float" else VERMILION
    return BLUE if row["kind"] == "ann" else _GREY


def returns_figure(rows: Sequence[Row]) -> "Figure":
    """Returns as dots, their mean with any 95 % interval as a bar, one line for each row."""
    figure, axes = _figure(len(rows))
    for place, row in enumerate(rows):
        colour = _colour(row)
        returns = np.asarray(row["returns"], np.float64)
        axes.scatter(returns, _spread(returns, place), s=15, color=colour, alpha=0.45, linewidths=0)
        if not has_few_episodes(row):
            axes.plot(row["return_ci95"], [place + 0.12] * 2, color=colour, linewidth=5)
        axes.plot(row["return_mean"], place + 0.12, "|", color=colour, markersize=16, mew=2)
        axes.annotate(
            format_return(row).partition(" ")[0],
            (1.01, place),
            xycoords=("axes fraction", "data"),
            va="center",
            color="#333333",
        )
    means = "mean (lines)" if all(map(has_few_episodes, rows)) else "mean and 95% interval (bars)"
    axes.set_xlabel(f"return of an episode (dots), {means}")
    _limit_returns(axes, rows)
    _name_rows(axes, rows)
    return figure


def _limit_returns(axes: "Axes", rows: Sequence[Row]) -> None:
    trained = [r for row in rows if row["kind"] in ("ann", "snn") for r in row["returns"]]
    if not trained:
        return
    low, high = float(np.quantile(trained, 0.02)), float(np.max(trained))
    low -= max(1.5 * (high - low), 0.1 * abs(high))
    if min(min(row["returns"]) for row in rows) >= low:
        return
    axes.set_xlim(left=low)
    for place, row in enumerate(rows):
        if row["return_mean"] < low:
            inside = axes.get_yaxis_transform()  # x as a share of the axis, clear of the names
            axes.plot(0.015, place, "<", color=_colour(row), markersize=9, transform=inside)


def energy_figure(rows: Sequence[Row]) -> "Figure":
    """Joules per inference on a log axis, a marker for each energy table."""
    from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

    rows = [row for row in rows if row["energy_per_inference_j"]]
    tables = list(dict.fromkeys(name for row in rows for name in row["energy_per_inference_j"]))
    figure, axes = _figure(len(rows))
    for marker, table in zip(_MARKERS, tables, strict=False):
        places = [i for i, row in enumerate(rows) if table in row["energy_per_inference_j"]]
        joules = [rows[i]["energy_per_inference_j"][table] for i in places]
        axes.scatter(
            joules, places, s=60, marker=marker, c=[_colour(rows[i]) for i in places], zorder=3
        )
        axes.scatter([], [], s=60, marker=marker, color="#555555", label=table)
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    subs = (1.0,) if high > 100 * low else (1.0, 2.0, 5.0)  # else there is a label or none
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_major_formatter(EngFormatter(unit="J"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("energy per inference, estimated from published tables")
    axes.legend(**LEGEND_ABOVE, ncols=len(tables))
    _name_rows(axes, rows)
    return figure


# trainings


@dataclass(frozen=True)
class Curve:
    """The returns of one run over its training.

    name: name of the run
    unit: unit of its steps: "environment steps" or "updates"
    signal: "validation" or "training"
    steps: (n,) [unit]
    returns: (n,)
    """

    name: str
    unit: str
    signal: str
    steps: tuple[float, ...]
    returns: tuple[float, ...]


def read_curve(metrics: Path, name: str) -> Curve:
    """The learning curve in a run's metrics.csv, whose first column counts its steps."""
    rows = read_metrics(metrics)
    for column, signal in (("eval_return", "validation"), ("episode_return", "training")):
        if points := _points(rows, column):
            steps, returns = zip(*points, strict=True)
            return Curve(name, step_unit(rows), signal, steps, returns)
    raise ConfigError(f"{metrics} has no returns yet: train on")


def step_unit(rows: Sequence[Mapping[str, float]]) -> str:
    """The unit of the first column of metrics, in words."""
    first = next(iter(rows[0])) if rows else "steps"
    return first.replace("env_", "environment ").replace("_", " ")


def draw_curves(curves: Sequence[Curve], path: Path, remark: str = "") -> Path:
    """Return against steps, a line for each run; the remark is in the file's metadata."""
    from matplotlib.ticker import EngFormatter, MaxNLocator

    figure, axes = _figure(7)
    axes.grid(axis="y", color=_GRID)
    for curve in curves:
        axes.plot(curve.steps, curve.returns, linewidth=1.8, label=curve.name)
    axes.set_xlabel(" or ".join(dict.fromkeys(curve.unit for curve in curves)))
    signals = " or ".join(dict.fromkeys(curve.signal for curve in curves))
    axes.set_ylabel(f"return of an episode, {signals}")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], integer=True))
    axes.legend(frameon=False)
    return save(figure, path, remark)


def raster_figure(spikes: Mapping[str, NDArray[Any]]) -> "Figure":
    """Spikes (T, *N) of each node, a panel for each: a dot for each neuron and timestep."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 0.6 + 1.6 * max(len(spikes), 1)), layout="constrained")
    for place, (name, rows) in enumerate(spikes.items(), 1):
        flat = rows.reshape(len(rows), -1)
        axes = figure.add_subplot(max(len(spikes), 1), 1, place)
        timesteps, neurons = np.nonzero(flat)
        axes.scatter(timesteps, neurons, s=2, color=BLUE, linewidths=0)
        axes.set(xlim=(-0.5, len(flat) - 0.5), ylim=(-0.5, flat.shape[1] - 0.5), ylabel=name)
        axes.set_title(f"{np.count_nonzero(flat):,} spikes", loc="right", fontsize=9)
        axes.spines[["top", "right"]].set_visible(False)
    if spikes:
        axes.set_xlabel("timestep")
    return figure


class _Panel(NamedTuple):
    title: str  # of the axis
    lines: Mapping[str, tuple[str, str]]  # column of the metrics -> name and colour
    is_share: bool = False  # from 0 to 1
    is_inverted: bool = False  # 1 - value is drawn


_LAYERS = (VERMILION, BLUE, _GREEN, _ORANGE, _LIGHT_GREY)
_PANELS = (
    _Panel(
        "return of an episode",
        {"episode_return": ("training", _LIGHT_GREY), "eval_return": ("validation", VERMILION)},
    ),
    _Panel(
        "validation episodes",
        {
            "eval_finish": ("succeed", _GREEN),
            "eval_crash": ("crash", VERMILION),
            "eval_falls": ("fall", _ORANGE),
        },
        is_share=True,
    ),
    _Panel(
        "spikes a neuron\nand timestep",
        {f"sparsity_lif{k}": (f"layer {k}", colour) for k, colour in enumerate(_LAYERS, start=1)},
        is_inverted=True,
    ),
    _Panel(
        "operations\na control step",
        {
            "operations": ("training", _LIGHT_GREY),
            "eval_operations": ("validation", VERMILION),
            "goal": ("goal of pruning", BLUE),
        },
    ),
)


def curves_figure(rows: Sequence[Mapping[str, float]]) -> "Figure | None":
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
    axes[-1].set_xlabel(step_unit(rows))
    axes[-1].xaxis.set_major_formatter(EngFormatter(sep=""))
    return figure


def _points(rows: Sequence[Mapping[str, float]], column: str) -> list[tuple[float, float]]:
    """(step, value) of a column."""
    steps = next(iter(rows[0])) if rows else ""
    return [
        (row[steps], row[column]) for row in rows if column in row and math.isfinite(row[column])
    ]


def _draw(axes: "Axes", panel: _Panel, rows: Sequence[Mapping[str, float]]) -> None:
    values: list[float] = []
    for column, (name, colour) in panel.lines.items():
        if points := _points(rows, column):
            points = points[:: max(1, -(-len(points) // _MOST))]
            steps, found = zip(*points, strict=True)
            drawn = [1 - value for value in found] if panel.is_inverted else found
            values += drawn
            marker = "." if len(points) < _ENOUGH else ""
            axes.plot(steps, drawn, color=colour, marker=marker, linewidth=1.6, label=name)
    axes.set_ylabel(panel.title)
    axes.set_ylim(*_limits(panel, values))
    _lighten(axes)
    axes.legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncols=5, frameon=False, fontsize=9)


def _limits(panel: _Panel, values: Sequence[float]) -> tuple[float | None, float | None]:
    if panel.is_share:
        return -0.03, 1.03
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
    span = max(high - low, 1e-9 * max(abs(middle), 1))
    bottom = float(low - span) if min(values) < low - 2 * span else None
    return bottom, float(high + span) if max(values) > high + 2 * span else None


# files


def save(figure: "Figure", path: Path, remark: str = "") -> Path:
    """Write the figure atomically; return the path."""
    metadata = {"Comment": remark} if remark else None
    with replacing(path) as part:
        figure.savefig(
            part, dpi=150, format="png", bbox_inches="tight", facecolor="white", metadata=metadata
        )
    return path


def svg(figure: "Figure", alt: str) -> Markup:
    """A figure as SVG in the colours of the page, light or dark, with its alternative text."""
    from matplotlib import rc_context

    text = StringIO()
    # text as text; ids that do not differ from call to call
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": alt}):
        figure.savefig(
            text, format="svg", bbox_inches="tight", transparent=True, metadata={"Date": None}
        )
    drawn = text.getvalue()
    drawn = drawn[drawn.index("<svg") :]
    for colour, name in _CSS_COLOURS.items():
        drawn = drawn.replace(colour, name)
    width = float(_SVG_WIDTH.search(drawn)[1])  # type: ignore[index]  # matplotlib writes it
    head = f'<svg role="img" aria-label="{escape(alt)}" style="--wide: {width:.0f}px"'
    return Markup(drawn.replace("<svg", head, 1))


LEGEND_ABOVE: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0, 1), "frameon": False}


def framed_figure(height: float) -> "tuple[Figure, Axes]":
    """Axes of that height [inches] with a light frame."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, height))
    axes = figure.add_subplot()
    _lighten(axes)
    return figure, axes


def _lighten(axes: "Axes") -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color=_GRID)
    axes.set_axisbelow(True)


def _figure(lines: int) -> "tuple[Figure, Axes]":
    """Axes for that many lines of text, with no line at the left."""
    figure, axes = framed_figure(1.2 + 0.42 * lines)
    axes.spines["left"].set_visible(False)
    axes.grid(False, axis="y")
    return figure, axes


def _name_rows(axes: "Axes", rows: Sequence[Row]) -> None:
    names = [without_formulas(label(row)) for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.tick_params(length=0)


def without_formulas(name: str) -> str:
    """A name in which no dollar sign begins a formula."""
    return name.replace("$", r"\$")


def _spread(values: NDArray[np.float64], place: int) -> NDArray[np.float64]:
    """Random heights above a bar, so that equal values stay visible; reproducible."""
    return place - np.random.default_rng(0).uniform(0.08, 0.34, size=len(values))
