"""Return in % of the teacher against operations, a panel a task."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from lab.experiments.gymnasium.design import DENSE, MLP, SPARSE, TEACHER, TUNED
from lab.experiments.gymnasium.points import TaskPoint, reference
from lab.experiments.gymnasium.tables import ENOUGH, FEW, LABELS
from lab.experiments.gymnasium.tasks import TASKS
from spikedeploy.reports.plots import BLUE, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito 2008; markers differ too
_LOOKS = {
    TEACHER: ("#000000", "^"),
    DENSE: ("#8A939E", "s"),
    SPARSE: ("#E69F00", "v"),
    TUNED: (VERMILION, "o"),
    MLP: (BLUE, "D"),
}
_GREY = "#8A939E"
_LOWEST = -5.0  # [%]
_HIGHEST = 108  # at least: markers at 100 are whole


def tasks_figure(found: Mapping[str, Sequence[TaskPoint]], chip: str) -> "Figure":
    """The points of each task."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 3.4), layout="constrained")
    panels = figure.subplots(1, len(TASKS), sharey=True)
    for axes, env in zip(panels, TASKS, strict=True):
        _panel(axes, env, found.get(env, ()), chip)
    handles = [
        panels[0].plot([], [], marker, color=colour, label=LABELS[role])[0]
        for role, (colour, marker) in _LOOKS.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    figure.supxlabel("operations a control step: SOPs, or MACs")
    panels[0].set_ylabel("% of the teacher's return")
    return figure


def _panel(axes: "Axes", env: str, found: Sequence[TaskPoint], chip: str) -> None:
    axes.set_title(env, fontsize=9)
    limit = FEW * reference(env, found, chip).operations
    axes.axvline(limit, color=_GREY, linewidth=0.8, linestyle="--")
    axes.axhline(100 * ENOUGH, color=_GREY, linewidth=0.8, linestyle=":")
    for point in found:
        operations = point.mean("operations")
        if point.role in _LOOKS and operations and _drawn(point, chip):
            colour, marker = _LOOKS[point.role]
            estimate = point.of_teacher
            low, high = (100 * abs(end - estimate.mean) for end in estimate.ci95)
            axes.errorbar(
                [operations], [100 * estimate.mean], [[low], [high]], fmt=marker, color=colour,
                markersize=5, linewidth=1.2, capsize=2,
            )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xlim(10, 1e6)
    axes.set_ylim(_LOWEST, max(axes.get_ylim()[1], _HIGHEST))
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#E6E8EB")
    axes.set_axisbelow(True)


def _drawn(point: TaskPoint, chip: str) -> bool:
    """Whether a point is drawn: spiking policies on the chip, float ones where they are."""
    return point.place == chip or point.role in (TEACHER, MLP)
