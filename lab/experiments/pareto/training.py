"""One training of the experiment: found among the run folders, resumed, or started."""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from lab.experiments.trial import resumable
from spikedeploy.files import locked, read_json
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import RunConfig, differences, resolve
from spikedeploy.trainers.run_folder import LEVEL, RunFolder
from spikedeploy.trainers.sparse.config import SparseConfig, phases

# settings that a baseline takes from the experiment
_OWN = ("pool", "teacher_walks", "noisy_walks")


@dataclass(frozen=True)
class Training:
    """A training.

    recipe     of trainers.recipes, trained by the sparse algorithm
    seed       of the training
    folder     in which its run folder is looked for, or made
    overrides  settings as `--set` takes them
    walks_of   recipe whose walks of the same seed are taken over; empty for walks of its own
    """

    recipe: str
    seed: int
    folder: str
    overrides: Sequence[str]
    walks_of: str

    trained_by = "imitation"
    unit = "updates"

    @property
    def student(self) -> str:
        """Recipe of the student."""
        return self.recipe

    @property
    def name(self) -> str:
        """`hexapod-sparse-s0`."""
        return f"{self.recipe}-s{self.seed}"

    @property
    def donor(self) -> "Training | None":
        """The training whose walks are taken over."""
        if not self.walks_of:
            return None
        return Training(self.walks_of, self.seed, self.folder, self.overrides, "")

    @property
    def run(self) -> Path | None:
        """Its run folder: the first finished one, else the last; None before the training."""
        return preferred(self._runs(), finished)

    def _runs(self) -> Iterator[Path]:
        for file in Path(self.folder).glob("*/config.json"):
            settings = read_json(file)
            if (settings.get("recipe"), settings.get("seed")) == (self.recipe, self.seed):
                yield file.parent

    @property
    def trained(self) -> bool:
        """Whether all updates were made."""
        return self.run is not None and finished(self.run)

    @property
    def progress(self) -> tuple[int, int]:
        """Updates at the last checkpoint, and of the whole training."""
        return progress(self.run) if self.run else (-1, 0)

    @property
    def levels(self) -> list[str]:
        """Names of the checkpoints of all levels of pruning, most operations first."""
        found = self.run.glob(f"checkpoints/{LEVEL}*.safetensors") if self.run else ()
        return sorted((path.stem for path in found), key=operations_of, reverse=True)

    def operations_of(self, level: str) -> float:
        """Operations that a level aims at."""
        return operations_of(level)

    def config(self, run: Path) -> SparseConfig:
        """The configuration of a run."""
        return RunFolder(run).config(SparseConfig)

    @property
    def changed_settings(self) -> list[str]:
        """Settings of the training that differ from what the recipe and the overrides say now."""
        own = tuple(f"{name}=" for name in _OWN) if self.walks_of else ()
        return changed(self.config(self.run), self.planned([]), own) if self.run else []

    def planned(self, more: Sequence[str]) -> SparseConfig:
        """The configuration of a new run, with more settings."""
        settings = [*self.overrides, *more]
        return resolve(SparseConfig, self.recipe, overrides=settings, seed=self.seed)

    def beginning(self) -> list[str]:
        """Settings of a new run beside the overrides: a baseline takes over walks."""
        donor = self.donor
        if donor is None:
            return []
        if donor.run is None or not donor.trained:
            raise ConfigError(
                f"{self.name} learns from the walks of {donor.name}, which is not trained yet. "
                f"Run the experiment without --only, or with --only {donor.name} first."
            )
        return [f"pool={json.dumps(str(donor.run))}", "teacher_walks=0", "noisy_walks=0"]

    def arguments(self) -> dict[str, Any]:
        """The fields as arguments of `perform`."""
        return {**asdict(self), "overrides": list(self.overrides)}


def changed(made: RunConfig, planned: RunConfig, own: tuple[str, ...]) -> list[str]:
    """Settings of a run that differ from the planned ones; `own` begin those that always do."""
    expected = set(differences(planned))
    found = differences(made)
    return [each for each in found if each not in expected and not each.startswith(own)]


def operations_of(level: str) -> float:
    """Operations that a level of pruning aims at, from its checkpoint's name."""
    return float(level.removeprefix(LEVEL))


def finished(run: Path) -> bool:
    """Whether all updates of a run were made."""
    made, total = progress(run)
    return made >= total


def progress(run: Path) -> tuple[int, int]:
    """Updates at the last checkpoint of a run, and of the whole training."""
    last = run / "checkpoints" / "last.json"
    made = read_json(last)["updates"] if last.is_file() else -1
    return int(made), phases(RunFolder(run).config(SparseConfig))[-1].end


def preferred(found: Iterable[Path], done: Callable[[Path], bool]) -> Path | None:
    """The first run folder that is done, else the last."""
    runs = sorted(found)
    return next(filter(done, runs), runs[-1] if runs else None)


class Trainable(Protocol):
    """A training by imitation or with reward, to be completed."""

    @property
    def name(self) -> str:
        """Of the part of the experiment."""

    @property
    def recipe(self) -> str:
        """Of trainers.recipes."""

    @property
    def seed(self) -> int:
        """Of the training."""

    @property
    def folder(self) -> str:
        """In which its run folder is looked for, or made."""

    @property
    def overrides(self) -> Sequence[str]:
        """Settings as `--set` takes them."""

    @property
    def run(self) -> Path | None:
        """Its run folder."""

    @property
    def trained(self) -> bool:
        """Whether it is complete."""

    def beginning(self) -> list[str]:
        """Settings of a new run beside the overrides."""

    def planned(self, more: Sequence[str]) -> RunConfig:
        """The configuration of a new run, with more settings."""


def perform(**arguments: Any) -> bool:  # noqa: ANN401
    """Complete the training with these fields; False if it was interrupted."""
    return complete(Training(**arguments))


def complete(training: Trainable) -> bool:
    """Complete a training; False if it was interrupted."""
    with locked(Path(training.folder) / f".{training.name}.lock"):
        if not training.trained:
            _train(training)
        return training.trained


def _train(training: Trainable) -> None:
    from spikedeploy.trainers.train import train

    start = partial(train, training.recipe, runs=training.folder, quiet=True)
    if run := resumable(training.run):
        start(resume=run)
    else:
        start(overrides=[*training.overrides, *training.beginning()], seed=training.seed)


def check(training: Trainable) -> None:
    """Refuse unknown settings before the first training starts."""
    try:
        training.planned([])
    except ConfigError as error:
        raise ConfigError(f"{training.name}: {error}") from error
