"""Run folder: all files of one training run.

<runs>/<recipe>-s<seed>-<date>-<time>/
    config.json          resolved configuration
    versions.json        of Python, packages and source tree
    metrics.csv          one row for each logging interval
    curve.png            learning curve
    report.html          to look at: written anew after each row of metrics
    checkpoints/{last,best}.safetensors, each with a .json of its numbers to read

A checkpoint is one file, which is replaced at once and holds its checksum, so that at any moment
one that is complete can be resumed. "last" has everything that resuming needs.
"""

import errno
import hashlib
import json
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikedeploy.runtime import files
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_json, replacing, write_json
from spikedeploy.trainers.versions import versions

if TYPE_CHECKING:  # reports look at runs where torch and pydantic are not installed
    from torch import Tensor

    from spikedeploy.trainers.config import C, RunConfig
    from spikedeploy.trainers.policies import Policy

LEVEL = "ops-"  # and operations: names of the best checkpoints of the levels of pruning


# what a kill leaves of a checkpoint: of `replacing`, and of safetensors, which writes to a file of
# its own at first
_UNFINISHED = re.compile(r"\..+\.(json|safetensors)\.(\w+-)?\d+\.part|\.tmp\w{6}")


class RunFolder:
    """One run on disk.

    path: the folder
    metrics: path of the metrics
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.metrics = self.path / "metrics.csv"

    @classmethod
    def create(cls, runs: str | Path, config: "RunConfig") -> "RunFolder":
        """Return a new folder with configuration and versions."""
        from spikedeploy.trainers.recipes import RECIPES

        title, stamp = config.recipe, datetime.now().strftime("%Y%m%d-%H%M%S")
        if title in RECIPES and RECIPES[title].any_env:
            title += "-" + re.sub(r"[^A-Za-z0-9.-]+", "-", config.env.name)
        try:
            run = cls(_new_folder(Path(runs) / f"{title}-s{config.seed}-{stamp}"))
            (run.path / "checkpoints").mkdir()
        except OSError as error:
            raise ConfigError(
                f"cannot make a run folder in {runs}: {error.strerror}. Name another with --runs."
            ) from error
        with write_errors(run.path / "versions.json") as file:
            write_json(file, versions())
        run.write_config(config)  # last: it makes the folder a run
        return run

    @classmethod
    def find(cls, name: str | Path, runs: str | Path = "runs", recipe: str = "") -> "RunFolder":
        """Return a run by path or by its name in `runs`; ConfigError where there is none.

        "last" is the newest with a checkpoint, of the recipe if one is given.
        """
        if str(name) != "last":
            return cls(existing_run(name, runs))
        found = [cls(path) for path in runs_in(Path(runs))]
        if recipe:
            found = [run for run in found if run.settings()["recipe"] == recipe]
        usable = [run for run in found if any(run.path.glob("checkpoints/*.safetensors"))]
        if not usable:
            of = f" of recipe {recipe}" if recipe else ""
            none = f"; {len(found)} without a checkpoint" if found else ""
            raise ConfigError(f"no run{of} in {runs}/{none}: train one first")
        return max(usable, key=lambda run: (run.path / "config.json").stat().st_mtime_ns)

    def settings(self) -> dict[str, Any]:
        """Return the configuration as written, for any algorithm."""
        return read_json(self.path / "config.json")

    def config(self, model: "type[C]") -> "C":
        """Return the configuration."""
        from spikedeploy.runtime.schema import validate

        remedy = ". If another version made the run (versions.json), use that one, or train it anew"
        return validate(model, self.settings(), str(self.path), remedy)

    def write_config(self, config: "RunConfig") -> None:
        """Write the configuration."""
        with write_errors(self.path / "config.json") as file:
            write_json(file, config.model_dump(mode="json"))

    def checkpoint(self, name: str) -> Path:
        """Return the path of a checkpoint, whether or not it exists."""
        return self.path / "checkpoints" / f"{name}.safetensors"

    def deployed(self, name: str | None = None) -> str:
        """Return the name of the deployed checkpoint: the one asked for, else best, else last."""
        names = sorted(path.stem for path in self.path.glob("checkpoints/*.safetensors"))
        if name is None:
            return "best" if "best" in names else "last"
        if name not in names:
            raise ConfigError(
                f"{self.path} has no checkpoint {name!r}; it has: {', '.join(names) or 'none yet'}"
            )
        return name

    @property
    def begun(self) -> bool:
        """True from the first checkpoint on, also where "last" was lost."""
        return any(self.path.glob("checkpoints/[!.]*"))

    def save(
        self,
        name: str,
        policy: "Policy",
        state: Mapping[str, Any],
        tensors: "Mapping[str, Tensor] | None" = None,
    ) -> None:
        """Write a checkpoint: the policy, its state as JSON, and more tensors."""
        # clones, as safetensors refuses tensors that share memory, as a crossbar's are
        weights = {f"policy.{key}": value.clone() for key, value in policy.state_dict().items()}
        record = {"policy": policy.spec(), **state}
        path = self.checkpoint(name)
        self.write_numbers(name, write_checkpoint(path, record, {**weights, **(tensors or {})}))

    @property
    def levels(self) -> dict[float, str]:
        """Operations of each level of pruning that has a policy -> its checkpoint, fewest first."""
        found: dict[float, str] = {}
        for path in self.path.glob(f"checkpoints/{LEVEL}*.safetensors"):
            with suppress(ValueError):  # a copy that somebody named
                found[float(path.stem.removeprefix(LEVEL))] = path.stem
        return dict(sorted(found.items()))

    def write_numbers(self, name: str, state: Mapping[str, Any]) -> None:
        """Write the numbers to read of a checkpoint, after its weights."""
        with write_errors(self.checkpoint(name).with_suffix(".json")) as path:
            write_json(path, state)

    def load(self, name: str) -> "tuple[dict[str, Any], dict[str, Tensor]]":
        """Return state and tensors of a checkpoint."""
        path = self.checkpoint(name)
        remedy = "Put the file back, or train again; the other checkpoints are files of their own."
        if not path.is_file() and (path.with_suffix(".json").is_file() or name == "last"):
            raise ConfigError(f"{path} is missing. {remedy}")
        if not path.is_file():
            raise ConfigError(f"{self.path} has no checkpoint '{name}' yet")
        return read_checkpoint(path, remedy)

    def locked(self) -> AbstractContextManager[None]:
        """Hold the lock of the run: one process trains in it at a time; reading needs none."""
        busy = f"{self.path} is being trained by another process: wait for its end, or stop it"
        return files.locked(self.path / ".lock", busy)

    def sweep(self) -> None:
        """Delete unfinished checkpoints of processes that were killed; the run must be locked."""
        for path in (self.path / "checkpoints").glob(".*"):
            if _UNFINISHED.fullmatch(path.name):
                path.unlink(missing_ok=True)

    def policy(self, name: str | None = None) -> "Policy":
        """Return the policy of a checkpoint, by default the deployed one, ready to act."""
        from spikedeploy.trainers.policies import build

        state, tensors = self.load(self.deployed() if name is None else name)
        policy = build(state["policy"])
        policy.load_state_dict(with_prefix("policy", tensors))
        return policy.eval().requires_grad_(False)


def _new_folder(path: Path) -> Path:
    """Make the folder, with a number appended if it exists, and return it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for k in range(1000):
        named = path.with_name(f"{path.name}-{k}") if k else path
        with suppress(FileExistsError):
            named.mkdir()
            return named
    raise FileExistsError(errno.EEXIST, "exists, and so do 999 beside it", str(path))


# -- names of runs: a path, or a name in a folder of runs


def find_run(name: str | Path, runs: str | Path = "runs") -> Path | None:
    """Return the run folder of a path, or of a name in `runs`; else None."""
    return next((path for path in (Path(name), Path(runs) / name) if is_run(path)), None)


def existing_run(name: str | Path, runs: str | Path = "runs") -> Path:
    """Return the run folder that a name means; ConfigError where there is none."""
    if (path := find_run(name, runs)) is not None:
        return path
    beside = "" if Path(name).is_absolute() else f", nor in {Path(runs) / name}"
    raise ConfigError(f"'{name}' is no run folder: no config.json in it{beside}")


def is_run(path: Path) -> bool:
    """Return whether a path is a run folder."""
    return (path / "config.json").is_file()


def runs_in(folder: Path) -> list[Path]:
    """Return the run folders in a folder, by name."""
    return sorted(path for path in folder.iterdir() if is_run(path)) if folder.is_dir() else []


# -- writing and checksums


def write_checkpoint(
    path: Path, state: Mapping[str, Any], tensors: "Mapping[str, Tensor]"
) -> dict[str, Any]:
    """Write tensors and a state, as JSON, to one file; return the state with the checksum."""
    from safetensors.torch import save_file

    named: dict[str, Tensor] = {}
    places: set[int] = set()
    for key, value in tensors.items():
        whole = value.cpu().contiguous()
        # of layers that share a matrix each holds a copy, as the format has no references
        named[key] = whole.clone() if whole.data_ptr() in places else whole
        places.add(whole.data_ptr())
    record = {**state, "sha256": _digest(state, named)}
    with write_errors(path), replacing(path) as part:
        # the state is part of the same file, so that the two always belong together
        save_file(named, part, metadata={"state": json.dumps(record)})
    return record


def read_checkpoint(
    path: Path, remedy: str = "Put the file back, or begin anew."
) -> "tuple[dict[str, Any], dict[str, Tensor]]":
    """Return state and tensors of a checkpoint; ConfigError where it is damaged."""
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, "pt") as file:
            held = file.metadata() or {}
            if "state" not in held:
                raise ValueError("it holds no state of a training")
            state: dict[str, Any] = json.loads(held["state"])
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        if state.get("sha256") != _digest(state, tensors):
            raise ValueError("its content does not have its checksum")
    except (SafetensorError, OSError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise ConfigError(f"{path} is not a valid checkpoint: {error}. {remedy}") from error
    return state, tensors


@contextmanager
def write_errors(path: Path) -> Iterator[Path]:
    """Yield the path; a file of a training that cannot be written within is a ConfigError."""
    module = sys.modules.get("safetensors")  # where it is not imported, it raises nothing
    errors = (OSError,) if module is None else (OSError, module.SafetensorError)
    try:
        yield path
    except errors as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(
            f"{path} could not be written: {reason}. The last checkpoint is complete: make room, "
            "or copy the run where files can be written, and go on with --resume."
        ) from error


def with_prefix(prefix: str, named: "Mapping[str, Tensor]") -> "dict[str, Tensor]":
    """Return the tensors whose names start with the prefix and a dot, with these removed."""
    start = f"{prefix}."
    return {name[len(start) :]: t for name, t in named.items() if name.startswith(start)}


def _digest(state: Mapping[str, Any], tensors: "Mapping[str, Tensor]") -> str:
    """Return the SHA-256 of everything that a checkpoint holds."""
    import torch

    numbers = {key: value for key, value in state.items() if key != "sha256"}
    digest = hashlib.sha256(json.dumps(numbers).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.contiguous().reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()
