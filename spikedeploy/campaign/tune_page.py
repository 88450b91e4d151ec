"""The page of a search, tune.md: its best settings, all trials, pictures."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from spikedeploy.campaign.tune import FIRST_SEED, TuningPlan, best, describe
from spikedeploy.outputs import has_text
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.plots import BLUE, VERMILION, framed_figure, save
from spikedeploy.reports.table import ABSENT, Table

if TYPE_CHECKING:
    import optuna
    from matplotlib.figure import Figure

PAGE, SHOWN = "tune.md", "tune.html"
_SEEDS = "These seeds chose the settings"


def is_study(folder: Path) -> bool:
    """Return True where a search has a journal of Optuna in the folder, or its page."""
    journal = folder / "journal.log"
    if journal.is_file():
        with journal.open("rb") as file:
            return file.read(11) == b'{"op_code":'
    return not journal.exists() and has_text(folder / PAGE, _SEEDS)


def write_page(plan: TuningPlan, study: "optuna.Study", folder: Path) -> list[Path]:
    """Write page and pictures of what is known so far; return their paths, the page first."""
    figures = {"history.png": history_figure(study)}
    if any(trial.user_attrs.get("sops") is not None for trial in study.trials):
        figures["front.png"] = front_figure(plan, study)
    pictures = [save(figure, folder / name) for name, figure in figures.items()]
    text = "\n\n".join([*_paragraphs(plan, study, figures), _table(plan, study).markdown()])
    page, shown = write_beside(folder / PAGE, text + "\n", figures)
    return [page, *pictures, shown]


def _paragraphs(
    plan: TuningPlan, study: "optuna.Study", figures: "Mapping[str, Figure]"
) -> Iterator[str]:
    counts = Counter(describe(trial)["state"] for trial in study.trials)
    states = ", ".join(f"{count} {state}" for state, count in counts.items())
    objective = {
        "return": "the return",
        "return,sops": "the return, and few SOPs a control step",
    }[plan.objective]
    yield f"# Settings of {plan.recipe}" + (f" in {plan.env}" if plan.env else "")
    yield f"Objective: {objective}. {len(study.trials)} trials: {states or 'none'}."
    chip = f"`{plan.chip}`" if plan.chip else "the chip that it is trained for, or the default"
    yield (
        f"Returns are means over {plan.episodes} episodes of the exported policy, from seed "
        f"{FIRST_SEED:,}; a spiking one runs on {chip}. {_SEEDS}: judge them by `spikedeploy "
        "compare`, whose seeds nothing here has seen."
    )
    chosen = best(plan, study)
    for trial in chosen:
        found = describe(trial)
        sops = "" if found["sops"] is None else f", {found['sops']:,.1f} SOPs a control step"
        yield f"Trial {trial.number}, return {_cell(found['return'])}{sops}:"
        yield f"    {plan.command(trial.params)}"
    if not chosen:
        yield "No trial is complete."
    yield from (f"![{Path(name).stem}]({name})" for name in figures)


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
    return f"{value:,.4g}" if isinstance(value, float) else str(value).replace("|", "\\|")


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
