"""Many ghosts at once: all poses at a step in one array lookup."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.ghosts import Ghost

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class _GhostCounts:
    """Numbers of ghosts that drive, have finished, and have crashed, at a step."""

    driving: int
    finished: int
    crashed: int


class GhostGroup:
    """Ghosts that start together.

    drives   (n,)
    pushed   whether they have no heading, so that the direction of motion is shown
    length   steps of the longest
    age      (n,) from 0 for the first to 1 for the last: the progress of the training
    leader   index of the best: the fastest that finishes, else the one with the most gates
    """

    def __init__(self, drives: Sequence[Ghost], pushed: bool = False) -> None:
        self.drives = drives
        self.steps = np.array([ghost.steps for ghost in drives], np.int64)
        self.age = np.linspace(0.0, 1.0, len(drives))
        self.length = int(self.steps.max(initial=0))
        self.leader = max(range(len(drives)), key=self._rank, default=None)
        self._pose: Floats = np.concatenate(
            [np.zeros((0, 3), np.float32)] + [_with_headings(ghost, pushed) for ghost in drives]
        )
        self._first = np.cumsum(self.steps + 1) - self.steps - 1
        self._finish = np.array([ghost.finish for ghost in drives], bool)
        self._crash = np.array([ghost.crash for ghost in drives], bool)

    def poses(self, step: int) -> Floats:
        """x, y and heading (n, 3) at a step; the last pose after the end."""
        found: Floats = self._pose[self._first + np.minimum(step, self.steps)]
        return found

    def driving(self, step: int) -> NDArray[np.bool_]:
        """Ghosts that have not ended (n,)."""
        found: NDArray[np.bool_] = step < self.steps
        return found

    def ended(self, step: int, well: bool) -> NDArray[np.bool_]:
        """Ghosts that have finished (`well`), or crashed, by then (n,)."""
        found: NDArray[np.bool_] = ~self.driving(step) & (self._finish if well else self._crash)
        return found

    def count(self, step: int) -> _GhostCounts:
        """The counts at a step."""
        return _GhostCounts(
            driving=int(self.driving(step).sum()),
            finished=int(self.ended(step, True).sum()),
            crashed=int(self.ended(step, False).sum()),
        )

    def trail(self, step: int) -> Floats:
        """The path of the leader so far (k, 2)."""
        if self.leader is None:
            return np.zeros((0, 2), np.float32)
        return self.drives[self.leader].pose[: step + 1, :2]

    def _rank(self, index: int) -> tuple[bool, int, int]:
        ghost = self.drives[index]
        return ghost.finish, ghost.gates, -ghost.steps if ghost.finish else ghost.steps


def _with_headings(ghost: Ghost, pushed: bool) -> Floats:
    """Poses (S + 1, 3), with the direction of motion as heading if `pushed`."""
    if not pushed:
        return ghost.pose
    pose: Floats = ghost.pose.copy()
    moved = np.diff(pose[:, :2], axis=0, prepend=pose[:1, :2])
    pose[:, 2] = np.arctan2(moved[:, 1], moved[:, 0])
    return pose
