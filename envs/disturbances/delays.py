"""Observations and commands that come late, and commands that are lost."""

from __future__ import annotations

from collections import deque
from typing import Any

import gymnasium
import numpy as np

from spikedeploy.envs.disturbances.kind import FOREIGN, HEXAPOD, KART, Kind
from spikedeploy.envs.disturbances.seeded import FloatArray, SeededWrapper, columns
from spikedeploy.envs.errors import EnvError

_LONGEST = 100  # [control steps]


def _steps(number: float) -> int:
    if number != int(number):
        raise EnvError(f"a delay of {number:g} control steps: give a whole number")
    return int(number)


class LateSensors(SeededWrapper):
    """What sensors measured some control steps ago; the first observation until then."""

    STREAM = "delay"

    def __init__(self, env: gymnasium.Env[Any, Any], number: float) -> None:
        super().__init__(env, number)
        self._places, self._delay = columns(env), _steps(number)

    def _begin(self, observation: FloatArray) -> FloatArray:
        now = observation[self._places]
        self._line = deque([now] * (self._delay + 1), self._delay + 1)
        return observation

    def _observed(self, observation: FloatArray) -> FloatArray:
        seen: FloatArray = observation.copy()
        self._line.append(observation[self._places])
        seen[self._places] = self._line[0]
        return seen


class LateCommands(SeededWrapper):
    """Commands that take effect some control steps later; until then there is none."""

    STREAM = "command-delay"

    def __init__(self, env: gymnasium.Env[Any, Any], number: float) -> None:
        super().__init__(env, number)
        self._delay = _steps(number)

    def _begin(self, observation: FloatArray) -> FloatArray:
        none = no_command(self.env)
        self._line = deque([none] * self._delay, self._delay + 1)
        return observation

    def _command(self, action: Any) -> Any:  # noqa: ANN401
        self._line.append(np.copy(action) if np.ndim(action) else action)
        return self._line.popleft()


class LostCommands(SeededWrapper):
    """Commands that are lost: the last one that arrived is held."""

    STREAM = "command-loss"

    def _begin(self, observation: FloatArray) -> FloatArray:
        self._held = no_command(self.env)
        return observation

    def _command(self, action: Any) -> Any:  # noqa: ANN401
        if self.rng.random() >= self.number:
            self._held = np.copy(action) if np.ndim(action) else action
        return self._held


def no_command(env: gymnasium.Env[Any, Any]) -> Any:  # noqa: ANN401
    """No residual of a walker; a kart's first action, which does nothing.

    Of other environments the middle of the bounds, or the first choice.
    """
    space = env.action_space
    return 0 if isinstance(space, gymnasium.spaces.Discrete) else np.zeros(space.shape or ())


DELAY = Kind(
    meaning="measurements that are seen late, the LIDAR's too",
    unit="control steps",
    levels={HEXAPOD: (1, 2, 3), KART: (1, 3, 6), FOREIGN: (1, 2, 3)},
    bounds=(0, _LONGEST),
    source="20 to 60 ms of a walker, where Tan et al. 2018 measured 15 to 19 ms and trained with 0 "
    "to 40; 17 to 100 ms of a kart",
    wrap=LateSensors,
)
COMMAND_DELAY = Kind(
    meaning="commands that take effect late",
    unit="control steps",
    levels={HEXAPOD: (1, 2, 3), KART: (1, 3, 6), FOREIGN: (1, 2, 3)},
    bounds=(0, _LONGEST),
    source="as the delay of measurements",
    wrap=LateCommands,
)
COMMAND_LOSS = Kind(
    meaning="commands that are lost: the last one that arrived is held",
    unit="probability of each",
    levels={HEXAPOD: (0.05, 0.2, 0.5), KART: (0.2, 0.5, 0.8), FOREIGN: (0.05, 0.2, 0.5)},
    bounds=(0.0, 1.0),
    source="chosen, as the dropout of measurements",
    wrap=LostCommands,
)
