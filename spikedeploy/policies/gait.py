"""The built-in `gait`: zero actions, which leave the environment's own gait unchanged."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.rollout import Rollout
from spikedeploy.policies.costs import NOTHING, Costs
from spikedeploy.policies.interface import Candidate
from spikedeploy.runtime.errors import ConfigError


class ZeroController:
    """A controller whose actions are zeros (act,)."""

    def __init__(self, actions: int) -> None:
        self.actions = actions

    def reset(self, seed: int) -> None:
        """Nothing to reset."""

    def act(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Zeros (act,)."""
        return np.zeros(self.actions)

    def replay(self, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Zeros (S, act) for the observations (S, obs) of an episode."""
        return np.zeros((len(observations), self.actions))


def describe(path: Path) -> Candidate:
    """The candidate; `path` is the built-in's name."""
    return Candidate(path=str(path), name="gait", kind="gait", format="gait")


def controller(
    candidate: Candidate, chip: str | None, env: gymnasium.Env[Any, Any], sampled: bool
) -> ZeroController:
    """A controller for an environment with continuous actions."""
    space = env.action_space
    if not isinstance(space, gymnasium.spaces.Box):
        raise ConfigError("the gait is for robots that have one, with actions that are numbers")
    return ZeroController(space.shape[0])


def costs(controller: ZeroController, played: Rollout) -> Costs:
    """Nothing is computed."""
    return NOTHING
