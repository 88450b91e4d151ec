"""Sources of a replay: batches of ghosts, or one recorded rollout."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.envs.ghosts import Ghosts
from spikedeploy.envs.rollout import Rollout
from spikedeploy.runtime.errors import ConfigError


@dataclass(frozen=True)
class Source:
    """Batches of ghosts of one environment.

    name     for people
    env_id   gymnasium's identifier
    options  of the environment
    files    (n,) ghost files in order; empty for a rollout
    rollout  the recorded rollout, where the source is one
    """

    name: str
    env_id: str
    options: Mapping[str, Any]
    files: Sequence[Path] = ()
    rollout: Rollout | None = None

    def __len__(self) -> int:
        return len(self.files) if self.rollout is None else 1

    def batch(self, index: int) -> Ghosts:
        """The ghosts of one batch, cached."""
        if self.rollout is not None:
            return Ghosts.from_rollout(self.rollout)
        return _read(self.files[index])

    def everything(self) -> Ghosts:
        """The ghosts of all batches as one."""
        drives = [ghost for index in range(len(self)) for ghost in self.batch(index).drives]
        return Ghosts(self.env_id, drives, self.options)


def open_source(path: Path) -> Source:
    """The source in a run folder, a folder of ghost files, a ghost file or a rollout."""
    if path.is_dir():
        return _folder(path)
    if not path.is_file():
        raise ConfigError(f"{path}: no such run folder, ghost file or rollout")
    names = _names(path)
    if "observation" in names:
        played = Rollout.load(path)
        return Source(path.stem, played.env_id, played.options, rollout=played)
    ghosts = Ghosts.load(path)
    return Source(path.stem, ghosts.env_id, ghosts.options, (path,))


def _folder(path: Path) -> Source:
    folder = path / "ghosts" if (path / "ghosts").is_dir() else path
    files = sorted(folder.glob("*.npz"))
    if not files:
        raise ConfigError(
            f"{path}: no ghosts in it; the trainers of karts write them to ghosts/ of a run folder"
        )
    first = _read(files[0])
    return Source(path.resolve().name, first.env_id, first.options, files)


@lru_cache(maxsize=8)
def _read(path: Path) -> Ghosts:
    return Ghosts.load(path)


def _names(path: Path) -> list[str]:
    """The array names of a .npz file; empty for any other file, which its reader then refuses."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return list(getattr(archive, "files", []))
    except Exception:  # zipfile, zlib and numpy raise their own exceptions for a broken file
        return []
