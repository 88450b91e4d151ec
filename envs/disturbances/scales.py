"""The scale of an observation, in whose unit noise and bias are.

Environments of ours scale their observations themselves. Of others it is measured: the standard
deviation of each number over 2,000 control steps of actions drawn uniformly, always the same ones.
So it is of the environment and not of a policy, and all policies meet the same noise.
"""

from __future__ import annotations

import json
from typing import Any

import gymnasium
import numpy as np

from spikedeploy.envs.adapted import AdaptedEnv
from spikedeploy.envs.disturbances.seeded import FloatArray
from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.foreign import make_foreign

_STEPS = 2_000  # [control steps]
_measured: dict[str, FloatArray] = {}  # by name and options, as every copy of a batch asks


def scale(env: gymnasium.Env[Any, Any]) -> FloatArray | float:
    """The scale (obs,) of an environment of other people; 1 of ours, which are scaled."""
    world = env.unwrapped
    if not isinstance(world, AdaptedEnv):
        return 1.0
    if world.one_hot:
        levels = (world.observation_space.shape or (0,))[0]
        raise EnvError(
            f"{world.name} observes one of {levels} levels, in which "
            "there is neither noise nor bias: take dropout or delay"
        )
    options = {key: value for key, value in world.given.items() if key != "success"}
    key = json.dumps([world.name, options], sort_keys=True, default=repr)
    if key not in _measured:
        _measured[key] = _spread(make_foreign(world.name, options))
    return _measured[key]


def _spread(env: AdaptedEnv) -> FloatArray:
    """Standard deviation (obs,) under actions drawn uniformly."""
    rng, space, episode = np.random.default_rng(0), env.action_space, 0
    seen = [env.reset(seed=episode)[0]]
    while len(seen) < _STEPS:
        action = (
            int(rng.integers(space.n))
            if isinstance(space, gymnasium.spaces.Discrete)
            else rng.uniform(-1.0, 1.0, space.shape)
        )
        observation, _, terminated, truncated, _ = env.step(action)
        seen.append(observation)
        if terminated or truncated:
            episode += 1
            seen.append(env.reset(seed=episode)[0])
    env.close()
    spread: FloatArray = np.std(seen, axis=0)
    return spread
