"""`tune`: a search for the settings of a recipe with Optuna, many trainings (docs/tuning.md).

`tune` starts the trials that are missing, some at a time; each is a process that calls
`run_trial`: settings are drawn, a policy is trained, exported and evaluated on seeds that are for
choosing. They are neither those of its own validation, on which its best checkpoint was chosen, nor
those of `compare`, by which tuned settings are to be judged.
"""

import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spikedeploy.campaign.tune_plan import FIRST_SEED, TuningPlan
from spikedeploy.campaign.tune_results import (
    REASON,
    RETURN,
    RUN,
    SOPS,
    TrialOutcome,
    best,
    failure_of,
    outcomes,
    write_page,
)
from spikedeploy.comparison.episodes import EpisodeJob, play
from spikedeploy.comparison.lineup import make_entries
from spikedeploy.jobs.resumable import Job, JobEnd, run
from spikedeploy.policies.registry import DEFAULT_CHIP, find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import locked
from spikedeploy.setup import Setup
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.trainers import metrics_file
from spikedeploy.trainers.progress import Interrupt
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.train import train
from spikedeploy.user_errors import one_line

if TYPE_CHECKING:
    import optuna

_JOB, _PLACE = "job", "place"  # attributes of a trial: its job; its machine and folder
_PLAN, _QUEUED = "plan", "again"  # of a study: numbers of interrupted trials that are queued again
_STARTS = 10  # trials at random before the search begins
_UNPRUNED = 5  # trials that run to their end before others are compared with them
_HOPELESS = 3  # failed trials without another, after which the rest will fail too
_MOST_EPISODES = 1_000  # seeds from FIRST_SEED up to those of evaluation


@dataclass(frozen=True)
class TuningOutcome:
    """The result of a search.

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
    _import_optuna()
    _ = plan.space  # what cannot be searched is refused before anything is made
    busy = (
        f"another `spikedeploy tune` is at work in {folder}: wait for it, or name another "
        "--folder; --jobs takes more processes"
    )
    with locked(folder / ".lock", busy):
        study = open_study(plan, where)
        _requeue(study, folder)
        missing = trials - sum(_counts(study, trial) for trial in study.trials)
        first = len(study.trials)
        todo = [_job(plan, where, folder, first + k, trials) for k in range(missing)]
        finished = run(todo, jobs, _Progress(plan, study, folder, say))
        _requeue(study, folder)
        files = write_page(plan, study, folder)
    found = outcomes(plan, study)
    return TuningOutcome(found, best(plan, found), not finished, files)


def _job(plan: TuningPlan, storage: str, folder: Path, number: int, trials: int) -> Job:
    name = f"job-{number}"
    arguments = {
        "plan": plan.as_json(),
        "storage": storage,
        "folder": str(folder),
        "name": name,
        "trials": trials,
    }
    return Job(name, f"{__name__}:run_trial", folder / "logs" / f"{name}.log", arguments)


class _Progress:
    def __init__(
        self, plan: TuningPlan, study: "optuna.Study", folder: Path, say: Callable[[str], object]
    ) -> None:
        self._plan, self._study, self._folder, self._say = plan, study, folder, say
        self._failed = 0

    def __call__(self, end: JobEnd) -> None:
        """Write down how a job ended, and the page; give up where all trials fail."""
        from optuna.trial import TrialState

        mine = [t for t in self._study.trials if t.user_attrs.get(_JOB) == end.job.name]
        for trial in mine:
            if end.failed and trial.state.name == "RUNNING":  # its process was killed
                why = f"its process ended with status {end.status}: {end.last_line}"
                self._study.set_user_attr(f"{REASON} {trial.number}", why)
                self._study.tell(trial.number, state=TrialState.FAIL)
        found = outcomes(self._plan, self._study)
        numbers = [trial.number for trial in mine]
        told = next((each for each in reversed(found) if each.number in numbers), None)
        self._say(end.line if told is None else f"{told.line}, {end.seconds / 60:.1f} min")
        write_page(self._plan, self._study, self._folder)
        self._failed = self._failed + 1 if end.failed else -_HOPELESS
        if self._failed == _HOPELESS and not any(each.earned is not None for each in found):
            raise ConfigError(f"the first {_HOPELESS} trials failed: {end.last_line}")


def _requeue(study: "optuna.Study", folder: Path) -> None:
    """Queue the trials of this place again that were interrupted or lost, with their runs."""
    from optuna.trial import TrialState

    mine = [t for t in study.trials if t.user_attrs.get(_PLACE) == _place(folder)]
    for trial in mine:
        if trial.state.name == "RUNNING":  # nobody else works in this folder
            study.tell(trial.number, state=TrialState.FAIL)
    queued = list(study.user_attrs.get(_QUEUED, []))
    for trial in mine:
        stopped = trial.state.name in ("RUNNING", "FAIL") and not failure_of(study, trial)
        if stopped and trial.number not in queued:
            kept = {RUN: trial.user_attrs[RUN]} if RUN in trial.user_attrs else {}
            study.enqueue_trial(trial.params, user_attrs=kept)
            queued.append(trial.number)
    study.set_user_attr(_QUEUED, queued)


def _counts(study: "optuna.Study", trial: "optuna.trial.FrozenTrial") -> bool:
    """True where it is one of the trials asked for: it runs or has ended by itself."""
    done = trial.state.name in ("RUNNING", "COMPLETE", "PRUNED")
    return done or bool(failure_of(study, trial))


def _place(folder: Path) -> str:
    return f"{platform.node()}:{folder.resolve()}"


# The study: Optuna's record, in a journal file that processes share or a database of a cluster.


def journal(folder: Path) -> str:
    """The storage of a folder, as --storage takes it."""
    return str(folder / "journal.log")


def open_study(plan: TuningPlan, storage: str, number: int = 0) -> "optuna.Study":
    """The study of the plan, made where there is none.

    TPE (Bergstra et al. 2011) samples, which also serves two objectives, and budgets as
    constraints.

    storage  path of a journal file, or URL of a database
    number   of the process, so that no two draw the same first settings
    """
    library = _import_optuna()
    seed = 100_003 * plan.seed + number
    study: optuna.Study = library.create_study(
        storage=_storage(storage),
        study_name=plan.name,
        load_if_exists=True,
        sampler=library.samplers.TPESampler(
            seed=seed, n_startup_trials=_STARTS, constant_liar=True
        ),
        pruner=library.pruners.MedianPruner(n_startup_trials=_UNPRUNED),
        directions=["maximize", "minimize"] if plan.has_two else ["maximize"],
    )
    wanted, found = plan.as_json(), study.user_attrs.get(_PLAN)
    if found is None:
        study.set_user_attr(_PLAN, wanted)
    elif found != wanted:
        differ = [key for key in wanted if found.get(key) != wanted[key]]
        words = "; ".join(f"{key} was {found.get(key)!r}, is {wanted[key]!r}" for key in differ)
        raise ConfigError(
            f"{storage} holds a study with another plan ({words}). Ask the same to go on, or name "
            "another --folder."
        )
    return study


def _import_optuna() -> Any:  # noqa: ANN401 - the module
    try:
        import optuna
    except ImportError as error:
        raise ConfigError('tune needs Optuna: pip install "spikedeploy[tune]"') from error
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


def _storage(storage: str) -> Any:  # noqa: ANN401 - a class of Optuna's
    from optuna.exceptions import StorageInternalError
    from optuna.storages import JournalStorage, RDBStorage
    from optuna.storages.journal import JournalFileBackend

    if "://" not in storage:
        Path(storage).parent.mkdir(parents=True, exist_ok=True)
        try:
            return JournalStorage(JournalFileBackend(storage))
        except ValueError as error:  # a line that is no JSON
            raise ConfigError(
                f"{storage} is damaged, or no journal of a search ({error}): cut off the line that "
                "is torn, or name another --folder"
            ) from error
    from sqlalchemy.exc import SQLAlchemyError

    try:
        return RDBStorage(storage)
    except (SQLAlchemyError, StorageInternalError, ImportError, ValueError) as error:
        why = str(error).splitlines()[0]
        raise ConfigError(
            f"--storage {storage}: no database can be opened there ({why}). Give an SQLAlchemy "
            "URL, as postgresql://user@host/name, and install its driver; or leave --storage out."
        ) from error


# A trial, in a process of its own.


def run_trial(plan: dict[str, Any], storage: str, folder: str, name: str, trials: int) -> bool:
    """Run one more trial (a job of `spikedeploy.jobs.resumable`); False if it was interrupted.

    name    of the job
    trials  of the study in all; where as many ended or run, nothing is done
    """
    from optuna.trial import TrialState

    asked = TuningPlan(**plan)
    study = open_study(asked, storage, number=int(name.rpartition("-")[2]))
    if sum(_counts(study, trial) for trial in study.trials) >= trials:
        return True
    trial = study.ask(dict(asked.space))
    trial.set_user_attr(_JOB, name)
    trial.set_user_attr(_PLACE, _place(Path(folder)))
    before = trial.user_attrs.get(RUN)
    runs = Path(before) if before else Path(folder) / f"trial-{trial.number}"
    trial.set_user_attr(RUN, str(runs))
    stop = Validations(trial, runs, prunes=not asked.has_two)
    values, state = None, TrialState.FAIL  # without a reason: it will be queued again
    try:
        if before is None and runs.exists() and any(runs.iterdir()):
            raise ConfigError(
                f"{runs} exists, and this search does not know it: it is of another one. Name "
                "another --folder, or move it away."
            )
        run = _train(asked, trial.params, runs, stop)
        if stop.pruned:
            state = TrialState.PRUNED
        elif stop.share is None:
            values, state = _values(asked, trial, *evaluate(run, asked)), TrialState.COMPLETE
    except KeyboardInterrupt:
        pass
    except Exception as error:  # the study goes on
        trial.set_user_attr(REASON, one_line(error) or f"{type(error).__name__}: {error}")
        raise
    finally:
        study.tell(trial, values, state)
    return state != TrialState.FAIL


def _train(plan: TuningPlan, values: Mapping[str, Any], runs: Path, stop: Interrupt) -> Path:
    return train(
        plan.recipe,
        env=plan.env or None,
        overrides=plan.overrides(values),
        seed=plan.seed,
        resume=next((file.parent for file in runs.glob("*/config.json")), None),
        runs=runs,
        quiet=True,
        interrupt=stop,
    )


def _values(
    plan: TuningPlan, trial: "optuna.Trial", earned: float, sops: float | None
) -> list[float]:
    trial.set_user_attr(RETURN, earned)
    trial.set_user_attr(SOPS, sops)
    if not plan.counts_sops:
        return [earned]
    if sops is None:
        raise ConfigError("the policy has no SOPs on this chip")
    if plan.sops:
        # how far above the budget, as a share of it; feasible at 0 and below
        trial.set_constraint(SOPS, sops / plan.sops - 1)
    return [earned, sops] if plan.has_two else [earned]


class Validations(Interrupt):
    """The request to stop of a training: of Ctrl-C, or of the pruner, who gets its validations.

    pruned: whether it was the pruner's.
    """

    def __init__(self, trial: "optuna.Trial", folder: Path, prunes: bool) -> None:
        super().__init__()
        self._trial, self._folder, self._prunes = trial, folder, prunes
        self._size, self._reported = -1, -1.0
        self.pruned = False

    def __call__(self) -> bool:
        """True where the training is to stop; called after each iteration."""
        if self._prunes and not self.pruned:
            self.pruned = self._is_hopeless()
        return self.pruned or super().__call__()

    def _is_hopeless(self) -> bool:
        """Report what is new in the run's metrics; return whether the trial is given up."""
        file = next(iter(self._folder.glob("*/metrics.csv")), None)
        if file is None or (size := file.stat().st_size) == self._size:
            return False
        self._size = size
        for row in metrics_file.read(file):
            step = next(iter(row.values()))
            if "eval_return" in row and step > self._reported:
                self._reported = step
                self._trial.report(row["eval_return"], int(step))
        return self._reported >= 0 and self._trial.should_prune()


def evaluate(run: Path, plan: TuningPlan) -> tuple[float, float | None]:
    """Mean return of the exported policy, and its SOPs a control step; None of a float one."""
    if plan.episodes > _MOST_EPISODES:
        raise ConfigError(f"--episodes {plan.episodes}: there are seeds for {_MOST_EPISODES}")
    env = RunFolder(run).settings()["env"]
    policy = find(runnable(str(run)))
    setup = Setup.with_options(env["options"])
    entry = make_entries(policy, plan.chip or policy.chip or DEFAULT_CHIP, setup)[-1]
    played = [play(EpisodeJob(env["name"], entry, FIRST_SEED + k)) for k in range(plan.episodes)]
    sops: list[Any] = [episode.costs.sops for episode in played]
    known = None if None in sops else float(np.mean(sops))
    return float(np.mean([episode.total for episode in played])), known
