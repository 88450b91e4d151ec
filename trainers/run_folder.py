"""Run folder: all files of one training run.

<runs>/<recipe>-s<seed>-<date>-<time>/
    config.json          resolved configuration
    versions.json        of Python, packages and source tree
    metrics.csv          one row for each logging interval
    curve.png            learning curve
    replay.safetensors   replay buffer of an unfinished run
    checkpoints/{last,best}.safetensors, each with a .json of its numbers to read
"""

import json
import re
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.atomic import replacing
from spikedeploy.trainers.config import C, RunConfig
from spikedeploy.trainers.policies import Policy, build
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.resolve import validated
from spikedeploy.trainers.versions import versions

_POLICY = "policy."  # prefix of the policy's tensors


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
        run = cls(_unused(Path(runs) / name))
        (run.path / "checkpoints").mkdir(parents=True)
        run.write_config(config)
        _write_json(run.path / "versions.json", versions())
        return run

    @classmethod
    def find(cls, name: str | Path, runs: str | Path = "runs", recipe: str = "") -> "RunFolder":
        """Return a run by path or by name in `runs`; "last" is the newest with a checkpoint."""
        if str(name) == "last":
            return cls(_newest(Path(runs), recipe))
        for path in (Path(name), Path(runs) / name):
            if (path / "config.json").is_file():
                return cls(path)
        beside = "" if Path(name).is_absolute() else f", nor in {Path(runs) / name}"
        raise ConfigError(f"'{name}' is no run folder: no config.json in it{beside}")

    def settings(self) -> dict[str, Any]:
        """Return the configuration as written, for any algorithm."""
        return _read_json(self.path / "config.json")

    def config(self, model: type[C]) -> C:
        """Return the configuration."""
        return validated(model, self.settings(), str(self.path))

    def write_config(self, config: RunConfig) -> None:
        """Write the configuration."""
        _write_json(self.path / "config.json", config.model_dump(mode="json"))

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
        path = self.checkpoint(name)
        with replacing(path) as temporary:
            # the state is part of the same file, so that the two always belong together
            save_file(everything, temporary, metadata={"state": json.dumps(record)})
        _write_json(path.with_suffix(".json"), record)

    def load(self, name: str) -> tuple[dict[str, Any], dict[str, Tensor]]:
        """Return state and tensors of a checkpoint."""
        path = self.checkpoint(name)
        if not path.is_file():
            raise ConfigError(f"{self.path} has no checkpoint '{name}' yet")
        try:
            with safe_open(path, "pt") as file:
                state = json.loads(file.metadata()["state"])
                return state, {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        except (SafetensorError, KeyError, TypeError, ValueError) as error:
            raise ConfigError(f"{path} is not a valid checkpoint: {error}") from error

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


def _unused(path: Path) -> Path:
    """Return the path, with a number appended if it exists."""
    candidates = (path.with_name(f"{path.name}-{k}") if k else path for k in range(1000))
    return next(candidate for candidate in candidates if not candidate.exists())


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


def _write_json(path: Path, data: Mapping[str, Any]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
