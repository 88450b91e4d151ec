"""A world small enough to be learned within a test."""

import gymnasium
import numpy as np

# settings with which SAC learns to point in seconds
QUICK = [
    "steps=400", "warm_up=100", "update_every=1", "batch=32", "policy.hidden=[32]", "tau=0.05",
    "critic_hidden=[32]", "learning_rate=1e-2", "validation.every=200", "validation.limit=10",
    "temperature.start=0.02", "temperature.end=0.02", "mean_penalty=0", "gamma=0.0",
    "log_every=200", "precision=float32", "env.count=4",
]  # fmt: skip


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
