"""The page of a study, tune.md and tune.html: the best settings, pictures and all trials."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from spikedeploy.outputs import marked
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.plots import save
from spikedeploy.tuning.evaluation import FIRST_SEED
from spikedeploy.tuning.outcomes import TrialOutcome, best, outcomes
from spikedeploy.tuning.plan import TuningPlan
from spikedeploy.tuning.plots import front_figure, history_figure, importances_figure

if TYPE_CHECKING:
    import optuna

PAGE, SHOWN = "tune.md", "tune.html"
_ENOUGH = 4  # trials, below which nothing can be said of importance
_DASH = "–"


def is_study(folder: Path) -> bool:
    """Whether a search has a journal of Optuna in the folder, or a page of one in a database."""
    journal = folder / "journal.log"
    if journal.is_file():
        with journal.open("rb") as file:
            return file.read(12) == b'{"op_code": '
    return not journal.exists() and marked(folder / PAGE, "These seeds chose the settings")


def write_page(plan: TuningPlan, study: "optuna.Study", folder: Path) -> list[Path]:
    """Write page and pictures of what is known so far; their paths, the page first."""
    found = outcomes(plan, study)
    drawn = {"history.png": history_figure(plan, found)}
    if shares := importances(plan, study):
        drawn["importances.png"] = importances_figure(shares)
    if plan.counts and any(each.sops is not None for each in found):
        drawn["front.png"] = front_figure(plan, found)
    pictures = [save(figure, folder / name) for name, figure in drawn.items()]
    text = "\n".join([*_head(plan, found), *_shown(pictures), *_table(plan, found)])
    page, shown = write_beside(folder / PAGE, text + "\n", drawn)
    return [page, *pictures, shown]


def importances(plan: TuningPlan, study: "optuna.Study") -> dict[str, Mapping[str, float]]:
    """Objective -> setting -> share of the differences (Watanabe et al. 2023); or none yet."""
    from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances

    ended = [each for each in study.trials if each.state.name == "COMPLETE"]
    names = ("return", "SOPs") if plan.two else ("return",)
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


def _head(plan: TuningPlan, found: Sequence[TrialOutcome]) -> list[str]:
    told = ", ".join(
        f"{count} {state}"
        for state in ("complete", "pruned", "running", "failed", "interrupted")
        if (count := sum(each.state == state for each in found))
    )
    where = f" in {plan.env}" if plan.env else ""
    lines = [
        f"# Settings of {plan.recipe}{where}",
        "",
        f"Objective: {_objective(plan)}. {len(found)} trials: {told or 'none'}.",
        "",
        f"Returns are means over {plan.episodes} episodes of the exported policy, from seed "
        f"{FIRST_SEED:,}; a spiking one runs on `{plan.chip}`. These seeds chose the settings: "
        "judge them by `spikedeploy compare`, whose seeds nothing here has seen.",
        "",
    ]
    chosen = best(plan, found)
    if not chosen:
        return [*lines, "No trial is complete" + (" within the budget." if plan.sops else "."), ""]
    for each in chosen:
        lines += [f"Trial {each.number}, {_numbers(each)}:", ""]
        lines += [f"    {plan.command(each.settings)}", ""]
    return lines


def _objective(plan: TuningPlan) -> str:
    if plan.two:
        return "the return, and few SOPs a control step"
    return f"the return within {plan.sops:g} SOPs a control step" if plan.sops else "the return"


def _numbers(trial: TrialOutcome) -> str:
    sops = "" if trial.sops is None else f", {trial.sops:,.1f} SOPs a control step"
    return f"return {_cell(trial.earned)}{sops}"


def _shown(pictures: Sequence[Path]) -> list[str]:
    return [line for path in pictures for line in (f"![{path.stem}]({path.name})", "")]


def _table(plan: TuningPlan, found: Sequence[TrialOutcome]) -> list[str]:
    keys = list(plan.space)
    lines = ["| trial | | return | SOPs | s | " + " | ".join(keys) + " | why |"]
    lines.append("|--:|---|--:|--:|--:|" + "---|" * len(keys) + "---|")
    for each in found:
        cells = [str(each.number), each.state, _cell(each.earned), _cell(each.sops)]
        cells += [_cell(each.seconds), *(_cell(each.settings.get(key)) for key in keys)]
        lines.append("| " + " | ".join([*cells, each.reason.replace("|", "\\|")]) + " |")
    return lines


def _cell(value: object) -> str:
    if value is None:
        return _DASH
    return f"{value:,.4g}" if isinstance(value, float) else str(value).replace("|", "\\|")
