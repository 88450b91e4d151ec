"""Environment steps at which episodes of a training, or of its validations, finished."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikedeploy.trainers.metrics import read
from spikedeploy.trainers.ppo import HOLDS

Steps = NDArray[np.float64]


def finishes(episodes: Path) -> Steps:
    """Environment steps (n,) at the end of each finished episode in an episodes.csv, in order."""
    if not episodes.is_file():
        return np.empty(0)
    rows = read(episodes)
    return np.sort([row["env_steps"] for row in rows if row.get("finish")])


def steps_to(count: int, steps: Steps) -> float:
    """Environment steps to the finish number `count`; infinite if it was never reached."""
    return float(steps[count - 1]) if len(steps) >= count else math.inf


def steps_to_greedy(share: float, metrics: Path) -> float:
    """Environment steps to the first validation in which `share` of the greedy episodes finish.

    It counts only if the next validation says so, too, or if there is none. Infinite where none is.
    """
    if not metrics.is_file():
        return math.inf
    found = [row for row in read(metrics) if "eval_finish" in row]
    enough = [row["eval_finish"] >= share for row in found]
    for place, row in enumerate(found):
        if all(enough[place : place + HOLDS]):
            return row["env_steps"]
    return math.inf


def finished_by(steps: Steps, grid: Steps) -> NDArray[np.int64]:
    """Finishes up to each step of the grid (g,)."""
    return np.searchsorted(steps, grid, side="right")


@dataclass(frozen=True)
class _TrainingProgress:
    """The progress of a training.

    steps     environment steps
    finishes  finished episodes
    """

    steps: int
    finishes: int


def progress_of(folder: Path, name: str) -> _TrainingProgress | None:
    """The last logged progress of the newest run of this name; None before the first line."""
    found = sorted(folder.glob(f"{name}-*/metrics.csv"))
    head, *lines = found[-1].read_text(encoding="utf-8").splitlines() if found else [""]
    names, values = head.split(","), (lines[-1] if lines else "").split(",")
    row = dict(zip(names, values, strict=False))
    if not row.get("env_steps") or not row.get("finishes"):
        return None
    return _TrainingProgress(int(float(row["env_steps"])), int(float(row["finishes"])))
