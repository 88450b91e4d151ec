"""The records of a run folder: configuration, versions, checkpoint; read without torch."""

import json
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from spikedeploy.policies.interface import env_id
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.versions import own


def settings(run: Path) -> dict[str, Any]:
    """The resolved configuration of a run."""
    return _read(run / "config.json")


def versions(run: Path) -> dict[str, str | None]:
    """The package versions of a run, and its commit."""
    return _read(run / "versions.json")


def _checkpoint(run: Path) -> dict[str, Any]:
    """The record of the deployed checkpoint: the best, else the last."""
    best, last = (run / "checkpoints" / f"{name}.json" for name in ("best", "last"))
    return _read(best if best.is_file() else last)


def origin(run: Path) -> Provenance:
    """The provenance of the run's policy, for an exported file."""
    config = settings(run)
    return Provenance(
        env=env_id(config["env"]["name"]) or "",
        recipe=config["recipe"],
        seed=config["seed"],
        steps=_checkpoint(run).get("env_steps", 0),
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        version=own(),
    )


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise ConfigError(f"{path.parent} is no run folder: it has no {path.name}")
    record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return record
