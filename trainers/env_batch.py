"""EnvBatch: several copies of an environment, stepped as a batch in one process."""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.learner import under
from spikedeploy.trainers.policies import Head

# -- What brought an environment where it is: the seed of its reset, and every action since.
#
# Physics engines keep what they do not show (MuJoCo its warm start, pymunk its contacts), and other
# people's environments cannot be saved at all. All that are deterministic can be brought back by
# taking the actions of the episode again, which needs at most one episode's steps.


class Watcher(Protocol):
    """Who keeps sums or records of the episodes under way."""

    def episode_begun(self, k: int) -> None:
        """Forget what copy k did: its episode begins."""

    def step_repeated(
        self, k: int, action: NDArray[Any], reward: float, info: Mapping[str, Any]
    ) -> None:
        """Take a step of copy k into account that was taken before."""


class EpisodeHistory:
    """The episode under way of one copy.

    seed: of its reset
    actions: (S, ...) as the environment took them
    support: (S + 1,) support force at the reset and at each step; nan where it was never set
    """

    def __init__(self, seed: int, support: float) -> None:
        self.seed = seed
        self.actions: list[NDArray[Any]] = []
        self.support = [support]

    def add(self, action: NDArray[Any], support: float) -> None:
        """Add a step."""
        self.actions.append(np.array(action)[()])  # a choice stays a number
        self.support.append(support)

    def tensors(self) -> dict[str, Tensor]:
        """Return actions and support forces by name, for a checkpoint."""
        support = {"support": torch.tensor(self.support, dtype=torch.float64)}
        if not self.actions:
            return support
        return {**support, "actions": torch.from_numpy(np.stack(self.actions))}

    @classmethod
    def restored(cls, seed: int, named: Mapping[str, Tensor]) -> "EpisodeHistory":
        """Return what `tensors` returned."""
        support: list[float] = named["support"].tolist()
        history = cls(seed, support[0])
        actions = named["actions"].numpy() if "actions" in named else ()
        for action, force in zip(actions, support[1:], strict=True):
            history.add(action, force)
        return history


# -- EnvBatch: several copies of an environment, stepped as a batch in one process.

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
        self._config, self._rng = config, rng
        self._envs: list[Any] = [
            envs.make(config.name, **config.options) for _ in range(config.count)
        ]
        self._support = math.nan  # never set
        self.starts = [_EpisodeStart(0, {}) for _ in self._envs]
        self._histories = [EpisodeHistory(0, self._support) for _ in self._envs]
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
        self._support = fraction
        for env in self._envs:
            env.unwrapped.support_force = fraction

    def step(self, action: NDArray[Any]) -> Steps:
        """Step every copy."""
        before = self.observation
        for history, taken in zip(self._histories, action, strict=True):
            history.add(taken, self._support)
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
        self._histories[k] = EpisodeHistory(seed, self._support)
        return self._begin(k, seed)

    def _begin(self, k: int, seed: int) -> NDArray[np.float64]:
        observation: NDArray[np.float64]
        observation, info = self._envs[k].reset(seed=seed)
        self.starts[k] = _EpisodeStart(seed, info)
        return observation

    # checkpoints

    def state(self) -> dict[str, Any]:
        """Return the numbers of the episodes under way, for a checkpoint."""
        seeds = [history.seed for history in self._histories]
        return {"env": self._config.model_dump(mode="json"), "seeds": seeds, "ended": self.returns}

    def tensors(self) -> dict[str, Tensor]:
        """Return what was done in the episodes under way, for a checkpoint."""
        each = [history.tensors() for history in self._histories]
        done = {f"{k}.{name}": t for k, named in enumerate(each) for name, t in named.items()}
        return {**done, "observation": torch.from_numpy(self.observation)}

    def restore(self, state: Mapping[str, Any], named: dict[str, Tensor], watcher: Watcher) -> None:
        """Bring every copy where it was at a checkpoint, by taking its actions again.

        Episodes begin anew where the environment was exchanged, and where it does not repeat what
        it did.
        """
        self.returns = list(state["ended"])
        if state["env"] != self._config.model_dump(mode="json"):
            return
        histories = [
            EpisodeHistory.restored(seed, under(str(k), named))
            for k, seed in enumerate(state["seeds"])
        ]
        before = named["observation"].numpy()
        self.observation = np.zeros_like(before)
        repeated = all([self._repeat(k, each, watcher) for k, each in enumerate(histories)])
        self._histories = histories
        if not (repeated and np.array_equal(self.observation, before, equal_nan=True)):
            self._anew(watcher)

    def _repeat(self, k: int, history: EpisodeHistory, watcher: Watcher) -> bool:
        """Take the actions of an episode again; return whether none of them ended it."""
        self._set_support(k, history.support[0])
        self.observation[k] = self._begin(k, history.seed)
        self._totals[k] = 0.0
        watcher.episode_begun(k)
        for action, support in zip(history.actions, history.support[1:], strict=True):
            self._set_support(k, support)
            taken = self._envs[k].step(action.copy())
            self.observation[k], reward, terminated, truncated, info = taken
            self._totals[k] += reward
            watcher.step_repeated(k, action, float(reward), info)
            if terminated or truncated:
                return False
        return True

    def _set_support(self, k: int, fraction: float) -> None:
        if not math.isnan(fraction):
            self._support = fraction
            self._envs[k].unwrapped.support_force = fraction

    def _anew(self, watcher: Watcher) -> None:
        """Begin all episodes anew, and say why."""
        print(
            f"{self.env_id} did not repeat the episodes under way from their seeds and actions: it "
            "is not deterministic. They begin anew, so that this run is not the same as one that "
            "was never stopped.",
            file=sys.stderr,
        )
        self._totals[:] = 0.0
        for k in range(len(self)):
            self.observation[k] = self._reset(k)
            watcher.episode_begun(k)
