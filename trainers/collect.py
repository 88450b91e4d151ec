"""Experience: several copies of one environment, stepped as a batch in one process."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.policy import Head

SEEDS = 5_000  # training draws its seeds below this; validation and evaluation are above


@dataclass(frozen=True)
class Steps:
    """One step of every copy.

    observation, following: (B, obs) before and after it
    action: (B, act), or (B,) of discrete ones
    reward: (B,)
    terminated, truncated: (B,) whether the episode ended by itself, and whether by the clock
    infos: (B,) of the environments
    """

    observation: NDArray[np.float64]
    action: NDArray[np.float64]
    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    following: NDArray[np.float64]
    infos: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True)
class Start:
    """How an episode began: its seed, and what the environment told at reset."""

    seed: int
    info: Mapping[str, Any]


class EnvBatch:
    """Copies of an environment, each of which starts anew when its episode ends.

    observation: (B, obs) what every copy sees now
    starts: (B,) of the episodes that are under way
    returns: returns of the episodes that ended, oldest first
    """

    def __init__(self, config: EnvConfig, rng: np.random.Generator) -> None:
        self._rng = rng
        self._envs: list[Any] = [
            envs.make(config.name, **config.options) for _ in range(config.count)
        ]
        self.starts = [Start(0, {}) for _ in self._envs]
        self.observation = np.stack([self._reset(k) for k in range(len(self._envs))])
        self._totals = np.zeros(config.count)
        self.returns: list[float] = []

    def __len__(self) -> int:
        return len(self._envs)

    @property
    def columns(self) -> dict[str, slice] | None:
        """The environment's OBSERVATION table, None where it has none."""
        return getattr(self._envs[0].unwrapped, "OBSERVATION", None)

    @property
    def env_id(self) -> str:
        """Gymnasium's identifier."""
        return str(self._envs[0].spec.id)

    @property
    def head(self) -> Head:
        """Kind of actions."""
        discrete = isinstance(self._envs[0].action_space, gymnasium.spaces.Discrete)
        return "discrete" if discrete else "continuous"

    @property
    def actions(self) -> int:
        """Number of actions."""
        space = self._envs[0].action_space
        return int(space.n if self.head == "discrete" else space.shape[0])

    def demand_numbers(self, algorithm: str) -> None:
        """Refuse environments that take one of several actions, for who can only learn numbers."""
        if self.head == "discrete":
            raise ConfigError(
                f"{algorithm} learns actions that are numbers, and {self.env_id} takes one of "
                f"{self.actions}: train it with a recipe of ppo"
            )

    def uniform(self) -> NDArray[np.float64]:
        """Return actions (B, act) drawn uniformly."""
        return self._rng.uniform(-1.0, 1.0, (len(self), self.actions))

    def support_force(self, fraction: float) -> None:
        """Apply a fraction of the full hoisting force from now on, where robots can be hoisted."""
        for env in self._envs:
            env.unwrapped.support_force = fraction

    def step(self, action: NDArray[Any]) -> Steps:
        """Step every copy."""
        before = self.observation
        results = [env.step(a) for env, a in zip(self._envs, action, strict=True)]
        following, reward, terminated, truncated, infos = zip(*results, strict=True)
        steps = Steps(
            before,
            action,
            np.array(reward, dtype=np.float64),
            np.array(terminated),
            np.array(truncated),
            np.stack(following),
            infos,
        )
        self._totals += steps.reward
        self.observation = steps.following.copy()
        for k in np.flatnonzero(steps.terminated | steps.truncated):
            self._begin(int(k))
        return steps

    def _begin(self, k: int) -> None:
        """Start the next episode of a copy."""
        self.returns.append(float(self._totals[k]))
        self._totals[k] = 0.0
        self.observation[k] = self._reset(k)

    def _reset(self, k: int) -> NDArray[np.float64]:
        seed = int(self._rng.integers(SEEDS))
        observation: NDArray[np.float64]
        observation, info = self._envs[k].reset(seed=seed)
        self.starts[k] = Start(seed, info)
        return observation
