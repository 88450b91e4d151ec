"""An environment of ten steps with four discrete actions and the infos of a kart."""

import gymnasium
import numpy as np

from spikedeploy import envs

ID = "test/Race-v0"


class RaceEnv(gymnasium.Env):
    """The best of four actions names the quadrant of the observation; six of ten finish."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)
    action_space = gymnasium.spaces.Discrete(4)
    CONTROL_DT = 1 / 60
    max_steps = 10
    metadata = {"render_modes": ["rgb_array"], "render_fps": 60}  # noqa: RUF012

    def __init__(self, render_mode=None, luck=0):
        self.render_mode, self.luck = render_mode, luck

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._step, self._goal, self._right = 0, self._draw(), self.luck
        return self._goal, {}

    def step(self, action):
        x, y = self._goal
        right = int(action) == int(x > 0) + 2 * int(y > 0)
        self._right += right
        self._step, self._goal = self._step + 1, self._draw()
        over = self._step == self.max_steps
        finish = over and self._right > 5
        info = {
            "success": finish, "finish": finish, "crash": over and not finish, "stalled": False,
            "gates": self._right, "lap_time": self._step / 60, "speed": 400.0, "heading": 1.0,
            "reward_terms": {"gate": float(right)},
        }  # fmt: skip
        return self._goal, float(right), finish, over and not finish, info

    def render(self):
        return np.full((48, 64, 3), 10 * self._step, np.uint8)

    def _draw(self):
        return self.np_random.uniform(-1.0, 1.0, 2)


def install(monkeypatch, *names):
    """Make the race known under these short names, `race` if none is given."""
    for name in names or ("race",):
        spec = envs.EnvSpec(name, ID, "tests.toy_race_env:RaceEnv", "ten steps", ("random",))
        monkeypatch.setitem(envs.ENVS, name, spec)
    envs.register()
