"""The page of a search: its best settings, all trials, pictures."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from spikedeploy.campaign.tune import FIRST_SEED, TuningPlan, best, describe
from spikedeploy.reports.page import is_page_of, provenance, render
from spikedeploy.reports.plots import BLUE, VERMILION, framed_figure, svg
from spikedeploy.reports.table import ABSENT, Table

if TYPE_CHECKING:
    import optuna
    from matplotlib.figure import Figure


def is_study(folder: Path) -> bool:
    """Return True where a search has a journal of Optuna in the folder, or its page."""
    journal = folder / "journal.log"
    if journal.is_file():
        with journal.open("rb") as file:
            return file.read(11) == b'{"op_code":'
    return not journal.exists() and is_page_of("tune")(folder)


def study_page(plan: TuningPlan, study: "optuna.Study") -> str:
    """The page of what is known so far, as one file."""
    counts = Counter(describe(trial)["state"] for trial in study.trials)
    states = ", ".join(f"{count} {state}" for state, count in counts.items())
    wanted = "the return, and few SOPs a control step" if plan.has_two else "the return"
    chip = plan.chip or "the chip that it is trained for, or the default"
    drawings = [svg(history_figure(study), "Return of each trial, and the best so far")]
    if any(trial.user_attrs.get("sops") is not None for trial in study.trials):
        drawings.append(svg(front_figure(plan, study), "Return against operations of each trial"))
    commands = []
    for trial in best(plan, study):
        found = describe(trial)
        sops = "" if found["sops"] is None else f", {found['sops']:,.1f} SOPs a control step"
        words = f"Trial {trial.number}, return {_cell(found['return'])}{sops}:"
        commands.append((words, plan.command(trial.params)))
    return render(
        "campaign",
        title=f"Settings of {plan.recipe}" + (f" in {plan.env}" if plan.env else ""),
        lead=f"Objective: {wanted}. {len(study.trials)} trials: {states or 'none'}.",
        paragraphs=[
            f"Returns are means over {plan.episodes} episodes of the exported policy, from seed "
            f"{FIRST_SEED:,}; a spiking one runs on {chip}. These seeds chose the settings: judge "
            "them by spikedeploy compare, whose seeds nothing here has seen.",
            "" if commands else "No trial is complete.",
        ],
        commands=commands,
        drawings=drawings,
        tables=[_table(plan, study)],
        remarks=(),
        made=provenance(),
    )


def _table(plan: TuningPlan, study: "optuna.Study") -> Table:
    rows = []
    for trial in study.trials:
        found = describe(trial)
        measured = [found[name] for name in ("number", "state", "return", "sops", "seconds")]
        rows.append([*measured, *map(trial.params.get, plan.space), found["reason"]])
    heads = ["trial", "", "return", "SOPs", "s", *plan.space, "why"]
    return Table(heads, [[*map(_cell, row)] for row in rows], numbers=True)


def _cell(value: object) -> str:
    if value is None:
        return ABSENT
    if not isinstance(value, float):
        return str(value)
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def history_figure(study: "optuna.Study") -> "Figure":
    """Draw the return of each trial, and the best so far."""
    figure, axes = framed_figure(3.6)
    ended = [(t.number, t.values[0]) for t in study.trials if t.state.name == "COMPLETE"]
    if ended:
        numbers, earned = zip(*ended, strict=True)
        axes.plot(numbers, earned, "o", color=BLUE, markersize=4, label="return")
        so_far = np.maximum.accumulate(earned)
        axes.step(numbers, so_far, where="post", color=VERMILION, label="best so far")
        axes.legend(frameon=False)
    axes.locator_params(axis="x", integer=True)
    axes.set(xlabel="trial", ylabel="return")
    return figure


def front_figure(plan: TuningPlan, study: "optuna.Study") -> "Figure":
    """Draw return against SOPs: the best as a line among all trials."""
    figure, axes = framed_figure(3.6)
    for trials, style, color, label in (
        (study.trials, "o", BLUE, "trials"),
        (best(plan, study), "o-", VERMILION, "Pareto front" if plan.has_two else "best"),
    ):
        found = [d for d in map(describe, trials) if d["sops"] is not None]
        points = [d["sops"] for d in found], [d["return"] for d in found]
        axes.plot(*points, style, color=color, markersize=4, label=label)
    axes.set(xlabel="SOPs a control step", ylabel="return")
    axes.legend(frameon=False)
    return figure
