"""The pool of a run on disk: a file of walks for each collection, checked when it is read."""

from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.checksums import of_file
from spikedeploy.trainers.distill.teachers import same_teacher
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import Walk, load_walks

Sizes = tuple[int, int]  # observations and actions


def pool_file(run: Path, number: int) -> Path:
    """Return the path of a collection's walks, whether or not it exists."""
    return run / "pool" / f"{number:03d}.safetensors"


def pool_files(run: Path, count: int) -> list[Path]:
    """Return the files of a run's first `count` collections, which it needs to be resumed."""
    files = [pool_file(run, number) for number in range(count)]
    if lost := [path for path in files if not path.is_file()]:
        raise ConfigError(
            f"{lost[0]} is missing: {run} has learned from its walks and cannot go on without "
            "them. Put the file back, or train again."
        )
    return files


def collected(files: list[Path], sums: list[str], sizes: Sizes) -> list[Walk]:
    """Return the walks of files that have these checksums."""
    for path, checksum in zip(files, sums, strict=True):
        if of_file(path) != checksum:
            raise ConfigError(
                f"{path} is damaged: its content does not have the checksum in checkpoints/last. "
                "Put the file back, or train again; the policies of the run are whole: "
                f"`spikedeploy export {path.parent.parent}`."
            )
    return [walk for path in files for walk in _fitting(path, sizes)]


def walks_of(config: SparseConfig, sizes: Sizes) -> list[Walk]:
    """Return the walks of the run that the setting `pool` names."""
    run = RunFolder.find(config.pool)
    files = sorted((run.path / "pool").glob("*.safetensors"))
    if not files:
        raise ConfigError(f"{config.pool} has no pool of walks. Give a run of a sparse recipe.")
    _check_task(config, run.settings())
    return [walk for path in files for walk in _fitting(path, sizes)]


def _check_task(config: SparseConfig, source: dict[str, Any]) -> None:
    """Refuse walks of another environment, or with labels of another teacher."""
    there, here = str(source["env"]["name"]), config.env.name
    if envs.spec(there).id != envs.spec(here).id:
        raise ConfigError(
            f"pool: {config.pool} has walks in {there}, not in {here}. Give a run of its task."
        )
    labelled = str(source["teacher"])
    if not same_teacher(labelled, config.teacher):
        raise ConfigError(
            f"pool: {config.pool} has walks labelled by the teacher {labelled}, and the teacher "
            f"here is {config.teacher}. Give a run with this teacher, or set teacher={labelled}."
        )


def _fitting(path: Path, sizes: Sizes) -> list[Walk]:
    """Return the walks of a file, with observations and labels (S, obs), (S, act), all finite."""
    walks = load_walks(path)
    for walk in walks:
        found = walk.observation.shape[1], walk.label.shape[1]
        if found != sizes:
            raise ConfigError(
                f"{path} has walks of {found[0]} observations and {found[1]} actions, expected "
                f"{sizes[0]} and {sizes[1]}. Give walks of the same environment."
            )
        if not (np.isfinite(walk.observation).all() and np.isfinite(walk.label).all()):
            raise ConfigError(
                f"{path} has an observation or label that is no finite number. Put a file back "
                "that is whole, or train again."
            )
    return walks
