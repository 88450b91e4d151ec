"""AdaptedEnv: any gymnasium environment as policies expect one, with vectors in and out.

    observation  Box of any shape and bounds: its numbers in float64, unscaled, as policies have a
                 normaliser; Discrete: one-hot
    action       Box with finite bounds: from [-1, 1]; Discrete: from 0
    info         the numbers in it, and success where it is known

Other spaces, pictures, and actions without bounds are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec as Registration
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError

FloatArray: TypeAlias = NDArray[np.float64]
_LONGEST = 100_000  # control steps of an episode: without a time limit it might never end


class AdaptedEnv(gymnasium.Env[FloatArray, Any]):
    """An environment of somebody else.

    inner       as gymnasium made it
    name        as it was asked for
    given       options that make it again
    one_hot     whether it observes one of several
    CONTROL_DT  time of a control step [s]; None where it is not known
    """

    def __init__(
        self,
        inner: gymnasium.Env[Any, Any],
        name: str,
        given: Mapping[str, Any],
        success: str | None = None,
    ) -> None:
        self.inner, self.name, self.given = inner, name, given
        self.one_hot = isinstance(inner.observation_space, Discrete)
        self.metadata, self.render_mode = inner.metadata, inner.render_mode
        self.spec = Registration("Adapted-v0")
        self.spec.id = name  # not above: gymnasium parses names, not targets
        space, self._observed = _observed(name, inner.observation_space)
        self.observation_space: gymnasium.Space[Any] = space
        self.action_space, self._acted = _acted(name, inner.action_space)
        self.CONTROL_DT = _period(inner)
        self._key = success
        self._threshold = inner.spec.reward_threshold if inner.spec else None
        self._total, self._steps = 0.0, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Start an episode."""
        self._total, self._steps = 0.0, 0
        observation, info = self.inner.reset(seed=seed, options=options)
        return self._seen(observation), _numbers(info)

    def step(self, action: Any) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Take an action (act,) in [-1, 1], or an index from 0."""
        found, reward, terminated, truncated, info = self.inner.step(self._acted(action))
        self._total, self._steps = self._total + float(reward), self._steps + 1
        over = bool(terminated or truncated)
        if self._steps >= _LONGEST and not over:
            raise EnvError(
                f"{self.name}: an episode did not end in {_LONGEST:,} steps: give it a time "
                "limit with the option max_episode_steps=N"
            )
        numbers = {**_numbers(info), **self._success(info, over)}
        return self._seen(found), float(reward), bool(terminated), bool(truncated), numbers

    def render(self) -> Any:  # noqa: ANN401
        """The environment's picture."""
        return self.inner.render()

    def close(self) -> None:
        """Close the environment."""
        self.inner.close()

    def _seen(self, observation: Any) -> FloatArray:  # noqa: ANN401
        vector = self._observed(observation)
        if vector.shape != self.observation_space.shape or not np.isfinite(vector).all():
            raise EnvError(
                f"{self.name}: observation of step {self._steps} is no vector of "
                f"{self.observation_space.shape} finite numbers: {vector}"
            )
        return vector

    def _success(self, info: Mapping[str, Any], over: bool) -> dict[str, bool]:
        """Success so far, by the key that was named, or else by the reward threshold."""
        if self._key is None:
            return {} if self._threshold is None else {"success": self._total >= self._threshold}
        if over and self._key not in info:
            raise EnvError(
                f"{self.name}: --success {self._key}: the info of the last step has no such key; "
                f"it has {', '.join(map(str, info)) or 'none'}"
            )
        return {"success": bool(info.get(self._key, False))}


def _observed(name: str, space: gymnasium.Space[Any]) -> tuple[Box, Callable[[Any], FloatArray]]:
    """The space of observations (obs,), and the map into it."""
    if isinstance(space, Discrete):
        rows, start = np.eye(int(space.n)), int(space.start)
        return Box(0.0, 1.0, (len(rows),), np.float64), lambda seen: rows[int(seen) - start]
    if not isinstance(space, Box):
        raise EnvError(
            f"{name} observes a {type(space).__name__}, and policies observe one vector: make it "
            "with gymnasium.wrappers.FlattenObservation in a function of yours, and name that as "
            "module:function"
        )
    if space.dtype == np.uint8 and len(space.shape) > 1:
        raise EnvError(
            f"{name} observes pictures {space.shape}, and policies observe one vector of numbers: "
            "make it with a gymnasium.ObservationWrapper that measures what matters in them"
        )
    size = int(np.prod(space.shape))
    return Box(-np.inf, np.inf, (size,), np.float64), _flat


def _flat(observation: Any) -> FloatArray:  # noqa: ANN401
    return np.array(observation, np.float64).reshape(-1)


def _acted(name: str, space: gymnasium.Space[Any]) -> tuple[Box | Discrete, Callable[[Any], Any]]:
    """The space of actions, (act,) in [-1, 1] or an index from 0, and the map out of it."""
    if isinstance(space, Discrete):
        start = int(space.start)
        return Discrete(int(space.n)), lambda action: int(action) + start
    if not isinstance(space, Box):
        raise EnvError(
            f"{name} takes actions of a {type(space).__name__}, and policies put out one vector or "
            "one choice: make it with a gymnasium.ActionWrapper whose action_space is a Box or "
            "Discrete, in a function of yours, and name that as module:function"
        )
    low, high = _flat(space.low), _flat(space.high)
    if unbounded := np.flatnonzero(~np.isfinite(high - low)).tolist():
        raise EnvError(
            f"{name}: actions {unbounded} have no finite bounds, so that [-1, 1] cannot be scaled "
            "to them: make it with an action_space that has bounds"
        )
    return Box(-1.0, 1.0, low.shape, np.float64), _scaling(space, low, high)


def _scaling(space: Box, low: FloatArray, high: FloatArray) -> Callable[[Any], NDArray[Any]]:
    """The map from [-1, 1] (act,) to a box, in its shape and type."""
    whole = np.issubdtype(space.dtype, np.integer)

    def scaled(action: Any) -> NDArray[Any]:  # noqa: ANN401
        # a = low + (x + 1) / 2 (high - low)
        share = (np.clip(np.asarray(action, np.float64), -1.0, 1.0) + 1.0) / 2.0
        value = low + share * (high - low)
        return (np.rint(value) if whole else value).astype(space.dtype).reshape(space.shape)

    return scaled


def _period(env: gymnasium.Env[Any, Any]) -> float | None:
    """Time of a control step [s]: CONTROL_DT or dt of the environment, else 1 / render_fps."""
    world: Any = env.unwrapped
    rate = env.metadata.get("render_fps")
    choices = (getattr(world, "CONTROL_DT", None), getattr(world, "dt", None), rate and 1.0 / rate)
    return next((float(t) for t in choices if isinstance(t, int | float) and t > 0), None)


def _numbers(info: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of an info, as Python has them."""
    plain = {str(key): v.item() if isinstance(v, np.generic) else v for key, v in info.items()}
    return {key: v for key, v in plain.items() if isinstance(v, bool | int | float)}
