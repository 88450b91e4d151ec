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
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.atomic import replacing
from spikedeploy.trainers.checksums import check_summed, write_summed
from spikedeploy.trainers.config import C, RunConfig
from spikedeploy.trainers.policies import Policy, build
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.resolve import validated
from spikedeploy.trainers.run_names import existing_run
from spikedeploy.trainers.versions import versions
from spikedeploy.trainers.write_errors import said

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
    def create(cls, runs: str | Path, config: RunConfig) -> "RunFolder":
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
        with said(run.path / "versions.json"):
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

    def config(self, model: type[C]) -> C:
        """Return the configuration."""
        return validated(model, self.settings(), str(self.path))

    def write_config(self, config: RunConfig) -> None:
        """Write the configuration."""
        file = self.path / "config.json"
        with said(file):
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
        policy: Policy,
        state: Mapping[str, Any],
        tensors: Mapping[str, Tensor] | None = None,
    ) -> None:
        """Write a checkpoint: the policy, its state as JSON, and more tensors."""
        record = {"policy": policy.spec(), **state}
        weights = {_POLICY + key: value for key, value in policy.state_dict().items()}
        everything = {
            key: value.contiguous() for key, value in {**weights, **(tensors or {})}.items()
        }
        record["sha256"] = _digest(record, everything)
        path = self.checkpoint(name)
        with said(path):
            with replacing(path) as temporary:
                # the state is part of the same file, so that the two always belong together
                save_file(everything, temporary, metadata={"state": json.dumps(record)})
            _write_json(path.with_suffix(".json"), record)

    def settle(self, name: str, state: Mapping[str, Any]) -> None:
        """Write the numbers to read of a checkpoint where a kill came before them."""
        path = self.checkpoint(name).with_suffix(".json")
        if not path.is_file() or path.read_text(encoding="utf-8") != _json(state):
            with said(path):
                _write_json(path, state)

    def load(self, name: str) -> tuple[dict[str, Any], dict[str, Tensor]]:
        """Return state and tensors of a checkpoint."""
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

    def policy(self, name: str = "best") -> Policy:
        """Return the policy of a checkpoint, ready to act."""
        state, tensors = self.load(name)
        policy = build(state["policy"])
        policy.load_state_dict(
            {key.removeprefix(_POLICY): t for key, t in tensors.items() if key.startswith(_POLICY)}
        )
        return policy.eval().requires_grad_(False)


def load_policy(run: str | Path, name: str | None = None, runs: str | Path = "runs") -> Policy:
    """Return a run's policy: of the named checkpoint, else of the best, else of the last."""
    folder = RunFolder.find(run, runs)
    if name is None:
        name = "best" if folder.checkpoint("best").is_file() else "last"
    return folder.policy(name)


def _title(config: RunConfig) -> str:
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


def _digest(state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> str:
    """Return the SHA-256 of everything that a checkpoint holds."""
    numbers = {key: value for key, value in state.items() if key != "sha256"}
    digest = hashlib.sha256(json.dumps(numbers).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()
