"""One training with reward after a training by imitation: found, resumed, or started."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lab.experiments.pareto.training import (
    Training,
    changed,
    complete,
    operations_of,
    preferred,
)
from spikedeploy.files import read_json
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.ppo import SparsePpoConfig, find_start

BEST = "best"  # the checkpoint at the budget of a training by imitation
_OWN = ("start=", "policy.")  # settings that follow from the training before


@dataclass(frozen=True)
class RewardTraining:
    """A training with reward.

    recipe     of trainers.recipes, trained by the sparse-ppo algorithm
    start      the training whose policy goes on
    overrides  settings as `--set` takes them
    level      checkpoint of the policy: the best at the budget, or of an earlier level of pruning
    """

    recipe: str
    start: Training
    overrides: Sequence[str]
    level: str = BEST

    trained_by = "reward"
    unit = "iterations"

    @property
    def seed(self) -> int:
        """Of both trainings."""
        return self.start.seed

    @property
    def folder(self) -> str:
        """In which its run folder is looked for, or made."""
        return self.start.folder

    @property
    def student(self) -> str:
        """Recipe of the student."""
        return self.start.recipe

    @property
    def name(self) -> str:
        """`hexapod-tuned-small-mlp-s0`, `hexapod-tuned-small-mlp-ops-180-s0`."""
        env = self.recipe.removesuffix("-sparse-tuned")
        level = "" if self.level == BEST else f"-{self.level}"
        return f"{env}-tuned-{self.student.removeprefix(f'{env}-')}{level}-s{self.seed}"

    @property
    def donor(self) -> Training:
        """The training that must have ended before."""
        return self.start

    @property
    def run(self) -> Path | None:
        """Its run folder: the first finished one, else the last; None before the training."""
        return preferred(self._runs(), lambda run: _made(run) >= _planned(run))

    def _runs(self) -> Iterator[Path]:
        """Those of other students have the same recipe and seed: their starts tell them apart."""
        for file in Path(self.folder).glob("*/config.json"):
            settings = read_json(file)
            if (settings.get("recipe"), settings.get("seed")) != (self.recipe, self.seed):
                continue
            if settings.get("start_checkpoint", BEST) != self.level:
                continue
            if _origin(settings["start"], Path(self.folder)) == (self.student, self.seed):
                yield file.parent

    @property
    def trained(self) -> bool:
        """Whether all iterations were made."""
        return self.run is not None and _made(self.run) >= _planned(self.run)

    @property
    def progress(self) -> tuple[int, int]:
        """Iterations at the last checkpoint, and of the whole training."""
        return (_made(self.run), _planned(self.run)) if self.run else (-1, 0)

    @property
    def levels(self) -> list[str]:
        """Name of the checkpoint that is evaluated."""
        return [BEST]

    def operations_of(self, level: str) -> float:
        """Operations that a checkpoint aims at: those of the policy at the start."""
        if self.level != BEST:
            return operations_of(self.level)
        if self.run is None:
            raise ConfigError(f"{self.name} has no run folder")
        start = find_start(self.config(self.run).start, Path(self.folder))
        return start.config(SparseConfig).budget

    def config(self, run: Path) -> SparsePpoConfig:
        """The configuration of a run."""
        return RunFolder(run).config(SparsePpoConfig)

    @property
    def changed_settings(self) -> list[str]:
        """Settings of the training that differ from what the recipe and the overrides say now."""
        return changed(self.config(self.run), self.planned([]), _OWN) if self.run else []

    def planned(self, more: Sequence[str]) -> SparsePpoConfig:
        """The configuration of a new run, with more settings."""
        settings = [*self.overrides, *self._at_level, *more]
        return resolve(SparsePpoConfig, self.recipe, overrides=settings, seed=self.seed)

    def beginning(self) -> list[str]:
        """Settings of a new run beside the overrides: the run that it goes on from."""
        run = self.start.run
        if run is None or not self.start.trained:
            raise ConfigError(
                f"{self.name} goes on from {self.start.name}, which is not trained yet. "
                f"Run the experiment without --only, or with --only {self.start.name} first."
            )
        return [f"start={json.dumps(str(run))}", *self._at_level]

    @property
    def _at_level(self) -> list[str]:
        return [] if self.level == BEST else [f"start_checkpoint={self.level}"]

    def arguments(self) -> dict[str, Any]:
        """The fields as arguments of `perform`."""
        return {**asdict(self), "start": self.start.arguments(), "overrides": list(self.overrides)}


def _made(run: Path) -> int:
    """Iterations at the last checkpoint of a run."""
    last = run / "checkpoints" / "last.json"
    return int(read_json(last)["iterations"]) if last.is_file() else -1


def _planned(run: Path) -> int:
    return RunFolder(run).config(SparsePpoConfig).iterations


def _origin(start: str, runs: Path) -> tuple[str, int] | None:
    """Recipe and seed of the run that `start` names; None where there is no such run."""
    if not start:
        return None
    try:
        settings = find_start(start, runs).settings()
    except ConfigError:
        return None
    return settings["recipe"], settings["seed"]


def perform(recipe: str, start: dict[str, Any], overrides: Sequence[str], level: str) -> bool:
    """Complete the training with these fields; False if it was interrupted."""
    return complete(RewardTraining(recipe, Training(**start), overrides, level))
