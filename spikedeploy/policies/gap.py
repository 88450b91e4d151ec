"""The built-in `gap`: a script that follows the gap in the LIDAR; nothing is learned."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.kart.gap import GapDriver
from spikedeploy.envs.rollout import Rollout
from spikedeploy.policies.costs import UNCOUNTED, Costs
from spikedeploy.policies.interface import Candidate


class GapController:
    """The scripted driver as a player, on the observations of a policy."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self._driver = GapDriver.of(env)

    def reset(self, seed: int) -> None:
        """Nothing to reset: the driver has no state."""

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The action, () or (act,)."""
        return self._driver.act(observation)

    def replay(self, observations: NDArray[np.float64]) -> NDArray[Any]:
        """The actions (S,) or (S, act) for the observations (S, obs) of an episode."""
        return np.stack([self.act(observation) for observation in observations])


def describe(path: Path) -> Candidate:
    """The candidate; `path` is the built-in's name."""
    return Candidate(path=str(path), name="gap", kind="control", format="gap")


def controller(
    candidate: Candidate, chip: str | None, env: gymnasium.Env[Any, Any], sampled: bool
) -> GapController:
    """The driver of the environment's kart."""
    return GapController(env)


def costs(controller: GapController, played: Rollout) -> Costs:
    """Not counted: it is a script, not a network."""
    return UNCOUNTED
