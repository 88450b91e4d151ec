"""A world small enough to be learned within a test."""

import gymnasium
import numpy as np


class PointingEnv(gymnasium.Env):
    """Ten steps; the best action points where the observation does."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)
    seeds: tuple[int, ...] = ()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        PointingEnv.seeds += (seed,)
        self._left, self._goal = 10, self._draw()
        return self._goal, {}

    def step(self, action):
        reward = 1.0 - float(np.abs(action - self._goal).sum())
        self._left, self._goal = self._left - 1, self._draw()
        info = {"speed": 0.5, "cot": 2.0, "fall": False}
        return self._goal, reward, False, self._left == 0, info

    def _draw(self):
        return self.np_random.uniform(-0.8, 0.8, 2)
