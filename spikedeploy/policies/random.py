"""The built-in `random`: an action drawn uniformly at every control step."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.rollout import Rollout
from spikedeploy.policies.costs import NOTHING, Costs
from spikedeploy.policies.interface import Candidate

STREAM = 1  # so that draws differ from those of an environment with the same seed


class RandomController:
    """Uniform actions, seeded by the episode.

    space  of the actions
    """

    def __init__(self, space: gymnasium.Space[Any]) -> None:
        self.space = space
        self._rng = np.random.default_rng()

    def reset(self, seed: int) -> None:
        """Seed the generator."""
        self._rng = np.random.default_rng([seed, STREAM])

    def act(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """An action (act,), or () where it is one of several."""
        if isinstance(self.space, gymnasium.spaces.Discrete):
            return np.asarray(self._rng.integers(self.space.n))
        return self._rng.uniform(-1.0, 1.0, self.space.shape or ())

    def replay(self, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        """The next S actions (S, act) or (S,)."""
        return np.stack([self.act(observation) for observation in observations])


def describe(path: Path) -> Candidate:
    """The candidate; `path` is the built-in's name."""
    return Candidate(path=str(path), name="random", kind="random", format="random")


def controller(
    candidate: Candidate, chip: str | None, env: gymnasium.Env[Any, Any], sampled: bool
) -> RandomController:
    """A controller that draws from the environment's actions."""
    return RandomController(env.action_space)


def costs(controller: RandomController, played: Rollout) -> Costs:
    """Nothing is computed."""
    return NOTHING
