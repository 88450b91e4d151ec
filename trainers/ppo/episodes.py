"""Logs of training episodes: a CSV file of results, and ghosts for `spikedeploy replay`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.ghosts import POSE, GhostRecorder
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.env_batch import EnvBatch, Steps
from spikedeploy.trainers.metrics import Metrics
from spikedeploy.trainers.tables import Table
from spikedeploy.trainers.write_errors import said

_OUTCOMES = ("finish", "crash", "gates", "lap_time")  # of the last info, if it has them
_COLUMNS = ("env_steps", "steps", "return", "success", *_OUTCOMES)


def episode_table(run: Path) -> Table:
    """Return the table of a run's episodes."""
    return Table(run / "episodes.csv", _COLUMNS, "episode_logged")


class EpisodeLog:
    """CSV file with a row for each episode, in the order in which they end.

    finishes: episodes so far that ended at the finish
    latest: environment steps at the last row, None before there is one
    """

    latest: int | None = None

    def __init__(self, run: Path, copies: int, finishes: int = 0) -> None:
        self._file = Metrics(episode_table(run).path, _COLUMNS)
        self._steps, self._totals = np.zeros(copies, np.int64), np.zeros(copies)
        self.finishes = finishes

    def rewind(self, env_steps: int) -> None:
        """Drop the rows after a step, on resuming from it."""
        self._file.rewind(env_steps)

    def begin(self, k: int) -> None:
        """Forget what copy k did: its episode begins."""
        self._steps[k], self._totals[k] = 0, 0.0

    def repeat(self, k: int, reward: float) -> None:
        """Count a step of copy k that is repeated when a run is resumed."""
        self._steps[k] += 1
        self._totals[k] += reward

    def add(self, steps: Steps, env_steps: int) -> None:
        """Add one step of every copy, taken after `env_steps` environment steps in total."""
        self._steps += 1
        self._totals += steps.reward
        for k in np.flatnonzero(steps.terminated | steps.truncated):
            # copies are stepped in order, so that this is the number of the step that ended it
            self._end(int(k), steps.infos[k], env_steps + int(k) + 1)

    def _end(self, k: int, info: Mapping[str, Any], env_steps: int) -> None:
        row = {
            "env_steps": env_steps,
            "steps": int(self._steps[k]),
            "return": float(self._totals[k]),
            "success": float(info.get("success", False)),
            **{name: float(info[name]) for name in _OUTCOMES if name in info},
        }
        self._file.add(row)
        self.finishes += int(row.get("finish", 0.0))
        self.latest = env_steps
        self.begin(k)


def has_poses(batch: EnvBatch) -> bool:
    """Return whether the environment's infos hold poses, which ghosts need."""
    return all(name in start.info for start in batch.starts for name in POSE)


class GhostLog:
    """Ghosts of every copy, in one file <iteration>.npz for each iteration.

    folder: of the files
    """

    def __init__(self, folder: Path, batch: EnvBatch, config: EnvConfig) -> None:
        self._folder, self._batch = folder, batch
        self._recorder = GhostRecorder(batch.env_id, config.options, len(batch))
        for k in range(len(batch)):
            self.begin(k)

    def add(self, steps: Steps, env_steps: int) -> None:
        """Add one step of every copy, taken after `env_steps` environment steps in total."""
        ended = steps.terminated | steps.truncated
        for k, info in enumerate(steps.infos):
            self._recorder.add(k, info, steps.action[k], float(steps.reward[k]))
        for k in np.flatnonzero(ended).tolist():
            self._recorder.end(k, env_steps + k + 1)
            self.begin(k)

    def save(self, iteration: int) -> None:
        """Write the episodes that ended since the last file, if any."""
        ghosts = self._recorder.take()
        path = self._folder / f"{iteration:05d}.npz"
        if ghosts.drives:
            with said(path):
                ghosts.save(path)

    def rewind(self, iteration: int) -> None:
        """Delete the files after an iteration, on resuming from it."""
        for path in self._folder.glob("*.npz"):
            # what somebody else put there has another name, and stays
            if path.stem.isdecimal() and int(path.stem) > iteration:
                path.unlink()

    def repeat(self, k: int, action: NDArray[Any], reward: float, info: Mapping[str, Any]) -> None:
        """Record a step of copy k that is repeated when a run is resumed."""
        self._recorder.add(k, info, action, reward)

    def begin(self, k: int) -> None:
        """Record the reset of copy k."""
        start = self._batch.starts[k]
        self._recorder.begin(k, start.info, start.seed)
