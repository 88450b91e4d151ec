"""The drives of training, kept for `spikedeploy replay`: one file of ghosts for each iteration."""

from pathlib import Path

import numpy as np

from spikedeploy.envs.ghost_recorder import POSE, GhostRecorder
from spikedeploy.trainers.collect import EnvBatch, Steps
from spikedeploy.trainers.config import EnvConfig


def leaves_ghosts(batch: EnvBatch) -> bool:
    """Return whether the world says where its robots are."""
    return all(name in start.info for start in batch.starts for name in POSE)


class GhostLog:
    """Follows every copy, and writes the episodes that ended.

    folder: of <iteration>.npz
    """

    def __init__(self, folder: Path, batch: EnvBatch, config: EnvConfig) -> None:
        self._folder, self._batch = folder, batch
        self._recorder = GhostRecorder(batch.env_id, config.options, len(batch))
        for k in range(len(batch)):
            self._begin(k)

    def add(self, steps: Steps, env_steps: int) -> None:
        """Take in one step of every copy; `env_steps` counts those before it, of all copies."""
        ended = steps.terminated | steps.truncated
        for k, info in enumerate(steps.infos):
            self._recorder.add(k, info, steps.action[k], float(steps.reward[k]))
        for k in np.flatnonzero(ended).tolist():
            self._recorder.end(k, env_steps + k + 1)
            self._begin(k)

    def save(self, iteration: int) -> None:
        """Write the episodes that ended since the last file, if any did."""
        ghosts = self._recorder.take()
        if ghosts.drives:
            ghosts.save(self._folder / f"{iteration:05d}.npz")

    def rewind(self, iteration: int) -> None:
        """Forget the files after an iteration, on resuming from it."""
        for path in self._folder.glob("*.npz"):
            if int(path.stem) > iteration:
                path.unlink()

    def _begin(self, k: int) -> None:
        start = self._batch.starts[k]
        self._recorder.begin(k, start.info, start.seed)
