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

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import as_text, locked, read_json, replacing, write_text
from spikedeploy.trainers.config import RunConfig, differences, parse_override, resolve
from spikedeploy.trainers.recipes import RECIPES, merge
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.train import algorithm

Record = dict[str, Any]
_COMPUTED = ("device", "precision")  # settings that change numbers in their last places
_WITH_PARENT = {"pool": ("teacher_walks=0", "noisy_walks=0")}  # settings that come with a parent
NUMBER = (int, float)  # a form of StoredRow, as are types
_NAMES = {NUMBER: "a number", int: "an integer", str: "a text"}
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
    lacking    settings that its runs leave out, or have as None, likewise
    """

    name: str
    recipe: str
    seed: int
    folder: str
    overrides: Sequence[str] = ()
    parents: "Mapping[str, TrainingJob]" = field(default_factory=dict)
    telling: Sequence[str] = ()
    lacking: Sequence[str] = field(default=(), kw_only=True)  # others follow in subclasses

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

    def checkpoint(self, name: str = "best") -> Path:
        """The weights of a checkpoint of its run."""
        return self.existing_run / "checkpoints" / f"{name}.safetensors"

    def _is_of(self, made: Record) -> bool:
        """Return whether a run has recipe, seed, telling settings and parents of this training."""
        if (made.get("recipe"), made.get("seed")) != (self.recipe, self.seed):
            return False
        if any(made.get(name) is not None for name in self.lacking):
            return False
        wanted = [setting for setting in self.telling if not setting.startswith(_COMPUTED)]
        return _is_within(merge({}, *map(parse_override, wanted)), made) and all(
            # wherever the parent was then
            parent.run is not None and Path(str(made.get(key))).name == parent.run.name
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

    def complete(self) -> bool:
        """Train, or go on; False if it was interrupted."""
        with locked(Path(self.folder) / f".{self.name}.lock"):
            if not self.is_trained:
                self._train(_resumable(self.run))
            return self.is_trained

    def _train(self, run: Path | None) -> None:
        from spikedeploy.trainers import train

        options: dict[str, Any] = {"resume": run}
        if run is None:
            beginning = []
            for key, parent in self.parents.items():
                if parent.run is None or not parent.is_trained:
                    raise ConfigError(f"{self.name} needs {parent.name}, which is not trained yet")
                beginning.append(f"{key}={json.dumps(str(parent.run))}")
            overrides = [*self.overrides, *beginning, *self._with_parents]
            options = {"overrides": overrides, "seed": self.seed}
        train.train(self.recipe, runs=self.folder, quiet=True, **options)


def counters(run: Path) -> Record:
    """The counters of a run's last checkpoint; empty without one."""
    file = run / "checkpoints" / "last.json"
    return read_json(file) if file.is_file() else {}


def _resumable(run: Path | None) -> Path | None:
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


@dataclass(frozen=True)
class StoredRow:
    """A result of an experiment, in a file of its own, kept until what made it changes.

    file   where the result is
    of     what it must have been made with
    make   makes it
    about  what stands beside `of` in the file, and must be the same
    under  the field of the file that it is; the fields of the file themselves where it is empty
    form   of it: a type, [form] of each in a list, or {name: form} of an object's fields
    """

    file: Path
    of: Record
    make: Callable[[], Any]
    about: Record = field(default_factory=dict)
    under: str = "row"
    form: Any = field(default_factory=dict)

    @property
    def found(self) -> Any:  # noqa: ANN401 - JSON, or None
        """The result; None where it is missing or was made with something else."""
        made = read_json(self.file) if self.file.is_file() else {}
        if not all(made.get(name) == value for name, value in self._head.items()):
            return None
        found = made.get(self.under) if self.under else made
        if found is None or (fault := _fault(found, self.form, self.under or "it")) is None:
            return found
        raise ConfigError(f"{self.file} is damaged: {fault}. Put it back, or move it away")

    @property
    def _head(self) -> Record:
        return {"of": self.of, **self.about}

    def write(self, row: Any) -> None:  # noqa: ANN401
        """Write the result."""
        write_text(self.file, as_text({**self._head, **({self.under: row} if self.under else row)}))

    def complete(self) -> None:
        """Make the result if it is missing."""
        if self.found is None:
            self.write(self.make())


def _fault(found: object, form: Any, name: str) -> str | None:  # noqa: ANN401
    """What is wrong with JSON of such a form; None where nothing is."""
    is_object, is_list = isinstance(form, Mapping), isinstance(form, list)
    wanted = Mapping if is_object else list if is_list else form
    if not isinstance(found, wanted):
        what = "an object" if is_object else "a list" if is_list else _NAMES[form]
        return f"{name} must be {what}, found {json.dumps(found)[:40]}"
    parts: Iterable[tuple[object, Any, str]] = ()
    if isinstance(found, list) and is_list:
        parts = ((each, form[0], f"{name}[{k}]") for k, each in enumerate(found))
    elif isinstance(found, Mapping):
        parts = ((found.get(key), each, f"{name}.{key}") for key, each in form.items())
    return next((fault for part in parts if (fault := _fault(*part))), None)


def results(rows: Iterable[StoredRow]) -> Iterator[Any]:
    """The results so far."""
    return (found for row in rows if (found := row.found) is not None)


def read_rows(path: Path, texts: Collection[str]) -> list[Record]:
    """The rows of a CSV; missing fields are None. Columns other than `texts` hold JSON."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    known = [{name: text for name, text in row.items() if text} for row in rows]
    parsed = [{n: t if n in texts else json.loads(t) for n, t in row.items()} for row in known]
    return [dict.fromkeys(row) | found for row, found in zip(rows, parsed, strict=True)]


def write_exactly(rows: Iterable[Record], columns: Sequence[str], path: Path) -> None:
    """Write rows as CSV with every digit; lists are JSON."""
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {n: json.dumps(v) if isinstance(v, list) else v for n, v in row.items()} for row in rows
        )
