"""One trial of a study: settings are drawn, a policy is trained and evaluated, in one process."""

import platform
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.train import train
from spikedeploy.tuning.evaluation import evaluated
from spikedeploy.tuning.plan import TuningPlan
from spikedeploy.tuning.study import opened
from spikedeploy.tuning.validations import Validations
from spikedeploy.user_errors import one_line

if TYPE_CHECKING:
    import optuna

# what a trial says of itself: its job, where it runs, its folder, why it failed
JOB, PLACE, RUN, REASON = "job", "place", "run", "reason"
RETURN, SOPS = "return", "sops"


def perform(plan: dict[str, Any], storage: str, folder: str, name: str, trials: int) -> bool:
    """Run one more trial (a job of `spikedeploy.jobs.resumable`); False if it was interrupted.

    name    of the job
    trials  of the study in all; where as many ended or run, nothing is done
    """
    asked = TuningPlan(**plan)
    study = opened(asked, storage, number=int(name.rpartition("-")[2]))
    if sum(counts(study, trial) for trial in study.trials) >= trials:
        return True
    trial = study.ask()
    trial.set_user_attr(JOB, name)
    trial.set_user_attr(PLACE, place(Path(folder)))
    return _Attempt(asked, study, trial, Path(folder)).made()


def place(folder: Path) -> str:
    """The machine and the folder of a trial."""
    return f"{platform.node()}:{folder.resolve()}"


def reason(study: "optuna.Study", trial: "optuna.trial.FrozenTrial") -> str:
    """Why a trial failed; empty where it did not, or was interrupted."""
    # of a process that died, whoever saw it wrote it down
    written = study.user_attrs.get(f"{REASON} {trial.number}", "")
    return str(trial.user_attrs.get(REASON, written))


def counts(study: "optuna.Study", trial: "optuna.trial.FrozenTrial") -> bool:
    """Whether it is one of the trials asked for: it runs or has ended, and was not interrupted."""
    state = trial.state.name
    return state in ("RUNNING", "COMPLETE", "PRUNED") or bool(reason(study, trial))


class _Attempt:
    """A trial with its study and folder."""

    def __init__(
        self, plan: TuningPlan, study: "optuna.Study", trial: "optuna.Trial", folder: Path
    ) -> None:
        self._plan, self._study, self._trial = plan, study, trial
        self._values = {key: each.suggested(trial, key) for key, each in plan.space.items()}
        before = trial.user_attrs.get(RUN)
        self._folder = Path(before) if before else folder / f"trial-{trial.number}"
        self._known = before is not None
        trial.set_user_attr(RUN, str(self._folder))
        self._stop = Validations(trial, self._folder, prunes=not plan.two)

    def made(self) -> bool:
        """Train and evaluate; whether it ended, well or badly."""
        try:
            run = self._trained()
            if self._stop.pruned:
                return self._ended("PRUNED")
            if self._stop.share is not None:
                return self._interrupted()
            return self._told(*evaluated(run, self._plan))
        except KeyboardInterrupt:
            return self._interrupted()
        except Exception as error:  # the study goes on
            self._trial.set_user_attr(REASON, one_line(error) or f"{type(error).__name__}: {error}")
            self._ended("FAIL")
            raise

    def _trained(self) -> Path:
        """The run, resumed where the trial was interrupted before."""
        if not self._known and self._folder.exists() and any(self._folder.iterdir()):
            raise ConfigError(
                f"{self._folder} exists, and this search does not know it: it is of another one. "
                "Name another --folder, or move it away."
            )
        found = next((file.parent for file in self._folder.glob("*/config.json")), None)
        return train(
            self._plan.recipe,
            env=self._plan.env or None,
            overrides=self._plan.overrides(self._values),
            seed=self._plan.seed,
            resume=found,
            runs=self._folder,
            quiet=True,
            interrupt=self._stop,
        )

    def _told(self, earned: float, sops: float | None) -> bool:
        if self._plan.counts and sops is None:
            raise ConfigError("the policy has no SOPs on this chip")
        self._trial.set_user_attr(RETURN, earned)
        self._trial.set_user_attr(SOPS, sops)
        if self._plan.sops and sops is not None:
            # how far above the budget, as a share of it; feasible at 0 and below
            self._trial.set_constraint(SOPS, sops / self._plan.sops - 1)
        values = [earned, sops] if self._plan.two else [earned]
        self._study.tell(self._trial, values)  # type: ignore[arg-type]
        return True

    def _ended(self, state: str) -> bool:
        from optuna.trial import TrialState

        self._study.tell(self._trial, state=TrialState[state])
        return True

    def _interrupted(self) -> bool:
        self._ended("FAIL")  # without a reason: it will be asked for again
        return False
