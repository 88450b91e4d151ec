"""A training that is found among run folders, resumed, or started; and a result that is kept.

All results of a training are in its run folder. It can be stopped at any time; the next attempt
goes on. A file lock keeps other processes out; the system releases it when the process ends.
"""

import csv
import json
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spikedeploy.files import as_text, locked, read_json, write_text
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import RunConfig, differences, parse_override, resolve
from spikedeploy.trainers.recipes import RECIPES, merged
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.train import algorithm

Record = dict[str, Any]
_COMPUTED = ("device", "precision")  # settings that change numbers in their last places
_WITH_PARENT = {"pool": ("teacher_walks=0", "noisy_walks=0")}  # settings that come with a parent
_RESULTS = ("evaluation.json", "tracks.json", "policy.*")  # of a training that ended


@dataclass(frozen=True)
class TrainingJob:
    """A training.

    name       of the part of the experiment: `hexapod-sparse-s0`
    recipe     of trainers.recipes
    seed       of the training
    folder     in which its run folder is looked for, or made
    overrides  settings as `--set` takes them
    parents    setting -> the training whose run folder it names
    telling    those of the settings that tell its runs from others of the same recipe and seed
    """

    name: str
    recipe: str
    seed: int
    folder: str
    overrides: Sequence[str] = ()
    parents: "Mapping[str, TrainingJob]" = field(default_factory=dict)
    telling: Sequence[str] = ()

    @property
    def run(self) -> Path | None:
        """Its run folder: the first finished one, else the last; None before the training."""
        files = Path(self.folder).glob(f"{self.recipe}*-s{self.seed}-*/config.json")
        runs = sorted(file.parent for file in files if self._is_of(read_json(file)))
        return next(filter(self._is_finished, runs), runs[-1] if runs else None)

    @property
    def existing_run(self) -> Path:
        """Its run folder, which must be there."""
        if (run := self.run) is None:
            raise ConfigError(f"{self.name} has no run folder")
        return run

    def _is_of(self, made: Record) -> bool:
        """Return whether a run has recipe, seed, telling settings and parents of this training."""
        if (made.get("recipe"), made.get("seed")) != (self.recipe, self.seed):
            return False
        wanted = [setting for setting in self.telling if not setting.startswith(_COMPUTED)]
        return _is_within(merged({}, *map(parse_override, wanted)), made) and all(
            _is_run(made.get(key), parent.run)
            for key, parent in self.parents.items()
            if key not in _WITH_PARENT  # a training is the same without its walks
        )

    def _is_finished(self, run: Path) -> bool:
        return bool(counters(run).get("finished", False))

    @property
    def is_trained(self) -> bool:
        """Return whether it ended."""
        return self.run is not None and self._is_finished(self.run)

    @property
    def progress(self) -> str:
        """`hexapod-sparse-s0: 45%`."""
        run = self.run
        return self.name if run is None else f"{self.name}: {counters(run).get('share', 0.0):.0%}"

    def planned(self) -> Any:  # noqa: ANN401 - the Config of the recipe's algorithm
        """The configuration of a new run, parents apart; ConfigError names the training."""
        try:
            return resolve(self._kind.Config, self.recipe, overrides=self.overrides, seed=self.seed)
        except ConfigError as error:
            raise ConfigError(f"{self.name}: {error}") from error

    @property
    def _kind(self) -> Any:  # noqa: ANN401
        return algorithm(RECIPES[self.recipe].algorithm)

    @property
    def config(self) -> Any:  # noqa: ANN401
        """The configuration of its run, or of a new one."""
        run = self.run
        return RunFolder(run).config(self._kind.Config) if run else self.planned()

    @property
    def changed_settings(self) -> list[str]:
        """Settings of its run that differ from what the recipe and the overrides say now."""
        if self.run is None:
            return []
        made: RunConfig = self.config
        expected = set(differences(self.planned()))
        own = (*_COMPUTED, *self.parents, *(each.split("=")[0] for each in self._with_parents))
        own += ("policy.",) if "start" in self.parents else ()
        found = (each for each in differences(made) if each not in expected)
        return [each for each in found if not each.startswith(own)]

    @property
    def _with_parents(self) -> list[str]:
        return [setting for key in self.parents for setting in _WITH_PARENT.get(key, ())]

    def _beginning(self) -> list[str]:
        """Settings of a new run beside the overrides: the runs that it is made from."""
        found = []
        for key, parent in self.parents.items():
            if parent.run is None or not parent.is_trained:
                raise ConfigError(f"{self.name} needs {parent.name}, which is not trained yet")
            found.append(f"{key}={json.dumps(str(parent.run))}")
        return [*found, *self._with_parents]

    def complete(self) -> bool:
        """Train, or go on; False if it was interrupted."""
        with locked(Path(self.folder) / f".{self.name}.lock"):
            if not self.is_trained:
                self._train(resumable(self.run))
            return self.is_trained

    def _train(self, run: Path | None) -> None:
        from spikedeploy.trainers import train

        if run:
            train.train(self.recipe, resume=run, runs=self.folder, quiet=True)
        else:
            settings = [*self.overrides, *self._beginning()]
            train.train(
                self.recipe, overrides=settings, seed=self.seed, runs=self.folder, quiet=True
            )


def counters(run: Path) -> Record:
    """The counters of a run's last checkpoint; empty without one."""
    file = run / "checkpoints" / "last.json"
    return read_json(file) if file.is_file() else {}


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


def _is_within(wanted: object, made: object) -> bool:
    """Return whether nested settings are among those of a run."""
    if isinstance(wanted, Mapping):
        return isinstance(made, Mapping) and all(
            _is_within(value, made.get(key)) for key, value in wanted.items()
        )
    return wanted == made


def _is_run(setting: object, run: Path | None) -> bool:
    """Return whether a setting names a run folder, wherever that was then."""
    return run is not None and isinstance(setting, str) and Path(setting).name == run.name


@dataclass(frozen=True)
class StoredRow:
    """One row of an experiment, in a file of its own, kept until what made it changes.

    file  where the result is
    of    what it must have been made with
    """

    file: Path
    of: Record

    @property
    def found(self) -> Record | None:
        """The result; None where it is missing or was made with something else."""
        if not self.file.is_file():
            return None
        made = read_json(self.file)
        return made.get("row") if made.get("of") == self.of else None

    def write(self, row: Record) -> None:
        """Write the result."""
        write_text(self.file, as_text({"of": self.of, "row": row}))


def is_complete(rows: Iterable[StoredRow]) -> bool:
    """Return whether every row has its result."""
    return all(row.found is not None for row in rows)


def complete(rows: Iterable[StoredRow], evaluate: Callable[[StoredRow], Record]) -> None:
    """Make the rows that have no result."""
    for row in rows:
        if row.found is None:
            row.write(evaluate(row))


def results(rows: Iterable[StoredRow]) -> Iterator[Record]:
    """The results so far."""
    return (found for row in rows if (found := row.found) is not None)


def read_rows(path: Path, texts: Collection[str]) -> list[Record]:
    """The rows of a CSV; missing fields are None. Columns other than `texts` hold JSON."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [{n: _value(text, n in texts) for n, text in row.items()} for row in rows]


def _value(text: str, is_text: bool) -> Any:  # noqa: ANN401
    if not text:
        return None
    return text if is_text else json.loads(text)
