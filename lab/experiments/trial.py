"""One trial: a recipe trained with one seed, exported, and evaluated on seeds of its own.

All results of a trial are in its run folder, <folder>/<recipe>-s<seed>-<date>-<time>: the files of
the training, policy.onnx or policy.nir, and evaluation.json. A trial can be stopped at any time;
the next attempt does what is missing. A file lock keeps other processes out; the system releases it
when the process ends.
"""

import math
import re
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lab.experiments.evaluation import evaluate
from lab.experiments.finishes import Steps, finishes, steps_to_greedy
from spikedeploy.files import as_text, locked, read_json, write_text
from spikedeploy.policies.run_record import whole
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.trainers.config import amended, differences, resolve
from spikedeploy.trainers.ppo import PpoConfig
from spikedeploy.trainers.run_folder import RunFolder

_RESULTS = ("evaluation.json", "tracks.json", "policy.*")  # of a training that ended
_STAMP = r"\d{8}-\d{6}(-\d+)?"


@dataclass(frozen=True)
class Trial:
    """A training and its evaluation.

    recipe     of trainers.recipes, trained by PPO
    seed       of the training
    folder     of all trials of the experiment
    overrides  settings as `--set` takes them
    episodes   of the evaluation, greedy, from seed EVALUATION up
    chip       on which a spiking policy is evaluated, beside its float twin
    """

    recipe: str
    seed: int
    folder: str
    overrides: Sequence[str]
    episodes: int
    chip: str

    @property
    def name(self) -> str:
        """`kart-grid-snn-s0`."""
        return f"{self.recipe}-s{self.seed}"

    @property
    def run(self) -> Path | None:
        """The run folder; None before the first training."""
        pattern = re.compile(re.escape(self.name) + "-" + _STAMP)
        found = sorted(p.parent for p in Path(self.folder).glob(f"{self.name}-*/config.json"))
        return next((path for path in found if pattern.fullmatch(path.name)), None)

    @property
    def config(self) -> PpoConfig:
        """The configuration of the training."""
        if self.run is None:
            return resolve(PpoConfig, self.recipe, overrides=self.overrides, seed=self.seed)
        return amended(RunFolder(self.run).config(PpoConfig), overrides=self.overrides)

    @property
    def changed_settings(self) -> list[str]:
        """Settings of the training that differ from what the recipe says now."""
        if self.run is None:
            return []
        now = resolve(PpoConfig, self.recipe, overrides=self.overrides, seed=self.seed)
        expected = set(differences(now))
        return [setting for setting in differences(self.config) if setting not in expected]

    @property
    def counters(self) -> dict[str, Any]:
        """Counters of the last checkpoint: env_steps, finishes ...; empty without one."""
        file = self.run and self.run / "checkpoints" / "last.json"
        return read_json(file) if file and file.is_file() else {}

    @property
    def trained(self) -> bool:
        """Whether all limits of the training are reached, or the budget is spent."""
        counters, config = self.counters, self.config
        if not counters or self.run is None:
            return False
        with whole(self.run / "checkpoints" / "last.json"):
            enough = config.reached(counters["finishes"], counters.get("held", 0))
            return enough or bool(counters["env_steps"] >= config.steps)

    @property
    def finishes(self) -> Steps:
        """Environment steps at the end of each finished episode of training."""
        found = finishes(self._table("episodes.csv")) if self.run else finishes(Path())
        counted = self.counters.get("finishes", 0)
        if len(found) != counted and self.trained:
            raise ConfigError(
                f"{self.run}/episodes.csv is damaged: it has {len(found)} finishes of {counted}. "
                "Put it back, or train again."
            )
        return found

    def steps_to_greedy(self, share: float) -> float:
        """Environment steps until this share of greedy validation episodes finished, and held."""
        return steps_to_greedy(share, self._table("metrics.csv")) if self.run else math.inf

    def _table(self, name: str) -> Path:
        """A table of the run folder; ConfigError where a training that ended has lost it."""
        path = (self.run or Path()) / name
        if not path.is_file() and self.trained:
            raise ConfigError(f"{path} is missing: put it back, or train again")
        return path

    @property
    def evaluation(self) -> dict[str, Any] | None:
        """The evaluation; None where it is missing, or was made with other steps or episodes."""
        file = self.run and self.run / "evaluation.json"
        if not file or not file.is_file():
            return None
        found, of = read_json(file), (self.evaluated_with, self._identity)
        return found if self.trained and (found.get("of"), found.get("trial")) == of else None

    @property
    def _identity(self) -> dict[str, Any]:
        return {"recipe": self.recipe, "seed": self.seed}

    @property
    def evaluated_with(self) -> dict[str, Any]:
        """The steps, episodes and chip that an evaluation must have been made with."""
        steps = self.counters.get("env_steps")
        return {"env_steps": steps, "episodes": self.episodes, "chip": self.chip}

    @property
    def done(self) -> bool:
        """Whether nothing is missing."""
        return self.evaluation is not None

    def arguments(self) -> dict[str, Any]:
        """The fields as arguments of `perform`."""
        return {**asdict(self), "overrides": list(self.overrides)}


def perform(**arguments: Any) -> bool:  # noqa: ANN401
    """Complete the trial with these fields; False if the training was interrupted."""
    trial = Trial(**arguments)
    with locked(Path(trial.folder) / f".{trial.name}.lock"):
        if not trial.trained:
            _train(trial)
        if not trial.trained:
            return False
        if not trial.done:
            _evaluate(trial)
    return True


def resumable(run: Path | None) -> Path | None:
    """The run folder to resume; one that was killed before its first checkpoint is deleted.

    Raises ConfigError where it holds results, which are made after that checkpoint.
    """
    if run is None or any(run.glob("checkpoints/last.*")):
        return run
    if made := [path.name for name in _RESULTS for path in run.glob(name)]:
        raise ConfigError(
            f"{run / 'checkpoints' / 'last.json'} is missing, and {made[0]} is there: put it back, "
            "or move the folder away to train again"
        )
    if any(run.glob("checkpoints/*.safetensors")):
        return run  # resuming says whether that is of the beginning
    shutil.rmtree(run)
    return None


def _train(trial: Trial) -> None:
    """Start or resume the training."""
    from spikedeploy.trainers.train import train

    train(
        trial.recipe,
        overrides=trial.overrides,
        seed=trial.seed,
        resume=resumable(trial.run),
        runs=trial.folder,
        quiet=True,
    )


def _evaluate(trial: Trial) -> None:
    """Export the policy and evaluate it, a spiking one also on its chip."""
    from spikedeploy.shipping.export_run import export_run

    run, config = trial.run, trial.config
    if run is None:
        raise SpikedeployError(f"{trial.name}: its run folder is gone")
    to = "onnx" if config.policy.kind == "mlp" else "nir"
    exported = export_run(str(run), to)
    if failed := [check.name for check in exported.checks if not check.passed]:
        raise SpikedeployError(f"{exported.path} does not do what {run} does: {', '.join(failed)}")
    found = {
        "of": trial.evaluated_with,
        "trial": trial._identity,
        "parameters": _parameters(run),
        "rows": evaluate(
            config.env.name, config.env.options, str(exported.path), trial.episodes, trial.chip
        ),
    }
    write_text(run / "evaluation.json", as_text(found))


def _parameters(run: Path) -> int:
    """The number of parameters of the run's policy."""
    from spikedeploy.trainers.run_folder import load_policy

    return sum(weights.numel() for weights in load_policy(run).parameters())
