"""The run that PPO goes on from: found by the setting `start`, checked, stored so that it moves.

A run folder stores its start relative to the folder that holds both, so that they can be moved
together; a start elsewhere is stored as an absolute path.
"""

from pathlib import Path

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.policies import DeltaMlpPolicy, Policy
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.phases import LEVEL
from spikedeploy.trainers.sparse_ppo.config import SparsePpoConfig


def find_start(start: str, runs: Path) -> RunFolder:
    """Return the run that `start` of a run in the folder `runs` names.

    Where an absolute path has gone, a folder of that name beside the run is taken.
    """
    for path in (runs / start, Path(start), Path("runs") / start, runs / Path(start).name):
        if (path / "config.json").is_file():
            return RunFolder(path)
    return RunFolder.find(start)


def stored_start(start: RunFolder, runs: Path) -> str:
    """Return `start` as the run folder stores it."""
    # the last part stays as it is, which may be a link into another folder
    path, folder = start.path.parent.resolve() / start.path.name, runs.resolve()
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)


def starting_point(config: SparsePpoConfig, runs: Path) -> tuple[RunFolder, SparseConfig, Policy]:
    """Return the run to start from, its configuration with the budget of the policy, the policy."""
    if not config.start:
        raise ConfigError(
            f"{config.recipe} needs a finished run: --set start=RUN, where RUN is the run folder "
            "of a sparse recipe for the same task"
        )
    run = find_start(config.start, runs)
    if (found := run.settings()["algorithm"]) != "sparse":
        raise ConfigError(
            f"start: {config.start} is a run of {found}. Give one of a sparse recipe."
        )
    source = run.config(SparseConfig)
    if source.env.name != config.env.name:
        raise ConfigError(
            f"start: {config.start} was trained in {source.env.name}, not in {config.env.name}. "
            "Take the recipe of its task."
        )
    level = config.start_checkpoint
    if not run.checkpoint(level).is_file():
        raise ConfigError(_no_policy(config, run))
    policy = run.policy(level)
    if isinstance(policy, DeltaMlpPolicy):
        raise ConfigError(
            f"start: {config.start} has sigma-delta neurons, with which PPO cannot go on. "
            "Give a run with LIF neurons or of a float network."
        )
    if level.startswith(LEVEL):
        source = source.model_copy(update={"budget": float(level.removeprefix(LEVEL))})
    return run, source, policy


def _no_policy(config: SparsePpoConfig, run: RunFolder) -> str:
    level = config.start_checkpoint
    if level == "best":
        return (
            f"start: {config.start} has no policy at its budget yet. Wait until it ends, or "
            "continue it with --resume."
        )
    found = sorted(path.stem for path in run.checkpoint(level).parent.glob(f"{LEVEL}*.safetensors"))
    return (
        f"start_checkpoint: {config.start} has no policy {level!r}. It has "
        f"{', '.join(found) or 'none of any level yet'}."
    )
