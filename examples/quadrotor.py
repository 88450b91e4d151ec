"""A planar quadrotor in wind, as somebody who has never heard of spikes would write it.

    python examples/quadrotor.py teacher.zip        # SAC of stable-baselines3, minutes
    spikedeploy distill teacher.zip --env examples.quadrotor:Quadrotor

Two rotors hold a rod at the origin; each pushes along the rod's normal with 0 to 9 N. The wind is
an Ornstein-Uhlenbeck process that nobody measures.
"""

import sys
from typing import Any

import gymnasium
import numpy as np

DT, STEPS = 0.02, 250  # [s], control steps of an episode
MASS, ARM, INERTIA, GRAVITY, DRAG = 1.0, 0.2, 0.02, 9.81, 0.3  # [kg, m, kg m², m/s², N s/m]
MOST = 9.0  # thrust of a rotor [N]
WIND, WIND_TIME = 1.5, 1.0  # standard deviation [N] and correlation time [s] of the wind's force
LIMIT = 3.0  # distance from the origin at which an episode ends [m]


class Quadrotor(gymnasium.Env):
    """Hover at the origin from a random state.

    Observation (10,): position [m], velocity [m/s], sine and cosine of the tilt, its rate [rad/s],
    the thrusts of the last step [N], and the force on the accelerometer along the rod [N].
    Action (2,): thrusts of the left and right rotor [N]. `info["success"]` at the end: whether it
    stayed within 0.3 m for the last second.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(1 / DT)}  # noqa: RUF012
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (10,), np.float32)
    action_space = gymnasium.spaces.Box(0.0, MOST, (2,), np.float32)

    def __init__(self, render_mode: str | None = None, wind: float = WIND) -> None:
        """wind: standard deviation of its force [N]."""
        self.render_mode, self._strength = render_mode, wind

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start at rest somewhere within a metre, tilted a little."""
        super().reset(seed=seed)
        draw = self.np_random.uniform
        self._place, self._speed = draw(-1.0, 1.0, 2), draw(-0.5, 0.5, 2)
        self._tilt, self._turning = draw(-0.3, 0.3), draw(-0.5, 0.5)
        self._thrust = np.full(2, MASS * GRAVITY / 2)
        self._wind = self._strength * self.np_random.normal(size=2)
        self._taken = self._near = 0
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Push for one control step."""
        self._thrust = np.clip(np.asarray(action, np.float64), 0.0, MOST)
        left, right = self._thrust
        keep = np.exp(-DT / WIND_TIME)
        noise = self._strength * np.sqrt(1 - keep**2) * self.np_random.normal(size=2)
        self._wind = keep * self._wind + noise
        up = np.array([-np.sin(self._tilt), np.cos(self._tilt)])
        force = (left + right) * up + self._wind - DRAG * self._speed
        self._speed = self._speed + DT * (force / MASS - [0.0, GRAVITY])
        self._place = self._place + DT * self._speed
        self._turning += DT * ARM * (right - left) / INERTIA
        self._tilt += DT * self._turning
        self._taken += 1
        distance = float(np.hypot(*self._place))
        self._near = self._near + 1 if distance < 0.3 else 0
        lost = distance > LIMIT or abs(self._tilt) > np.pi / 2
        # 1 at the origin; turning fast and pushing apart cost a little
        reward = 1 / (1 + 4 * distance**2) - 0.005 * self._turning**2 - 0.001 * (right - left) ** 2
        over = self._taken == STEPS
        info = {"success": self._near >= 1 / DT} if lost or over else {}
        return self._observe(), float(reward), bool(lost), over, info

    def _observe(self) -> np.ndarray:
        along = np.array([np.cos(self._tilt), np.sin(self._tilt)]) @ self._wind
        angles = np.sin(self._tilt), np.cos(self._tilt), self._turning
        values = [*self._place, *self._speed, *angles, *self._thrust, along]
        return np.array(values, np.float32)

    def render(self) -> np.ndarray:
        """Draw the rod, its thrusts and the origin (240, 320, 3)."""
        import pygame

        picture = pygame.Surface((320, 240))
        picture.fill((246, 246, 242))

        def at(point: np.ndarray) -> tuple[float, float]:
            return 160 + 85 * point[0], 120 - 85 * point[1]

        pygame.draw.circle(picture, (190, 190, 186), at(np.zeros(2)), 26, 2)
        along = ARM * 1.5 * np.array([np.cos(self._tilt), np.sin(self._tilt)])
        up = np.array([-np.sin(self._tilt), np.cos(self._tilt)])
        for side, thrust in zip((-1, 1), self._thrust, strict=True):
            rotor = self._place + side * along + 0.07 * up
            pygame.draw.line(picture, (213, 94, 0), at(rotor), at(rotor - 0.06 * thrust * up), 4)
            blades = at(rotor - 0.5 * along), at(rotor + 0.5 * along)
            pygame.draw.line(picture, (110, 110, 110), *blades, 3)
        ends = at(self._place - along), at(self._place + along)
        pygame.draw.line(picture, (40, 40, 40), *ends, 8)
        return np.transpose(pygame.surfarray.array3d(picture), (1, 0, 2)).copy()


def main(path: str) -> None:
    """Train a teacher with stable-baselines3, and save it."""
    from stable_baselines3 import SAC
    from stable_baselines3.common.env_util import make_vec_env

    envs = make_vec_env(Quadrotor, n_envs=4, seed=0)
    model = SAC(
        "MlpPolicy", envs, gamma=0.98, tau=0.02, learning_rate=1e-3, gradient_steps=2,
        learning_starts=2_000, policy_kwargs={"net_arch": [64, 64]}, seed=0, device="cpu",
    )  # fmt: skip
    model.learn(80_000)
    model.save(path)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "teacher.zip")
