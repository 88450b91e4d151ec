"""Pictures of a study: returns along the trials, what mattered, and the Pareto front."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from spikedeploy.reports.plots import BLUE, VERMILION
from spikedeploy.tuning.outcomes import TrialOutcome, best
from spikedeploy.tuning.plan import TuningPlan

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GREY = "#8A939E"
_MOST = 16  # bars


def history_figure(plan: TuningPlan, found: Sequence[TrialOutcome]) -> "Figure":
    """Return of each trial, and the best so far."""
    figure, axes = _figure()
    ended = [each for each in found if each.earned is not None]
    for within, colour, label in (
        (True, BLUE, "return"),
        (False, _GREY, f"more than {plan.sops:g} SOPs"),
    ):
        some = [each for each in ended if each.within is within]
        if some:
            axes.plot([e.number for e in some], [e.earned for e in some], "o", color=colour,
                      markersize=4, label=label)  # fmt: skip
    inside = [(each.number, each.earned) for each in ended if each.within]
    if inside:
        numbers, earned = zip(*inside, strict=True)
        so_far = np.maximum.accumulate(np.asarray(earned, np.float64))
        axes.step(numbers, so_far, where="post", color=VERMILION, label="best so far")
    axes.set_xlabel("trial")
    axes.set_ylabel("return")
    if ended:
        axes.legend(frameon=False)
    return figure


def importances_figure(shares: Mapping[str, Mapping[str, float]]) -> "Figure":
    """Share of each setting in the differences, a group of bars for each objective."""
    names = sorted({name for each in shares.values() for name in each}, key=lambda name: max(
        each.get(name, 0.0) for each in shares.values()
    ))[-_MOST:]  # fmt: skip
    figure, axes = _figure(0.35 * len(names) + 1.2)
    height = 0.8 / max(len(shares), 1)
    for place, ((label, each), colour) in enumerate(
        zip(shares.items(), (BLUE, VERMILION), strict=False)
    ):
        rows = np.arange(len(names)) + place * height
        axes.barh(rows, [each.get(n, 0.0) for n in names], height, color=colour, label=label)
    axes.set_yticks(np.arange(len(names)) + (len(shares) - 1) * height / 2, names)
    axes.set_xlabel("importance (PED-ANOVA)")
    if len(shares) > 1:
        axes.legend(frameon=False)
    return figure


def front_figure(plan: TuningPlan, found: Sequence[TrialOutcome]) -> "Figure":
    """Return against SOPs: the front as a line among all trials."""
    figure, axes = _figure()
    ended = [each for each in found if each.earned is not None and each.sops is not None]
    axes.plot([e.sops for e in ended], [e.earned for e in ended], "o", color=_GREY, markersize=4)
    front = best(plan, found)
    axes.plot([e.sops for e in front], [e.earned for e in front], "o-", color=VERMILION,
              label="Pareto front" if plan.two else "best")  # fmt: skip
    if plan.sops:
        axes.axvline(plan.sops, color=_GREY, linestyle="--", linewidth=0.8, label="budget")
    axes.set_xlabel("SOPs a control step")
    axes.set_ylabel("return")
    axes.legend(frameon=False)
    return figure


def _figure(height: float = 3.6) -> "tuple[Figure, Any]":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, height), layout="constrained")
    return figure, figure.subplots()
