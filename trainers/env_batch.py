"""EnvBatch: several copies of an environment, stepped as a batch in one process."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.policies import Head

_SEEDS = 5_000  # training seeds are below, those of validation and evaluation above


@dataclass(frozen=True)
class Steps:
    """One step of all B copies.

    observation, following: (B, obs) before and after the step
    action: (B, act), or (B,) if discrete
    reward: (B,)
    terminated, truncated: (B,) whether the episode ended, by a terminal state or the time limit
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
class _EpisodeStart:
    """Seed of an episode, and info of its reset."""

    seed: int
    info: Mapping[str, Any]


class EnvBatch:
    """B copies of an environment, each of which is reset when its episode ends.

    observation: (B, obs) current
    starts: (B,) of the current episodes
    returns: of the episodes that ended, oldest first
    """

    def __init__(self, config: EnvConfig, rng: np.random.Generator) -> None:
        self._rng = rng
        self._envs: list[Any] = [
            envs.make(config.name, **config.options) for _ in range(config.count)
        ]
        self.starts = [_EpisodeStart(0, {}) for _ in self._envs]
        self.observation = np.stack([self._reset(k) for k in range(len(self._envs))])
        self._totals = np.zeros(config.count)
        self.returns: list[float] = []

    def __len__(self) -> int:
        return len(self._envs)

    @property
    def columns(self) -> dict[str, slice] | None:
        """The environment's OBSERVATION table, None if it has none."""
        return getattr(self._envs[0].unwrapped, "OBSERVATION", None)

    @property
    def env_id(self) -> str:
        """Gymnasium's identifier."""
        return str(self._envs[0].spec.id)

    @property
    def head(self) -> Head:
        """Kind of the action space."""
        discrete = isinstance(self._envs[0].action_space, gymnasium.spaces.Discrete)
        return "discrete" if discrete else "continuous"

    @property
    def actions(self) -> int:
        """Number of actions."""
        space = self._envs[0].action_space
        return int(space.n if self.head == "discrete" else space.shape[0])

    def require_continuous(self, algorithm: str) -> None:
        """Raise ConfigError if actions are discrete."""
        if self.head == "discrete":
            raise ConfigError(
                f"{algorithm} learns continuous actions, and {self.env_id} takes one of "
                f"{self.actions} discrete ones: train it with a recipe of ppo"
            )

    def uniform(self) -> NDArray[np.float64]:
        """Return actions (B, act) drawn uniformly."""
        return self._rng.uniform(-1.0, 1.0, (len(self), self.actions))

    def support_force(self, fraction: float) -> None:
        """Set the support force [fraction of the full force], where the robot has one."""
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
            self._restart(int(k))
        return steps

    def _restart(self, k: int) -> None:
        """Record the return of a copy's episode and start the next one."""
        self.returns.append(float(self._totals[k]))
        self._totals[k] = 0.0
        self.observation[k] = self._reset(k)

    def _reset(self, k: int) -> NDArray[np.float64]:
        seed = int(self._rng.integers(_SEEDS))
        observation: NDArray[np.float64]
        observation, info = self._envs[k].reset(seed=seed)
        self.starts[k] = _EpisodeStart(seed, info)
        return observation
