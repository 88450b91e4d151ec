"""Wrappers that draw: from the seed of the episode, apart from the draws of the environment."""

from __future__ import annotations

from typing import Any, ClassVar
from zlib import crc32

import gymnasium
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_STREAM = 11  # keeps the draws apart from those of environments and policies with the same seed


class SeededWrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A wrapper with a generator of its own; a reset without a seed goes on with it.

    STREAM  keeps the draws of kinds of disturbances apart
    """

    STREAM: ClassVar[str]

    def __init__(self, env: gymnasium.Env[Any, Any], number: float) -> None:
        super().__init__(env)
        self.number = number
        self.rng = np.random.default_rng()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode; `_begin` draws what is constant in it."""
        if seed is not None:
            self.rng = np.random.default_rng([seed, _STREAM, crc32(self.STREAM.encode())])
        observation, info = self.env.reset(seed=seed, options=options)
        return self._begin(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """A step in which commands or observations are disturbed."""
        observation, reward, terminated, truncated, info = self.env.step(self._command(action))
        return self._observed(observation), reward, terminated, truncated, info

    def _begin(self, observation: FloatArray) -> FloatArray:
        """The first observation as the policy sees it."""
        return observation

    def _command(self, action: Any) -> Any:  # noqa: ANN401
        """The action as it arrives."""
        return action

    def _observed(self, observation: FloatArray) -> FloatArray:
        """An observation as the policy sees it."""
        return observation


def columns(env: gymnasium.Env[Any, Any], *without: str) -> NDArray[np.intp]:
    """Places (k,) of what sensors measure in an observation, without some entries of it.

    Last command, gait phase and the command to follow are the controller's own: nothing that
    happens to sensors changes them. Of an environment of other people everything is measured.
    """
    entries: dict[str, slice] | None = getattr(env.unwrapped, "OBSERVATION", None)
    if entries is None:
        return np.arange((env.observation_space.shape or (0,))[0])
    places = [
        np.arange(place.start, place.stop)
        for name, place in entries.items()
        if name not in (*_OWN, *without)
    ]
    return np.concatenate(places)


_OWN = ("previous", "phase", "command")
