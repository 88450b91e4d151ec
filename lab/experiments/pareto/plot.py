"""The front: return in % of the teacher against operations, and against energy.

Levels of imitation are joined by a line; a policy that was trained on with reward has a ring.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from lab.experiments.pareto.costs import INT8, total
from lab.experiments.pareto.design import LABELS, STUDENTS
from lab.experiments.pareto.fronts import Point, Record
from spikedeploy.reports.plots import BLUE, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# distinguishable with colour blindness (Okabe and Ito 2008); markers differ too
_COLOURS = dict(zip(STUDENTS, (VERMILION, "#E69F00", "#CC79A7", BLUE, "#009E73"), strict=True))
_MARKERS = dict(zip(STUDENTS, "osvD^", strict=True))
_LOWEST = 60.0  # [%]; what is below is not drawn

_RING: dict[str, Any] = {"markersize": 9, "markeredgecolor": "#222222", "markeredgewidth": 1.4}

_Cost = Callable[[Record], float]


def front_figure(env: str, found: Sequence[Point]) -> "Figure":
    """An environment's points."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _panel(left, found, lambda row: row["operations"])
    _panel(right, found, lambda row: 1e12 * total(row, INT8, "all"))
    left.set_xlabel("operations a control step: SOPs, or MACs with an input that is not 0")
    right.set_xlabel(f"energy a control step [pJ], {INT8}, with updates and encoder")
    left.set_ylabel("% of the teacher's finishes" if "kart" in env else "% of the teacher's return")
    artists, names = left.get_legend_handles_labels()
    figure.legend(artists, names, loc="outside upper center", ncols=len(names), frameon=False)
    return figure


def _panel(axes: "Axes", found: Sequence[Point], cost: _Cost) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for student in STUDENTS:
        of = [point for point in found if point.student == student]
        if imitated := [point for point in of if not point.rewarded]:
            _front(axes, imitated, cost, student)
        if rewarded := [point for point in of if point.rewarded]:
            _ringed(axes, rewarded, cost, student)
    if any(point.rewarded for point in found):
        axes.plot([], [], "o", label="with reward", **_RING, markerfacecolor="none")
    axes.axhline(100, color="#8A939E", linewidth=0.8, zorder=1)
    spent = [cost(row) for point in found for row in point.rows]
    axes.set_xscale("log")
    # scores of a teacher that scores nothing are not numbers, and would leave the axis empty
    least, most = max(min(spent, default=1.0), 1.0), max([*spent, 10.0])
    axes.set_xlim(0.8 * least, 1.25 * most)
    axes.xaxis.set_major_locator(LogLocator(subs=_ticks(most / least)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#E6E8EB", which="both")
    axes.set_axisbelow(True)
    lowest = min((100 * value for p in found for value in p.single), default=_LOWEST)
    axes.set_ylim(bottom=max(_LOWEST, lowest - 1) if lowest < 100 else 95)


def _ticks(span: float) -> tuple[float, ...]:
    """Multiples of powers of ten that are labelled on an axis whose ends have this ratio."""
    if span < 4:
        return (1, 1.25, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
    return (1, 1.5, 2, 3, 5, 7) if span < 20 else (1, 2, 5)


def _front(axes: "Axes", of: Sequence[Point], cost: _Cost, student: str) -> None:
    """A line through the means, and a thin marker for each training."""
    means, score = _means(of, cost)
    axes.plot(
        means, score, color=_COLOURS[student], marker=_MARKERS[student], linewidth=1.8,
        label=LABELS[student],
    )  # fmt: skip
    _each_training(axes, of, cost, student)


def _ringed(axes: "Axes", of: Sequence[Point], cost: _Cost, student: str) -> None:
    """The means with a ring, not joined, and a thin marker for each training."""
    means, score = _means(of, cost)
    axes.plot(means, score, _MARKERS[student], color=_COLOURS[student], zorder=3, **_RING)
    _each_training(axes, of, cost, student)


def _means(of: Sequence[Point], cost: _Cost) -> tuple[list[float], list[float]]:
    means = [sum(map(cost, point.rows)) / len(point.rows) for point in of]
    return means, [100 * point.of_teacher.mean for point in of]


def _each_training(axes: "Axes", of: Sequence[Point], cost: _Cost, student: str) -> None:
    for point in of:
        each = list(map(cost, point.rows))
        axes.plot(
            each, [100 * value for value in point.single], _MARKERS[student],
            color=_COLOURS[student], markerfacecolor="none", markersize=4, markeredgewidth=0.7,
            alpha=0.8,
        )  # fmt: skip
