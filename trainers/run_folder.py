"""Run folder: all files of one training run.

<runs>/<recipe>-s<seed>-<date>-<time>/
    config.json          resolved configuration
    SHA256SUMS           checksum of it
    versions.json        of Python, packages and source tree
    metrics.csv          one row for each logging interval
    curve.png            learning curve
    report.html, card.md, curve.svg   to look at, and to show: written anew at the end
    films/<step>.gif   episodes, filmed while it was trained
    replay.safetensors   replay buffer of an unfinished run
    checkpoints/{last,best}.safetensors, each with a .json of its numbers to read

A checkpoint is one file, which is replaced at once and holds the checksum of itself and those of
the files that belong to it, so that at any moment one that is whole can be resumed.
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

from spikedeploy import files
from spikedeploy.files import replacing
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.versions import versions

if TYPE_CHECKING:  # reports look at runs where torch and pydantic are not installed
    from torch import Tensor

    from spikedeploy.trainers.config import C, RunConfig
    from spikedeploy.trainers.policies import Policy

# -- Checksums of a run's files, so that what is read is what training wrote.
#
# A checkpoint holds its own, and those of the files that belong to it. That of config.json stands
# in
# SHA256SUMS beside it, as `sha256sum -c` reads it.

SUMS = "SHA256SUMS"
_CHUNK = 1 << 20


def of_bytes(content: bytes) -> str:
    """Return the SHA-256 of some bytes, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def of_file(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def write_summed(path: Path, content: bytes) -> None:
    """Write a file with its checksum beside it; killed in between, both contents are accepted."""
    new = of_bytes(content)
    before = _accepted(path) or ([of_file(path)] if path.is_file() else [])
    _write_sums(path, [*before, new])
    with replacing(path) as part:
        part.write_bytes(content)
    _write_sums(path, [new])


def check_summed(path: Path) -> None:
    """Refuse a file that is not what `write_summed` wrote; one without a checksum passes."""
    accepted = _accepted(path)
    if accepted and path.is_file() and of_file(path) not in accepted:
        raise ConfigError(
            f"{path} is damaged, or was changed by hand: put it back, or change settings with "
            f"--set. The checkpoints beside it are not affected; without {SUMS} the file is taken "
            "as it is."
        )


def _accepted(path: Path) -> list[str]:
    sums = path.parent / SUMS
    if not sums.is_file():
        return []
    lines = (
        line.split() for line in sums.read_text(encoding="utf-8", errors="replace").split("\n")
    )
    return [words[0] for words in lines if words[1:] == [path.name]]


def _write_sums(path: Path, sums: list[str]) -> None:
    with replacing(path.parent / SUMS) as part:
        part.write_text("".join(f"{each}  {path.name}\n" for each in dict.fromkeys(sums)))


def locked(run: Path) -> AbstractContextManager[None]:
    """Hold the lock of a run folder: one process trains in it at a time; reading needs none."""
    busy = f"{run} is being trained by another process: wait for its end, or stop it"
    return files.locked(run / ".lock", busy)


# -- A file of a training that could not be written: a full disk, no right to; in a sentence.


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Say in a sentence why a file of a training could not be written: a full disk, no right to."""
    try:
        yield
    except _errors() as error:
        why = getattr(error, "strerror", None) or str(error)
        raise ConfigError(
            f"{path} could not be written: {why}. The last checkpoint is whole: make room, or copy "
            "the run where files can be written, and go on with --resume."
        ) from error


def _errors() -> tuple[type[Exception], ...]:
    """What writing raises; reports read metrics with this module where safetensors is missing."""
    module = sys.modules.get("safetensors")
    return (OSError,) if module is None else (OSError, module.SafetensorError)


# -- What names of runs mean: a path, a name in a folder of runs, or the beginning of one.

_LISTED = 8


def run_named(name: str | Path, runs: str | Path = "runs") -> Path | None:
    """Return the run folder of a path, of a name in `runs`, or of one that begins so; else None.

    ConfigError lists the runs where several begin so.
    """
    places = (Path(name), Path(runs) / name)
    for place in places:
        if is_run(place):
            return place
    # a folder or file that is there is meant itself
    if not Path(name).name or any(place.exists() for place in places):
        return None
    found = {run.resolve(): run for place in places for run in _beginning(place)}
    if len(found) > 1:
        raise ConfigError(_ambiguous(str(name), sorted(map(str, found.values()))))
    return next(iter(found.values()), None)


def existing_run(name: str | Path, runs: str | Path = "runs") -> Path:
    """Return the run folder that a name means; ConfigError where there is none."""
    if (path := run_named(name, runs)) is not None:
        return path
    beside = "" if Path(name).is_absolute() else f", nor in {Path(runs) / name}"
    raise ConfigError(f"'{name}' is no run folder: no config.json in it{beside}")


def is_beginning(name: str, runs: str | Path = "runs") -> bool:
    """Return whether a name is the beginning of a run's, and not all of it."""
    return run_named(name, runs) not in (None, Path(name), Path(runs) / name)


def is_run(path: Path) -> bool:
    """Return whether a path is a run folder."""
    return (path / "config.json").is_file()


def runs_in(folder: Path) -> list[Path]:
    """Return the run folders in a folder, by name."""
    return sorted(path for path in folder.iterdir() if is_run(path)) if folder.is_dir() else []


def _beginning(place: Path) -> list[Path]:
    """Return the runs beside a path whose names begin with its last part."""
    return [run for run in runs_in(place.parent) if run.name.startswith(place.name)]


def _ambiguous(name: str, found: list[str]) -> str:
    more = f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
    return f"{name!r} is the beginning of {len(found)} runs: {', '.join(found[:_LISTED])}{more}"


# -- Run folder: all files of one training run.

LEVEL = "ops-"  # and operations: names of the best checkpoints of the levels of pruning
_POLICY = "policy."  # prefix of the policy's tensors
_FOLDERS = ("checkpoints", "pool", "ghosts", "films")  # of training, in a run folder
# what `replacing` leaves of a file of training when it is killed; exports have other endings
_UNFINISHED = re.compile(
    r"\.(.+\.(json|csv|safetensors|npz)|\d+\.gif|SHA256SUMS|curve\.(png|svg)|report\.html|card\.md)\.\d+(\.part)?"
)


class RunFolder:
    """One run on disk.

    path: the folder
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    @classmethod
    def create(cls, runs: str | Path, config: "RunConfig") -> "RunFolder":
        """Return a new folder with configuration and versions."""
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        name = f"{_title(config)}-s{config.seed}-{stamp}"
        try:
            run = cls(_made(Path(runs) / name))
            (run.path / "checkpoints").mkdir()
        except OSError as error:
            raise ConfigError(
                f"cannot make a run folder in {runs}: {error.strerror}. Name another with --runs."
            ) from error
        with write_errors(run.path / "versions.json"):
            _write_json(run.path / "versions.json", versions())
        run.write_config(config)  # last: it makes the folder a run
        return run

    @classmethod
    def find(cls, name: str | Path, runs: str | Path = "runs", recipe: str = "") -> "RunFolder":
        """Return a run by path or by its name in `runs`, or a beginning of it that no other has.

        "last" is the newest with a checkpoint.
        """
        if str(name) == "last":
            return cls(_newest(Path(runs), recipe))
        return cls(existing_run(name, runs))

    def settings(self) -> dict[str, Any]:
        """Return the configuration as written, for any algorithm."""
        check_summed(self.path / "config.json")
        return _read_json(self.path / "config.json")

    def config(self, model: "type[C]") -> "C":
        """Return the configuration."""
        from spikedeploy.trainers.config import validated

        return validated(model, self.settings(), str(self.path))

    def write_config(self, config: "RunConfig") -> None:
        """Write the configuration."""
        file = self.path / "config.json"
        with write_errors(file):
            write_summed(file, _json(config.model_dump(mode="json")).encode())

    def checkpoint(self, name: str) -> Path:
        """Return the path of a checkpoint, whether or not it exists."""
        return self.path / "checkpoints" / f"{name}.safetensors"

    @property
    def metrics(self) -> Path:
        """Path of the metrics."""
        return self.path / "metrics.csv"

    @property
    def replay(self) -> Path:
        """Path of the replay buffer."""
        return self.path / "replay.safetensors"

    @property
    def next_replay(self) -> Path:
        """Path of the replay buffer of the checkpoint that is being written."""
        return self.path / "replay.next.safetensors"

    def save(
        self,
        name: str,
        policy: "Policy",
        state: Mapping[str, Any],
        tensors: "Mapping[str, Tensor] | None" = None,
    ) -> None:
        """Write a checkpoint: the policy, its state as JSON, and more tensors."""
        from safetensors.torch import save_file

        record = {"policy": policy.spec(), **state}
        weights = {_POLICY + key: value for key, value in policy.state_dict().items()}
        everything = {
            key: value.contiguous() for key, value in {**weights, **(tensors or {})}.items()
        }
        record["sha256"] = _digest(record, everything)
        path = self.checkpoint(name)
        with write_errors(path):
            with replacing(path) as temporary:
                # the state is part of the same file, so that the two always belong together
                save_file(everything, temporary, metadata={"state": json.dumps(record)})
            _write_json(path.with_suffix(".json"), record)

    def settle(self, name: str, state: Mapping[str, Any]) -> None:
        """Write the numbers to read of a checkpoint where a kill came before them."""
        path = self.checkpoint(name).with_suffix(".json")
        if not path.is_file() or path.read_text(encoding="utf-8") != _json(state):
            with write_errors(path):
                _write_json(path, state)

    def load(self, name: str) -> "tuple[dict[str, Any], dict[str, Tensor]]":
        """Return state and tensors of a checkpoint."""
        from safetensors import SafetensorError, safe_open

        path = self.checkpoint(name)
        if not path.is_file():
            self.check_weights(name)
            raise ConfigError(f"{self.path} has no checkpoint '{name}' yet")
        try:
            with safe_open(path, "pt") as file:
                state: dict[str, Any] = json.loads(file.metadata()["state"])
                tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
            # those of before have none
            if state.get("sha256") not in (None, _digest(state, tensors)):
                raise ValueError("its content does not have its checksum")
        except (SafetensorError, OSError, KeyError, TypeError, AttributeError, ValueError) as error:
            raise ConfigError(
                f"{path} is not a valid checkpoint: {error}. {self._remedy(name)}"
            ) from error
        return state, tensors

    def check_weights(self, name: str) -> None:
        """Refuse a checkpoint whose numbers to read are here, and whose weights are not.

        The numbers are written after the weights. So somebody deleted these, or did not keep them.
        """
        path = self.checkpoint(name)
        if path.with_suffix(".json").is_file() and not path.is_file():
            raise ConfigError(
                f"{path} is missing, so that the run cannot be resumed or exported. "
                f"{self._remedy(name)}"
            )

    def _remedy(self, name: str) -> str:
        """Return what can be saved of a run whose checkpoint is damaged or missing."""
        others = sorted(path.stem for path in (self.path / "checkpoints").glob("*.safetensors"))
        others = [each for each in others if each != name]
        anew = "Put the file back, or train again"
        if not others:
            return f"{anew}."
        saved = f"`spikedeploy export {self.path} --checkpoint {others[0]}`"
        return f"{anew}; the checkpoint '{others[0]}' is a file of its own: {saved}."

    def forget(self, counter: str, first: int) -> None:
        """Delete what a run left that was killed before its first checkpoint "last".

        counter: name of the step in checkpoints
        first: steps after which a checkpoint is due
        """
        left = sorted((self.path / "checkpoints").glob("*.safetensors"))
        for path in left:
            # a validation may come just before the first checkpoint; this one is from long after
            if self.load(path.stem)[0].get(counter, 0) >= 2 * first:
                raise ConfigError(
                    f"{self.checkpoint('last')} is missing, so that the run cannot be resumed: put "
                    f"it back, or train again; `spikedeploy export {self.path} --checkpoint "
                    f"{path.stem}` still has a policy."
                )
        for path in (*left, *(path.with_suffix(".json") for path in left)):
            path.unlink(missing_ok=True)

    def sweep(self) -> None:
        """Delete unfinished files of processes that were killed; the run must be locked."""
        for folder in (self.path, *(self.path / name for name in _FOLDERS)):
            for path in folder.glob(".*"):
                if _UNFINISHED.fullmatch(path.name):
                    path.unlink(missing_ok=True)

    def policy(self, name: str = "best") -> "Policy":
        """Return the policy of a checkpoint, ready to act."""
        from spikedeploy.trainers.policies import build

        state, tensors = self.load(name)
        policy = build(state["policy"])
        policy.load_state_dict(
            {key.removeprefix(_POLICY): t for key, t in tensors.items() if key.startswith(_POLICY)}
        )
        return policy.eval().requires_grad_(False)


def load_policy(run: str | Path, name: str | None = None, runs: str | Path = "runs") -> "Policy":
    """Return a run's policy: of the named checkpoint, else of the best, else of the last."""
    folder = RunFolder.find(run, runs)
    if name is None:
        name = "best" if folder.checkpoint("best").is_file() else "last"
    return folder.policy(name)


def _title(config: "RunConfig") -> str:
    """Return the recipe; of one for any environment with that, in letters that a path may have."""
    entry = RECIPES.get(config.recipe)
    if entry is None or not entry.any_env:
        return config.recipe
    return f"{config.recipe}-{re.sub(r'[^A-Za-z0-9.-]+', '-', config.env.name)}"


def _made(path: Path) -> Path:
    """Make the folder, with a number appended if it exists, and return it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for k in range(1000):
        named = path.with_name(f"{path.name}-{k}") if k else path
        with suppress(FileExistsError):
            named.mkdir()
            return named
    raise FileExistsError(errno.EEXIST, "exists, and so do 999 beside it", str(path))


def _newest(runs: Path, recipe: str) -> Path:
    """Return the folder of the newest run with a checkpoint, of a recipe if given."""
    found = [file.parent for file in runs.glob("*/config.json")]
    if recipe:
        found = [path for path in found if _read_json(path / "config.json")["recipe"] == recipe]
    usable = [path for path in found if any(path.glob("checkpoints/*.safetensors"))]
    if not usable:
        none = f"; {len(found)} without a checkpoint" if found else ""
        raise ConfigError(
            f"no run{f' of recipe {recipe}' if recipe else ''} in {runs}/{none}: train one first"
        )
    return max(usable, key=lambda path: (path / "config.json").stat().st_mtime_ns)


def _read_json(path: Path) -> dict[str, Any]:
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"cannot read {path}: it holds no JSON object")
    return data


def _json(data: Mapping[str, Any]) -> str:
    return json.dumps(data, indent=2) + "\n"


def _write_json(path: Path, data: Mapping[str, Any]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(_json(data), encoding="utf-8")


def _digest(state: Mapping[str, Any], tensors: "Mapping[str, Tensor]") -> str:
    """Return the SHA-256 of everything that a checkpoint holds."""
    import torch

    numbers = {key: value for key, value in state.items() if key != "sha256"}
    digest = hashlib.sha256(json.dumps(numbers).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()
