"""A teacher, a student or the dense network at a place, for a batch of robots; random actions."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lab.experiments.gymnasium.design import FLOAT
from lab.experiments.pareto.networks import Done, LevelNetwork, network
from spikedeploy import envs
from spikedeploy.trainers.policies import Policy
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.pool import Stateless, Walk
from spikedeploy.trainers.sparse.student import in_float

_BEST = "best"


def network_of(run: Path, place: str, stem: Path) -> LevelNetwork:
    """The best policy of a run at a place (GymnasiumDesign.places); RuleError where it is refused.

    stem  of the exported file, without a suffix
    """
    if place != FLOAT:
        return network(run, _BEST, place, stem)
    policy = RunFolder(run).policy(_BEST)
    return LevelNetwork(in_float(policy), lambda walks: _dense(policy, walks))


def _dense(policy: Policy, walks: Sequence[Walk]) -> Done:
    """Operations of a float network of which nothing is left out: all multiply-accumulates."""
    weights = [each for each in policy.parameters() if each.ndim == 2]
    biases = [each for each in policy.parameters() if each.ndim == 1]
    return {
        "operations": float(sum(each.numel() for each in weights)),
        "observations": float(walks[0].observation.shape[1]),
        "constants": float(sum(each.numel() for each in biases)),
    }


def random_actions(env: str, seed: int = 0) -> Stateless:
    """Actions drawn at random, the lower bound of a return."""
    world: Any = envs.make(env)
    space, rng = world.action_space, np.random.default_rng(seed)
    world.close()

    def act(observation: NDArray[np.float64]) -> NDArray[Any]:
        if isinstance(space, gymnasium.spaces.Discrete):
            return rng.integers(int(space.n), size=len(observation))
        return rng.uniform(-1.0, 1.0, (len(observation), *space.shape))

    return Stateless(act)
