"""The results of a study: its trials, the best of them, and the page tune.md with pictures."""

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spikedeploy.campaign.tune_plan import FIRST_SEED, TuningPlan
from spikedeploy.outputs import has_text
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.plots import BLUE, VERMILION, save
from spikedeploy.reports.table import ABSENT, Table

if TYPE_CHECKING:
    import optuna
    from matplotlib.figure import Figure

PAGE, SHOWN = "tune.md", "tune.html"
RUN, REASON, RETURN, SOPS = "run", "reason", "return", "sops"  # attributes of a trial
_STATES = {"COMPLETE": "complete", "PRUNED": "pruned", "RUNNING": "running", "FAIL": "failed"}
_ORDER = ("complete", "pruned", "running", "failed", "interrupted")
_ENOUGH = 4  # trials, below which nothing can be said of importance
_MOST_BARS = 16
_GREY = "#8A939E"


@dataclass(frozen=True)
class TrialOutcome:
    """A trial.

    number    in the study
    state     "complete", "pruned", "running", "failed" or "interrupted"
    settings  that were tried, as `--set` takes them
    earned    mean return of the exported policy; None where it did not come to that
    sops      its SOPs a control step; None of a float policy
    within    whether it is within the budget of SOPs, if there is one
    seconds   that it took; None while it runs
    run       folder of its training
    reason    why it failed
    """

    number: int
    state: str
    settings: dict[str, Any]
    earned: float | None
    sops: float | None
    within: bool
    seconds: float | None
    run: str
    reason: str

    @property
    def line(self) -> str:
        """`trial 3 complete, return 812.3, 95.2 SOPs`; with the reason where it failed."""
        earned = "" if self.earned is None else f", return {self.earned:,.4g}"
        sops = "" if self.sops is None else f", {self.sops:,.1f} SOPs"
        why = f" ({self.reason})" if self.reason else ""
        return f"trial {self.number} {self.state}{why}{earned}{sops}"


def outcomes(plan: TuningPlan, study: "optuna.Study") -> list[TrialOutcome]:
    """Every trial that was begun, in order."""
    return [_outcome(plan, study, t) for t in study.trials if t.state.name in _STATES]


def _outcome(
    plan: TuningPlan, study: "optuna.Study", trial: "optuna.trial.FrozenTrial"
) -> TrialOutcome:
    why, noted = failure_of(study, trial), trial.user_attrs
    state = _STATES[trial.state.name]
    sops = noted.get(SOPS)
    return TrialOutcome(
        number=trial.number,
        state="interrupted" if state == "failed" and not why else state,
        settings=dict(trial.params),
        earned=noted.get(RETURN),
        sops=sops,
        within=not plan.sops or (sops is not None and sops <= plan.sops),
        seconds=trial.duration.total_seconds() if trial.duration else None,
        run=str(noted.get(RUN, "")),
        reason=why,
    )


def best(plan: TuningPlan, found: Sequence[TrialOutcome]) -> list[TrialOutcome]:
    """The best trial; with two objectives the Pareto front, the cheapest first; or none yet."""
    ended = [each for each in found if each.state == "complete" and each.within]
    worth = {each.number: (each.earned or 0.0, -(each.sops or 0.0)) for each in ended}
    if not plan.has_two:
        return sorted(ended, key=lambda each: worth[each.number][0], reverse=True)[:1]
    front = [
        each
        for each in ended
        if not any(
            other != worth[each.number] and np.all(np.greater_equal(other, worth[each.number]))
            for other in worth.values()
        )
    ]
    return sorted(front, key=lambda each: (each.sops or 0.0, each.number))


def failure_of(study: "optuna.Study", trial: "optuna.trial.FrozenTrial") -> str:
    """The reason why a trial failed; empty where it did not, or was interrupted."""
    # of a process that died, the parent wrote it into the study
    written = study.user_attrs.get(f"{REASON} {trial.number}", "")
    return str(trial.user_attrs.get(REASON, written))


def is_study(folder: Path) -> bool:
    """True where a search has a journal of Optuna in the folder, or a page of one in a database."""
    journal = folder / "journal.log"
    if journal.is_file():
        with journal.open("rb") as file:
            return file.read(12) == b'{"op_code": '
    return not journal.exists() and has_text(folder / PAGE, "These seeds chose the settings")


def write_page(plan: TuningPlan, study: "optuna.Study", folder: Path) -> list[Path]:
    """Write page and pictures of what is known so far; their paths, the page first."""
    found = outcomes(plan, study)
    drawn = {"history.png": history_figure(plan, found)}
    if shares := importances(plan, study):
        drawn["importances.png"] = importances_figure(shares)
    if plan.counts_sops and any(each.sops is not None for each in found):
        drawn["front.png"] = front_figure(plan, found)
    pictures = [save(figure, folder / name) for name, figure in drawn.items()]
    page, shown = write_beside(folder / PAGE, _text(plan, found, pictures), drawn)
    return [page, *pictures, shown]


def importances(plan: TuningPlan, study: "optuna.Study") -> dict[str, Mapping[str, float]]:
    """Objective -> setting -> share of the differences (Watanabe et al. 2023); or none yet."""
    from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances

    ended = [each for each in study.trials if each.state.name == "COMPLETE"]
    names = ("return", "SOPs") if plan.has_two else ("return",)
    found: dict[str, Mapping[str, float]] = {}
    for place, name in enumerate(names if len(ended) >= _ENOUGH else ()):
        if len({each.values[place] for each in ended}) < 2:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # settings of one value have none
            found[name] = get_param_importances(
                study,
                evaluator=PedAnovaImportanceEvaluator(),
                target=lambda trial, place=place: trial.values[place],  # type: ignore[misc]
            )
    return found


def _text(plan: TuningPlan, found: Sequence[TrialOutcome], pictures: Sequence[Path]) -> str:
    counts = Counter(each.state for each in found)
    states = ", ".join(f"{counts[each]} {each}" for each in _ORDER if counts[each])
    objective = {
        "return": "the return",
        "return-at-sops": f"the return within {plan.sops:g} SOPs a control step",
        "return,sops": "the return, and few SOPs a control step",
    }[plan.objective]
    where = f" in {plan.env}" if plan.env else ""
    place = f"`{plan.chip}`" if plan.chip else "the chip that it is trained for, or the default"
    parts = [
        f"# Settings of {plan.recipe}{where}",
        f"Objective: {objective}. {len(found)} trials: {states or 'none'}.",
        f"Returns are means over {plan.episodes} episodes of the exported policy, from seed "
        f"{FIRST_SEED:,}; a spiking one runs on {place}. These seeds chose the settings: "
        "judge them by `spikedeploy compare`, whose seeds nothing here has seen.",
    ]
    for each in (chosen := best(plan, found)):
        sops = "" if each.sops is None else f", {each.sops:,.1f} SOPs a control step"
        parts.append(f"Trial {each.number}, return {_cell(each.earned)}{sops}:")
        parts.append(f"    {plan.command(each.settings)}")
    if not chosen:
        parts.append("No trial is complete" + (" within the budget." if plan.sops else "."))
    parts += [f"![{path.stem}]({path.name})" for path in pictures]
    return "\n\n".join([*parts, _table(plan, found).markdown()]) + "\n"


def _table(plan: TuningPlan, found: Sequence[TrialOutcome]) -> Table:
    rows = [
        [t.number, t.state, t.earned, t.sops, t.seconds, *map(t.settings.get, plan.space), t.reason]
        for t in found
    ]
    heads = ["trial", "", "return", "SOPs", "s", *plan.space, "why"]
    return Table(heads, [[*map(_cell, row)] for row in rows], numbers=True)


def _cell(value: object) -> str:
    if value is None:
        return ABSENT
    return f"{value:,.4g}" if isinstance(value, float) else str(value).replace("|", "\\|")


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
    ))[-_MOST_BARS:]  # fmt: skip
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
              label="Pareto front" if plan.has_two else "best")  # fmt: skip
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
