"""Records ghosts of environments that are stepped side by side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.ghosts import Ghost, Ghosts

POSE = ("x", "y", "heading", "speed")


class GhostRecorder:
    """Collects the resets and steps of several environments into ghosts.

    env_id   gymnasium's identifier
    options  of the environments
    copies   number of environments
    """

    def __init__(self, env_id: str, options: Mapping[str, Any], copies: int = 1) -> None:
        self._env_id, self._options = env_id, dict(options)
        self._copies = [_Drive() for _ in range(copies)]
        self._ended: list[Ghost] = []

    def begin(self, copy: int, info: Mapping[str, Any], seed: int = -1) -> None:
        """Record a reset; the info, or any other mapping, holds the initial POSE."""
        self._copies[copy] = _Drive(info, seed)

    def add(
        self, copy: int, info: Mapping[str, Any], action: NDArray[Any] | float, reward: float
    ) -> None:
        """Record a step."""
        self._copies[copy].add(info, action, reward)

    def end(self, copy: int, env_step: int = 0) -> None:
        """Finish the episode of a copy, after `env_step` environment steps of the training."""
        self._ended.append(self._copies[copy].ghost(env_step))

    def take(self) -> Ghosts:
        """Ghosts of the episodes that ended since the last call, in that order."""
        ended, self._ended = self._ended, []
        return Ghosts(self._env_id, ended, self._options)


class _Drive:
    """An unfinished episode."""

    def __init__(self, info: Mapping[str, Any] | None = None, seed: int = -1) -> None:
        self._path = [] if info is None else [_pose(info)]
        self._actions: list[NDArray[Any]] = []
        self._rewards: list[float] = []
        self._last: Mapping[str, Any] = {}
        self._seed = seed

    def add(self, info: Mapping[str, Any], action: NDArray[Any] | float, reward: float) -> None:
        if not self._path:
            raise EnvError("a ghost needs the pose at reset: call begin before add")
        self._path.append(_pose(info))
        self._actions.append(np.array(action))
        self._rewards.append(reward)
        self._last = info

    def ghost(self, env_step: int) -> Ghost:
        path = np.array(self._path, np.float32)
        return Ghost(
            pose=path[:, :3],
            speed=path[:, 3],
            action=np.array(self._actions),
            reward=np.array(self._rewards, np.float32),
            finish=bool(self._last.get("finish", False)),
            crash=bool(self._last.get("crash", False)),
            gates=int(self._last.get("gates", 0)),
            env_step=env_step,
            seed=self._seed,
        )


def _pose(info: Mapping[str, Any]) -> tuple[float, ...]:
    try:
        return tuple(float(info[name]) for name in POSE)
    except KeyError as error:
        raise EnvError(f"a ghost needs {', '.join(POSE)} in the info; {error} is missing") from None
