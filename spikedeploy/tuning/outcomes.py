"""The trials of a study as plain data; the best one, and the Pareto front."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from spikedeploy.tuning.plan import TuningPlan
from spikedeploy.tuning.trial import RETURN, RUN, SOPS, reason

if TYPE_CHECKING:
    import optuna

_STATES = {"COMPLETE": "complete", "PRUNED": "pruned", "RUNNING": "running", "FAIL": "failed"}


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


def outcomes(plan: TuningPlan, study: "optuna.Study") -> list[TrialOutcome]:
    """Every trial that was begun, in order."""
    return [_outcome(plan, study, t) for t in study.trials if t.state.name in _STATES]


def _outcome(
    plan: TuningPlan, study: "optuna.Study", trial: "optuna.trial.FrozenTrial"
) -> TrialOutcome:
    why, said = reason(study, trial), trial.user_attrs
    state = _STATES[trial.state.name]
    sops = said.get(SOPS)
    return TrialOutcome(
        number=trial.number,
        state="interrupted" if state == "failed" and not why else state,
        settings=dict(trial.params),
        earned=said.get(RETURN),
        sops=sops,
        within=not plan.sops or (sops is not None and sops <= plan.sops),
        seconds=trial.duration.total_seconds() if trial.duration else None,
        run=str(said.get(RUN, "")),
        reason=why,
    )


def best(plan: TuningPlan, found: Sequence[TrialOutcome]) -> list[TrialOutcome]:
    """The best trial; with two objectives the Pareto front, the cheapest first; or none yet."""
    ended = [each for each in found if each.state == "complete" and each.within]
    if not plan.two:
        return sorted(ended, key=_earned, reverse=True)[:1]
    front = [each for each in ended if not any(_dominates(other, each) for other in ended)]
    return sorted(front, key=lambda each: (each.sops or 0.0, each.number))


def _earned(trial: TrialOutcome) -> float:
    return -float("inf") if trial.earned is None else trial.earned


def _dominates(one: TrialOutcome, other: TrialOutcome) -> bool:
    """Whether one earns no less with no more operations, and differs."""
    mine, theirs = (_earned(one), -(one.sops or 0.0)), (_earned(other), -(other.sops or 0.0))
    return mine != theirs and mine[0] >= theirs[0] and mine[1] >= theirs[1]
