"""One training of the gymnasium experiment: found among finished runs, resumed, or started."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lab.experiments.pareto.training import changed, preferred
from spikedeploy.files import read_json
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import RunConfig, parse_override, resolve
from spikedeploy.trainers.recipes import RECIPES, merged
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.train import algorithm

# how a training was computed, which changes numbers in their last places
_HOW = ("device", "precision")
_MORE = {"pool": ("teacher_walks=0", "noisy_walks=0")}  # settings that come with a source


@dataclass(frozen=True)
class TaskTraining:
    """A training of a task.

    env        id of the task
    role       "teacher", "sparse", "tuned", "dense" or "small-mlp"
    recipe     of trainers.recipes
    seed       of the training
    folder     in which its run folder is looked for, or made
    settings   as `--set` takes them, the environment apart
    sources    setting -> the training whose run folder it names
    """

    env: str
    role: str
    recipe: str
    seed: int
    folder: str
    settings: Sequence[str]
    sources: "Mapping[str, TaskTraining]" = field(default_factory=dict)

    @property
    def name(self) -> str:
        """`Hopper-v5-sparse-s0`."""
        return f"{self.env}-{self.role}-s{self.seed}"

    @property
    def overrides(self) -> list[str]:
        """Settings as `--set` takes them."""
        return [f"env.name={json.dumps(self.env)}", *self.settings]

    @property
    def run(self) -> Path | None:
        """Its run folder: the first finished one, else the last; None before the training."""
        return preferred(self._runs(), _finished)

    def _runs(self) -> Iterator[Path]:
        for file in Path(self.folder).glob("*/config.json"):
            made = read_json(file)
            if self._is_of(made):
                yield file.parent

    def _is_of(self, made: Mapping[str, Any]) -> bool:
        """Whether a run has the recipe, seed, settings and sources of this training."""
        if (made.get("recipe"), made.get("seed")) != (self.recipe, self.seed):
            return False
        every = [*self.overrides, *self._more]  # the last one of a name counts
        wanted = [setting for setting in every if not setting.startswith(_HOW)]
        if not _within(merged({}, *map(parse_override, wanted)), made):
            return False
        return all(_names(made.get(key), source.run) for key, source in self.sources.items())

    @property
    def trained(self) -> bool:
        """Whether it ended."""
        return self.run is not None and _finished(self.run)

    @property
    def share(self) -> float:
        """Part of the training that is done, from 0 to 1."""
        return float(_last(self.run).get("share", 0.0)) if self.run else 0.0

    @property
    def changed_settings(self) -> list[str]:
        """Settings of its run that differ from those of the design and the recipe."""
        if self.run is None:
            return []
        own = [*_HOW, *self.sources, *(word.split("=")[0] for word in self._more)]
        own += ["policy."] if "start" in self.sources else []
        kind = algorithm(RECIPES[self.recipe].algorithm)
        return changed(RunFolder(self.run).config(kind.Config), self.planned([]), tuple(own))

    def planned(self, more: Sequence[str]) -> RunConfig:
        """The configuration of a new run, with more settings."""
        kind = algorithm(RECIPES[self.recipe].algorithm)
        settings = [*self.overrides, *more]
        config: RunConfig = resolve(kind.Config, self.recipe, overrides=settings, seed=self.seed)
        return config

    @property
    def _more(self) -> list[str]:
        return [setting for key in self.sources for setting in _MORE.get(key, ())]

    def beginning(self) -> list[str]:
        """Settings of a new run beside the overrides: the runs that it is made from."""
        found = []
        for key, source in self.sources.items():
            if source.run is None or not source.trained:
                raise ConfigError(
                    f"{self.name} needs {source.name}, which is not trained yet. Run the "
                    f"experiment without --only, or with --only {source.name} first."
                )
            found.append(f"{key}={json.dumps(str(source.run))}")
        return [*found, *self._more]


def _within(wanted: object, made: object) -> bool:
    """Whether nested settings are among those of a run."""
    if isinstance(wanted, Mapping):
        return isinstance(made, Mapping) and all(
            _within(value, made.get(key)) for key, value in wanted.items()
        )
    return wanted == made


def _names(setting: object, run: Path | None) -> bool:
    """Whether a setting names a run folder, wherever that was then."""
    return run is not None and isinstance(setting, str) and Path(setting).name == run.name


def _last(run: Path) -> dict[str, Any]:
    """The counters of a run's last checkpoint; empty without one."""
    file = run / "checkpoints" / "last.json"
    return read_json(file) if file.is_file() else {}


def _finished(run: Path) -> bool:
    return bool(_last(run).get("finished", False))
