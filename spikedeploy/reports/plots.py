"""Figures of comparisons and training runs as PNG; no display is needed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.comparison.summary import few
from spikedeploy.files import replacing
from spikedeploy.reports.columns import Row, interval, label
from spikedeploy.reports.curves import Curve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# those of page.css by day; blue and vermilion of Okabe and Ito 2008
BLUE, _PURPLE, VERMILION, _GREY = "#0072B2", "#94469B", "#D55E00", "#7B848E"
_MARKERS = "osD^vP"


def _colour(row: Row) -> str:
    """The colour of a row: float ANN, float SNN, SNN on a chip, or any other kind."""
    if row["kind"] == "snn":
        return _PURPLE if row["chip"] == "float" else VERMILION
    return BLUE if row["kind"] == "ann" else _GREY


def draw_returns(rows: Sequence[Row], path: Path) -> Path:
    """Write `returns_figure`; return the path."""
    return save(returns_figure(rows), path)


def returns_figure(rows: Sequence[Row]) -> "Figure":
    """Returns as dots, their mean with any 95 % interval as a bar, one line for each row."""
    figure, axes = _figure(len(rows))
    for place, row in enumerate(rows):
        paint = _colour(row)
        returns = np.asarray(row["returns"], np.float64)
        axes.scatter(returns, _spread(returns, place), s=15, color=paint, alpha=0.45, linewidths=0)
        if not few(row):
            axes.plot(row["return_ci95"], [place + 0.12] * 2, color=paint, linewidth=5)
        axes.plot(row["return_mean"], place + 0.12, "|", color=paint, markersize=16, mew=2)
        axes.annotate(
            interval(row).partition(" ")[0],
            (1.01, place),
            xycoords=("axes fraction", "data"),
            va="center",
            color="#333333",
        )
    means = "mean (lines)" if all(map(few, rows)) else "mean and 95% interval (bars)"
    axes.set_xlabel(f"return of an episode (dots), {means}")
    _limit_returns(axes, rows)
    _name_rows(axes, rows)
    return figure


def _limit_returns(axes: "Axes", rows: Sequence[Row]) -> None:
    """Show the trained policies in full; a row that lies far below them is an arrow at the edge."""
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


def draw_energy(rows: Sequence[Row], path: Path) -> Path:
    """Write `energy_figure`; return the path."""
    return save(energy_figure(rows), path)


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
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=len(tables), frameon=False)
    _name_rows(axes, rows)
    return figure


def draw_curves(curves: Sequence[Curve], path: Path, remark: str = "") -> Path:
    """Return against steps, a line for each run; the remark is in the file's metadata."""
    from matplotlib.ticker import EngFormatter, MaxNLocator

    figure, axes = _figure(7)
    axes.grid(axis="y", color="#E6E8EB")
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


def save(figure: "Figure", path: Path, remark: str = "") -> Path:
    """Write the figure atomically; return the path."""
    said = {"Comment": remark} if remark else None
    with replacing(path) as part:
        figure.savefig(
            part, dpi=150, format="png", bbox_inches="tight", facecolor="white", metadata=said
        )
    return path


def _figure(lines: int) -> "tuple[Figure, Axes]":
    """Axes for that many lines of text, with a light frame."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 1.2 + 0.42 * lines))
    axes = figure.add_subplot()
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.grid(axis="x", color="#E6E8EB")
    axes.set_axisbelow(True)
    return figure, axes


def _name_rows(axes: "Axes", rows: Sequence[Row]) -> None:
    """Label the lines from top to bottom."""
    names = [plain(label(row)) for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.tick_params(length=0)


def plain(name: str) -> str:
    """A name in which no dollar sign begins a formula."""
    return name.replace("$", r"\$")


def _spread(values: NDArray[np.float64], place: int) -> NDArray[np.float64]:
    """Random heights above a bar, so that equal values stay visible; reproducible."""
    return place - np.random.default_rng(0).uniform(0.08, 0.34, size=len(values))
