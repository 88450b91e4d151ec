"""An environment as somebody else would write one: not registered, odd bounds, no names of ours."""

import gymnasium
import numpy as np


class Reach(gymnasium.Env):
    """Twelve steps; two valves of odd ranges are to be set where a 2 x 2 picture of numbers says.

    `left` is in [-0.3, 0.1], `right` in [5, 9].
    """

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2, 2), np.float32)
    action_space = gymnasium.spaces.Box(
        np.array([[-0.3], [5.0]], np.float32), np.array([[0.1], [9.0]], np.float32)
    )
    metadata = {"render_modes": ["rgb_array"], "render_fps": 40}  # noqa: RUF012

    def __init__(self, render_mode=None, steps=12):
        self.render_mode, self._steps = render_mode, steps

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._left, self._given = self._steps, []
        return self._seen(), {"valves": 2}

    def step(self, action):
        assert action.shape == (2, 1)
        assert action.dtype == np.float32
        assert self.action_space.contains(action)
        self._given.append(action)
        near = float(np.abs((action.ravel() - self._wanted) / [0.4, 4.0]).sum())
        self._left -= 1
        over = self._left == 0
        info = {"error": np.float32(near), "who": "reach", "terms": {"near": near}}
        if over:
            info["close"] = near < 0.5
        return self._seen(), -near, False, over, info

    def render(self):
        return np.full((24, 32, 3), 20 * self._left, np.uint8)

    def expert(self):
        return self._wanted.astype(np.float32)

    def _seen(self):
        share = self.np_random.uniform(0.0, 1.0, 2)
        self._wanted = np.array([-0.3 + 0.4 * share[0], 5.0 + 4.0 * share[1]])
        return np.array([[share[0], 100.0], [share[1] - 3.0, 0.0]], np.float32)


def short(render_mode=None):
    """A function that makes one."""
    return Reach(render_mode, steps=3)


def refused(space, kind):
    """An environment that observes, or acts in, another space."""
    env = Reach()
    setattr(env, f"{kind}_space", space)
    return env


class Levels(gymnasium.Env):
    """Three levels from 5, four choices from -1; the right choice is the level less 6."""

    observation_space = gymnasium.spaces.Discrete(3, start=5)
    action_space = gymnasium.spaces.Discrete(4, start=-1)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._left = 5
        return self._level(), {}

    def step(self, action):
        assert isinstance(action, int)
        reward = float(action == self._now - 6)
        self._left -= 1
        return self._level(), reward, self._left == 0, False, {"success": reward > 0}

    def _level(self):
        self._now = int(self.np_random.integers(5, 8))
        return self._now


class Dials(gymnasium.Env):
    """Twelve numbers, six choices, five steps."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (12,), np.float32)
    action_space = gymnasium.spaces.Discrete(6)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._left = 5
        return self._seen(), {}

    def step(self, action):
        self._left -= 1
        return self._seen(), float(action), self._left == 0, False, {}

    def _seen(self):
        return self.np_random.uniform(-1.0, 1.0, 12).astype(np.float32)


gymnasium.register("OwnLevels-v3", Levels, reward_threshold=2.0)
