"""Experience: several copies of one environment, stepped as a batch in one process."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import envs
from trainers.config import EnvConfig

SEEDS = 5_000  # training draws its seeds below this; validation and evaluation are above


@dataclass(frozen=True)
class Steps:
    """One step of every copy.

    observation, following: (B, obs) before and after it
    action: (B, act)
    reward: (B,)
    terminated: (B,) whether the episode ended by itself
    """

    observation: NDArray[np.float64]
    action: NDArray[np.float64]
    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    following: NDArray[np.float64]


class EnvBatch:
    """Copies of an environment, each of which starts anew when its episode ends.

    observation: (B, obs) what every copy sees now
    returns: returns of the episodes that ended, oldest first
    """

    def __init__(self, config: EnvConfig, rng: np.random.Generator) -> None:
        self._rng = rng
        self._envs: list[Any] = [
            envs.make(config.name, **config.options) for _ in range(config.count)
        ]
        self.observation = np.stack([self._reset(env) for env in self._envs])
        self._totals = np.zeros(config.count)
        self.returns: list[float] = []

    def __len__(self) -> int:
        return len(self._envs)

    @property
    def columns(self) -> dict[str, slice] | None:
        """The environment's OBSERVATION table, None where it has none."""
        return getattr(self._envs[0].unwrapped, "OBSERVATION", None)

    @property
    def actions(self) -> int:
        """Number of actions."""
        return int(self._envs[0].action_space.shape[0])

    def uniform(self) -> NDArray[np.float64]:
        """Return actions (B, act) drawn uniformly."""
        return self._rng.uniform(-1.0, 1.0, (len(self), self.actions))

    def step(self, action: NDArray[np.float64], hoist: float) -> Steps:
        """Step every copy under a fraction of the full hoisting force."""
        before = self.observation
        results = [self._step(k, action[k], hoist) for k in range(len(self))]
        following, reward, terminated, current = zip(*results, strict=True)
        self.observation = np.stack(current)
        return Steps(before, action, np.array(reward), np.array(terminated), np.stack(following))

    def _step(
        self, k: int, action: NDArray[np.float64], hoist: float
    ) -> tuple[NDArray[np.float64], float, bool, NDArray[np.float64]]:
        """Return what followed, reward, terminated, and what the copy sees now."""
        env = self._envs[k]
        env.unwrapped.hoist = hoist
        following, reward, terminated, truncated, _ = env.step(action)
        self._totals[k] += reward
        if not (terminated or truncated):
            return following, reward, terminated, following
        self.returns.append(float(self._totals[k]))
        self._totals[k] = 0.0
        return following, reward, terminated, self._reset(env)

    def _reset(self, env: Any) -> NDArray[np.float64]:  # noqa: ANN401
        observation: NDArray[np.float64] = env.reset(seed=int(self._rng.integers(SEEDS)))[0]
        return observation
