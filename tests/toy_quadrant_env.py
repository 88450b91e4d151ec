"""A discrete world small enough to be learned within a test."""

import gymnasium
import numpy as np


class QuadrantEnv(gymnasium.Env):
    """Ten steps; the best of four actions names the quadrant that the observation is in."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)
    action_space = gymnasium.spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._left, self._goal, self._right = 10, self._draw(), 0
        return self._goal, {}

    def step(self, action):
        assert isinstance(action, (int, np.integer))
        x, y = self._goal
        right = action == int(x > 0) + 2 * int(y > 0)
        self._right += right
        self._left, self._goal = self._left - 1, self._draw()
        over = self._left == 0
        info = {"finish": over and self._right > 5, "crash": False, "gates": self._right}
        return self._goal, float(right), False, over, info

    def _draw(self):
        return self.np_random.uniform(-1.0, 1.0, 2)
