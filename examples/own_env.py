"""An environment of your own, not registered: trained for a minute, then compared on a chip.

A crane moves a load of 1 kg to a mark, with -2 to 6 N against a wind of 1.5 N.

    python examples/own_env.py [STEPS]

In this folder likewise: `spikedeploy train own_env:Crane --recipe ppo-snn`.
"""

import sys

import gymnasium
import numpy as np

import spikedeploy as sd


class Crane(gymnasium.Env[np.ndarray, np.ndarray]):
    """Observes distance to the mark [m] and velocity [m/s]; a hundred steps."""

    CONTROL_DT = 0.05  # [s]
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = gymnasium.spaces.Box(-2.0, 6.0, (1,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict | None = None
    ) -> tuple[np.ndarray, dict]:
        """Start at rest, up to three metres away."""
        super().reset(seed=seed)
        self.distance, self.velocity, self.left = self.np_random.uniform(-3, 3), 0.0, 100
        return np.array([self.distance, self.velocity], np.float32), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Pull with a force [N]; the reward is the distance that is left, negative."""
        self.velocity += self.CONTROL_DT * (float(action[0]) - 1.5 - 0.5 * self.velocity)
        self.distance += self.CONTROL_DT * self.velocity
        self.left, away = self.left - 1, abs(self.distance)
        seen = np.array([self.distance, self.velocity], np.float32)
        return seen, -away, False, self.left == 0, {"arrived": away < 0.3}


def main(*settings: str, episodes: int = 10) -> sd.ComparedPolicies:
    """Train, export, and compare on Loihi 1 with actions that are drawn."""
    run = sd.train("ppo-snn", env="own_env:Crane", overrides=settings)
    return sd.compare("own_env:Crane", [run], episodes=episodes, options={"success": "arrived"})


if __name__ == "__main__":
    print(main(f"steps={sys.argv[1] if len(sys.argv) > 1 else 60_000}"))
