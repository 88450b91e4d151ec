"""`tune`: a search for the settings of a recipe with Optuna, many trainings (docs/sweeps.md).

Each trial is a job: a policy is trained with settings that the study draws, exported, and evaluated
on seeds that are for choosing. They are neither those of its own validation, on which its best
checkpoint was chosen, nor those of `compare`, by which tuned settings are to be judged.

<folder>/
    journal.log    the study
    trial-<n>/     the run of each trial, and its log
    report.html, report.json
"""

import shlex
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from spikedeploy.campaign.search_space import search_space
from spikedeploy.comparison.episodes import EpisodeJob, play
from spikedeploy.comparison.evaluation import make_entries
from spikedeploy.evaluation_setup import Setup
from spikedeploy.jobs import JobResult, Pool, output_to, sigterm_as_interrupt
from spikedeploy.policies.registry import DEFAULT_CHIP, find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import locked
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.trainers import metrics_file
from spikedeploy.trainers.config import RunConfig, require_known, resolve, spiking_layers
from spikedeploy.trainers.progress import Interrupt
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.run_folder import RunFolder, runs_in
from spikedeploy.trainers.train import algorithm, train
from spikedeploy.user_errors import one_line

if TYPE_CHECKING:
    import optuna
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial

Objective = Literal["return", "return,sops"]
FIRST_SEED = 9_000  # of evaluations: validation of trainings begins below, `compare` above
_MOST_EPISODES = 1_000  # seeds from there up to those of evaluation
_STARTS = 10  # trials at random before the search begins
_UNPRUNED = 5  # trials that run to their end before others are compared with them
_HOPELESS = 3  # failed trials without another, after which the rest will fail too
_PLAN, _RETURN, _SOPS, _REASON = "plan", "return", "sops", "reason"  # of a study; of its trials


@dataclass(frozen=True)
class TuningPlan:
    """The question of a study.

    recipe: of trainers.recipes
    env: of a recipe for any environment; "" else
    objective: what is best: the return, or return and SOPs
    search: texts of --search; none takes the default of the recipe
    fixed: texts of --set
    seed: of all trainings
    episodes: of each evaluation
    chip: on which a spiking policy is evaluated; "float" for its float twin; "" for that which it
        is trained for, else the default
    """

    recipe: str
    env: str = ""
    objective: Objective = "return"
    search: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    seed: int = 0
    episodes: int = 20
    chip: str = ""

    def __post_init__(self) -> None:
        entry = RECIPES[require_known(self.recipe, RECIPES, "recipe")]
        if entry.any_env != bool(self.env):
            raise ConfigError(
                f"{self.recipe} trains in any environment: name one with --env, as CartPole-v1"
                if entry.any_env
                else f"{self.recipe} has an environment of its own: leave --env out"
            )
        policy = self.config.policy  # one of events has SOPs without hidden neurons too
        spikes = spiking_layers(policy) or policy.kind.startswith("delta-")
        if self.objective != "return" and not spikes:
            raise ConfigError(
                f"{self.recipe} trains a float policy, which has no SOPs: --objective return"
            )
        if self.episodes > _MOST_EPISODES:
            raise ConfigError(f"--episodes {self.episodes}: there are seeds for {_MOST_EPISODES}")

    @property
    def has_two(self) -> bool:
        """True where there are two objectives."""
        return self.objective == "return,sops"

    @cached_property
    def config(self) -> RunConfig:
        """The recipe with the fixed settings."""
        kind = algorithm(RECIPES[self.recipe].algorithm)
        config: RunConfig = resolve(kind.Config, self.recipe, overrides=self.fixed, seed=self.seed)
        return config

    @cached_property
    def space(self) -> "dict[str, BaseDistribution]":
        """Setting -> the distribution from which it is drawn."""
        return {**search_space(self.config, self.search, self.fixed)}

    def overrides(self, values: Mapping[str, Any]) -> list[str]:
        """Return the settings of a trial as `--set` takes them, those that are fixed first."""
        return [*self.fixed, *(f"{key}={value}" for key, value in values.items())]

    def command(self, values: Mapping[str, Any]) -> str:
        """Return the command line that trains with these settings."""
        what = [self.env, "--recipe", self.recipe] if self.env else [self.recipe]
        words = ["spikedeploy", "train", *what]
        for text in self.overrides(values):
            words += ["--set", text]
        if self.seed:
            words += ["--seed", str(self.seed)]
        return shlex.join(words)

    def as_json(self) -> dict[str, Any]:
        """Return the fields as plain data."""
        return {**asdict(self), "search": list(self.search), "fixed": list(self.fixed)}


# the study


def tune(
    plan: TuningPlan,
    folder: Path,
    trials: int,
    jobs: int = 1,
    say: Callable[[str], object] = lambda line: None,
) -> "tuple[optuna.Study, bool]":
    """Run trials until the study has so many; return it, and whether it came to its end.

    folder: of the study and the trials' runs
    jobs: trials at a time, each in a process
    say: is called with a line on each trial that ended
    """
    _import_optuna()
    _ = plan.space  # what cannot be searched is refused before anything is made
    busy = f"another `spikedeploy tune` is at work in {folder}: wait for it, or name another"
    with locked(folder / ".lock", busy):
        study = open_study(plan, folder)
        begun: list[TrialJob] = []

        def todo() -> "Iterator[TrialJob]":
            """Yield interrupted trials, then new ones: each is drawn when there is a place."""
            for trial in study.trials:
                if trial.state.name == "RUNNING":  # nobody else works in this folder
                    begun.append(TrialJob(plan, folder, trial.number))
                    yield begun[-1]
            while (number := len(study.trials)) < trials:
                if (runs := folder / f"trial-{number}").exists():
                    raise ConfigError(f"{runs} is of another search: name another --folder")
                begun.append(TrialJob(plan, folder, study.ask(plan.space).number))
                yield begun[-1]

        try:
            with sigterm_as_interrupt(), Pool(jobs) as pool:
                for result in pool.run(run_trial, todo()):
                    say(_tell(study, begun[result.index], result))
                    _check_hopeless(study)
        except KeyboardInterrupt:
            return study, False
    return study, True


def _tell(study: "optuna.Study", job: "TrialJob", result: JobResult) -> str:
    """Write into the study how a trial ended; return a line that says it."""
    from optuna.trial import TrialState

    trial, plan, end = job.trial(study), job.plan, result.value
    if result.error is not None:
        why = one_line(result.error) or f"{type(result.error).__name__}: {result.error}"
        trial.set_user_attr(_REASON, why)
        study.tell(job.number, state=TrialState.FAIL)
    elif end == TrialState.PRUNED:
        study.tell(job.number, state=TrialState.PRUNED)
    elif end is not None:  # else it was interrupted, and goes on the next time
        earned, sops = end
        trial.set_user_attr(_RETURN, earned)
        trial.set_user_attr(_SOPS, sops)
        study.tell(job.number, [earned, sops] if plan.has_two else earned)
    done = describe(study.trials[job.number])
    facts = {"return": done["return"], "SOPs": done["sops"], "reason": done["reason"] or None}
    told = [f"{name} {value}" for name, value in facts.items() if value is not None]
    return ", ".join([f"trial {job.number} {done['state']}", *told])


def _check_hopeless(study: "optuna.Study") -> None:
    states = [trial.state.name for trial in study.trials]
    if states.count("FAIL") == _HOPELESS and not {"COMPLETE", "PRUNED"} & {*states}:
        raise ConfigError(
            f"the first {_HOPELESS} trials failed: {describe(study.trials[0])['reason']}"
        )


def describe(trial: "FrozenTrial") -> dict[str, Any]:
    """Return a trial as plain data."""
    state = trial.state.name.lower().replace("fail", "failed").replace("running", "interrupted")
    return {
        "number": trial.number,
        "state": state,
        "settings": dict(trial.params),
        "return": trial.user_attrs.get(_RETURN),
        "sops": trial.user_attrs.get(_SOPS),
        "seconds": trial.duration.total_seconds() if trial.duration else None,
        "reason": trial.user_attrs.get(_REASON, ""),
    }


def best(plan: TuningPlan, study: "optuna.Study") -> "Sequence[FrozenTrial]":
    """Return the best trial; with two objectives the Pareto front, the cheapest first; or none."""
    if plan.has_two:
        return sorted(study.best_trials, key=lambda trial: (trial.values[1], trial.number))
    try:
        return [study.best_trial]
    except ValueError:  # none is complete
        return []


def open_study(plan: TuningPlan, folder: Path) -> "optuna.Study":
    """Return the study of the plan, made where there is none.

    TPE (Bergstra et al. 2011) samples, which also serves two objectives.
    """
    library = _import_optuna()
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    file = folder / "journal.log"
    folder.mkdir(parents=True, exist_ok=True)
    try:
        study: optuna.Study = library.create_study(
            storage=JournalStorage(JournalFileBackend(str(file))),
            study_name="tune",
            load_if_exists=True,
            pruner=library.pruners.MedianPruner(n_startup_trials=_UNPRUNED),
            directions=["maximize", "minimize"] if plan.has_two else ["maximize"],
        )
    except ValueError as error:  # a line that is no JSON, or other directions
        raise ConfigError(
            f"{file} is damaged, or of another search ({error}): name another --folder"
        ) from error
    # a search that goes on draws other numbers than it began with
    seed = 100_003 * plan.seed + len(study.trials)
    study.sampler = library.samplers.TPESampler(
        seed=seed, n_startup_trials=_STARTS, constant_liar=True
    )
    wanted, found = plan.as_json(), study.user_attrs.get(_PLAN)
    if found is None:
        study.set_user_attr(_PLAN, wanted)
    elif found != wanted:
        differ = [key for key in wanted if found.get(key) != wanted[key]]
        words = "; ".join(f"{key} was {found.get(key)!r}, is {wanted[key]!r}" for key in differ)
        raise ConfigError(
            f"{file} holds a study with another plan ({words}). Ask the same to go on, or name "
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


# a trial, in a process of its own


@dataclass(frozen=True)
class TrialJob:
    """A trial of a study, to be run or to go on."""

    plan: TuningPlan
    folder: Path
    number: int

    def trial(self, study: "optuna.Study") -> "optuna.Trial":
        """Return the trial, which any process may report to."""
        from optuna.trial import Trial

        return Trial(study, study.trials[self.number]._trial_id)


class _Pruner(Interrupt):
    """A request to stop, of a signal, or of a study that gives a trial up.

    pruned: whether it was given up
    """

    def __init__(self, trial: "optuna.Trial", prunes: bool) -> None:
        super().__init__()
        self._trial, self._prunes, self.pruned = trial, prunes, False

    def __call__(self) -> bool:
        """Return whether the training is to stop."""
        return self.pruned or super().__call__()

    def report(self, run: Path) -> None:
        """Report the latest validation of a run to the study."""
        metrics = metrics_file.read_metrics(run / "metrics.csv")
        rows = [row for row in metrics if "eval_return" in row]
        if rows and self._prunes:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of a step that it was told before
                self._trial.report(rows[-1]["eval_return"], int(next(iter(rows[-1].values()))))
            self.pruned = self.pruned or self._trial.should_prune()


def run_trial(job: TrialJob) -> Any:  # noqa: ANN401 - (return, SOPs), TrialState.PRUNED, or None
    """Train and evaluate the settings of a trial; PRUNED if given up, None if interrupted."""
    from optuna.trial import TrialState

    plan, runs = job.plan, job.folder / f"trial-{job.number}"
    trial = job.trial(open_study(plan, job.folder))
    stop = _Pruner(trial, prunes=not plan.has_two)
    with output_to(runs / "log.txt"):
        run = train(
            plan.recipe,
            env=plan.env or None,
            overrides=plan.overrides(trial.params),
            seed=plan.seed,
            resume=next(iter(runs_in(runs)), None),
            runs=runs,
            quiet=True,
            interrupt=stop,
            watch=stop.report,
        )
        if stop.pruned:
            return TrialState.PRUNED
        return evaluate(run, plan) if stop.share is None else None


def evaluate(run: Path, plan: TuningPlan) -> tuple[float, float | None]:
    """Return the mean return of the exported policy, and its SOPs; None of a float one."""
    env = RunFolder(run).settings()["env"]
    policy = find(runnable(str(run)))
    setup = Setup.with_options(env["options"])
    entry = make_entries(policy, plan.chip or policy.chip or DEFAULT_CHIP, setup)[-1]
    played = [play(EpisodeJob(env["name"], entry, FIRST_SEED + k)) for k in range(plan.episodes)]
    sops: list[Any] = [episode.costs.sops for episode in played]
    known = None if None in sops else float(np.mean(sops))
    if known is None and plan.objective != "return":
        raise ConfigError("the policy has no SOPs on this chip")
    return float(np.mean([episode.total for episode in played])), known
