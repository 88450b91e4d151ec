"""The trials of a study that are missing, each in a process of its own, some at a time."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from spikedeploy.files import locked
from spikedeploy.jobs.resumable import Job, JobEnd, run
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.tuning.outcomes import TrialOutcome, best, outcomes
from spikedeploy.tuning.page import write_page
from spikedeploy.tuning.plan import TuningPlan
from spikedeploy.tuning.study import journal, opened
from spikedeploy.tuning.trial import JOB, PLACE, REASON, RUN, counts, place, reason

if TYPE_CHECKING:
    import optuna

_HOPELESS = 3  # failed trials without another, after which the rest will fail too
_AGAIN = "again"  # of a study: numbers of interrupted trials that wait to be made again


@dataclass(frozen=True)
class TuningOutcome:
    """What came of a search.

    trials       of the study so far
    best         the best one, or the Pareto front
    interrupted  whether it was stopped from outside
    files        page and pictures
    """

    trials: list[TrialOutcome]
    best: list[TrialOutcome]
    interrupted: bool
    files: list[Path]


def tune(
    plan: TuningPlan,
    folder: Path,
    trials: int,
    jobs: int = 1,
    storage: str | None = None,
    say: Callable[[str], object] = lambda line: None,
) -> TuningOutcome:
    """Run trials until the study has so many, and write its page.

    folder   of the trials' runs, the page and, without a storage, the study
    storage  URL of a database, for several machines
    say      is called with a line on each trial that ended
    """
    where = storage or journal(folder)
    _ = plan.space  # what cannot be searched is refused before anything is made
    busy = (
        f"another `spikedeploy tune` is at work in {folder}: wait for it, or name another "
        "--folder; --jobs takes more processes"
    )
    with locked(folder / ".lock", busy):
        study = opened(plan, where)
        _again(study, folder)
        done = sum(counts(study, trial) for trial in study.trials)
        first = len(study.trials)
        todo = [_job(plan, where, folder, first + k, trials) for k in range(trials - done)]
        ended = _Ended(plan, study, folder, say)
        whole = run(todo, jobs, ended)
        _again(study, folder)
        files = write_page(plan, study, folder)
    found = outcomes(plan, study)
    return TuningOutcome(found, best(plan, found), not whole, files)


def _job(plan: TuningPlan, storage: str, folder: Path, number: int, trials: int) -> Job:
    name = f"job-{number}"
    arguments = {
        "plan": plan.as_json(),
        "storage": storage,
        "folder": str(folder),
        "name": name,
        "trials": trials,
    }
    return Job(name, "spikedeploy.tuning.trial:perform", folder / "logs" / f"{name}.log", arguments)


class _Ended:
    """Writes down how a job ended, and the page."""

    def __init__(
        self, plan: TuningPlan, study: "optuna.Study", folder: Path, say: Callable[[str], object]
    ) -> None:
        self._plan, self._study, self._folder, self._say = plan, study, folder, say
        self._failed = 0

    def __call__(self, end: JobEnd) -> None:
        """Note why a process died; give up where all trials fail."""
        if end.failed:
            _note_death(self._study, end)
        found = outcomes(self._plan, self._study)
        self._say(_line(self._study, found, end))
        write_page(self._plan, self._study, self._folder)
        self._failed = self._failed + 1 if end.failed else -_HOPELESS
        if self._failed == _HOPELESS and not any(each.earned is not None for each in found):
            raise ConfigError(f"the first {_HOPELESS} trials failed: {end.last_line}")


def _note_death(study: "optuna.Study", end: JobEnd) -> None:
    """Tell the study of a trial that it never ended, whose process was killed."""
    from optuna.trial import TrialState

    for trial in study.trials:
        if trial.user_attrs.get(JOB) == end.job.name and trial.state.name == "RUNNING":
            why = f"its process ended with status {end.status}: {end.last_line}"
            study.set_user_attr(f"{REASON} {trial.number}", why)
            study.tell(trial.number, state=TrialState.FAIL)


def _line(study: "optuna.Study", found: list[TrialOutcome], end: JobEnd) -> str:
    mine = [t.number for t in study.trials if t.user_attrs.get(JOB) == end.job.name]
    told = next((each for each in reversed(found) if each.number in mine), None)
    if told is None:
        return end.line
    earned = "" if told.earned is None else f", return {told.earned:,.4g}"
    sops = "" if told.sops is None else f", {told.sops:,.1f} SOPs"
    why = f": {told.reason}" if told.reason else ""
    return f"trial {told.number} {told.state}{earned}{sops}, {end.seconds / 60:.1f} min{why}"


def _again(study: "optuna.Study", folder: Path) -> None:
    """Put the trials of this place that were interrupted or lost in line, with their runs."""
    from optuna.trial import TrialState

    mine = [t for t in study.trials if t.user_attrs.get(PLACE) == place(folder)]
    for trial in mine:
        if trial.state.name == "RUNNING":  # nobody else works in this folder
            study.tell(trial.number, state=TrialState.FAIL)
    waiting = list(study.user_attrs.get(_AGAIN, []))
    for trial in mine:
        stopped = trial.state.name in ("RUNNING", "FAIL") and not reason(study, trial)
        if stopped and trial.number not in waiting:
            kept = {RUN: trial.user_attrs[RUN]} if RUN in trial.user_attrs else {}
            study.enqueue_trial(trial.params, user_attrs=kept)
            waiting.append(trial.number)
    study.set_user_attr(_AGAIN, waiting)
