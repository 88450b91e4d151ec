"""The episodes of training: one row of a CSV file for each, in the order in which they ended."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.trainers.collect import Steps
from spikedeploy.trainers.metrics import Metrics

OUTCOMES = ("finish", "crash", "gates", "lap_time")  # of the last info, where the world has them
COLUMNS = ("env_steps", "steps", "return", "success", *OUTCOMES)


class EpisodeLog:
    """Counts what every copy does, and writes a row when an episode of it ends.

    finishes: finished episodes so far
    """

    def __init__(self, path: Path, copies: int, finishes: int = 0) -> None:
        self._file = Metrics(path, COLUMNS)
        self._steps, self._totals = np.zeros(copies, np.int64), np.zeros(copies)
        self.finishes = finishes

    def rewind(self, env_steps: int) -> None:
        """Forget the episodes that ended later, on resuming."""
        self._file.rewind(env_steps)

    def add(self, steps: Steps, env_steps: int) -> None:
        """Take in one step of every copy; `env_steps` counts those before it, of all copies."""
        self._steps += 1
        self._totals += steps.reward
        for k in np.flatnonzero(steps.terminated | steps.truncated):
            # copies are stepped one after the other, so this is the step that ended the episode
            self._end(int(k), steps.infos[k], env_steps + int(k) + 1)

    def _end(self, k: int, info: Mapping[str, Any], env_steps: int) -> None:
        row = {
            "env_steps": env_steps,
            "steps": int(self._steps[k]),
            "return": float(self._totals[k]),
            "success": float(info.get("success", False)),
            **{name: float(info[name]) for name in OUTCOMES if name in info},
        }
        self._file.add(row)
        self.finishes += int(row.get("finish", 0.0))
        self._steps[k], self._totals[k] = 0, 0.0
