"""Several copies of an environment, stepped as a batch in one process.

A checkpoint holds the seed of each episode under way and its actions. Physics engines keep what
they do not show (MuJoCo its warm start, pymunk its contacts), and other people's environments
cannot be saved at all; all that are deterministic can be brought back by taking the actions of the
episode again, which needs at most one episode's steps.
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy import envs
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.policies.policy import Head
from spikedeploy.trainers.run_folder import with_prefix

TRAINING_SEEDS = 5_000  # training seeds are below, those of validation and evaluation above


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

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Mask (B,) of the episodes that ended."""
        return self.terminated | self.truncated


@dataclass
class RunningEpisode:
    """The episode under way of one copy.

    seed: seed of its reset
    support: (S + 1,) support force at the reset and at each step; nan where it was never set
    actions: (S, ...) as the environment took them
    info: info of its reset
    """

    seed: int
    support: list[float]
    actions: list[NDArray[Any]] = field(default_factory=list)
    info: Mapping[str, Any] = field(default_factory=dict)

    def tensors(self) -> dict[str, Tensor]:
        """Return actions and support forces by name, for a checkpoint."""
        named = {"support": torch.tensor(self.support, dtype=torch.float64)}
        return named | (
            {"actions": torch.from_numpy(np.stack(self.actions))} if self.actions else {}
        )


class EnvBatch:
    """B copies of an environment, each of which is reset when its episode ends.

    observation: (B, obs) current
    episodes: (B,) under way
    returns: returns of the episodes that ended, oldest first
    taken: steps of all copies together
    """

    def __init__(self, config: EnvConfig, rng: np.random.Generator) -> None:
        self._config, self._rng = config, rng
        self._envs: list[Any] = [
            envs.make(config.name, **config.options) for _ in range(config.count)
        ]
        self._support = math.nan  # never set
        self._totals = np.zeros(config.count)
        self.episodes = [RunningEpisode(0, []) for _ in self._envs]
        size = self._envs[0].observation_space.shape[0]
        self.observation: NDArray[np.float64] = np.zeros((config.count, size))
        for k in range(config.count):
            self._reset(k)
        self.returns: list[float] = []
        self.taken = 0

    def __len__(self) -> int:
        return len(self._envs)

    @property
    def worlds(self) -> list[Any]:
        """The environments, with their wrappers."""
        return self._envs

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
    def sizes(self) -> tuple[int, int]:
        """Numbers of observations and of actions."""
        space = self._envs[0].action_space
        actions = int(space.n if self.head == "discrete" else space.shape[0])
        return self.observation.shape[1], actions

    def uniform(self) -> NDArray[np.float64]:
        """Return actions (B, act) drawn uniformly."""
        return self._rng.uniform(-1.0, 1.0, (len(self), self.sizes[1]))

    def support_force(self, fraction: float) -> None:
        """Set the support force [fraction of the full force], where the robot has one."""
        self._support = fraction
        for env in self._envs:
            env.unwrapped.support_force = fraction

    def step(self, action: NDArray[Any]) -> Steps:
        """Step every copy."""
        for episode, taken in zip(self.episodes, action, strict=True):
            episode.actions.append(np.array(taken)[()])  # a choice stays a number
            episode.support.append(self._support)
        results = [env.step(a) for env, a in zip(self._envs, action, strict=True)]
        following, rewards, terminated, truncated, infos = zip(*results, strict=True)
        reward = np.array(rewards, dtype=np.float64)
        self._totals += reward
        steps = Steps(
            self.observation,
            action,
            reward,
            np.array(terminated),
            np.array(truncated),
            np.stack(following),
            infos,
        )
        self.observation = steps.following.copy()
        for k in np.flatnonzero(steps.ended).tolist():
            self.returns.append(float(self._totals[k]))
            self._reset(k)
        self.taken += len(self)
        return steps

    def _reset(self, k: int) -> None:
        """Begin a new episode."""
        self._begin(k, RunningEpisode(int(self._rng.integers(TRAINING_SEEDS)), [self._support]))

    def _begin(self, k: int, episode: RunningEpisode) -> None:
        self.observation[k], episode.info = self._envs[k].reset(seed=episode.seed)
        self.episodes[k], self._totals[k] = episode, 0.0

    # checkpoints

    def state(self) -> dict[str, Any]:
        """Return the numbers of the episodes under way, for a checkpoint."""
        seeds = [episode.seed for episode in self.episodes]
        return {"env": self._config.model_dump(mode="json"), "seeds": seeds, "ended": self.returns}

    def tensors(self) -> dict[str, Tensor]:
        """Return what was done in the episodes under way, for a checkpoint."""
        each = enumerate(self.episodes)
        done = {f"{k}.{name}": t for k, episode in each for name, t in episode.tensors().items()}
        return {**done, "observation": torch.from_numpy(self.observation)}

    def restore(self, state: Mapping[str, Any], named: Mapping[str, Tensor], taken: int) -> None:
        """Bring every copy where it was at a checkpoint, by taking its actions again.

        Episodes begin again where the environment was exchanged, and where it does not repeat what
        it did.
        """
        self.returns, self.taken = list(state["ended"]), taken
        if state["env"] != self._config.model_dump(mode="json"):
            return
        before, repeats = named["observation"].numpy(), True
        self.observation = np.zeros_like(before)
        for k, seed in enumerate(state["seeds"]):
            past = with_prefix(str(k), named)
            actions = list(past["actions"].numpy()) if "actions" in past else []
            episode = RunningEpisode(seed, past["support"].tolist(), actions)
            repeats = self._repeat(k, episode) and repeats
        if repeats and np.array_equal(self.observation, before, equal_nan=True):
            return
        print(
            f"{self.env_id} did not repeat the episodes under way from their seeds and actions: it "
            "is not deterministic. They begin again, so that this run is not the same as one that "
            "was never stopped.",
            file=sys.stderr,
        )
        for k in range(len(self)):
            self._reset(k)

    def _repeat(self, k: int, episode: RunningEpisode) -> bool:
        """Take the actions of an episode again; return whether none of them ended it."""
        self._set_support(k, episode.support[0])
        self._begin(k, episode)
        for action, support in zip(episode.actions, episode.support[1:], strict=True):
            self._set_support(k, support)
            taken = self._envs[k].step(action.copy())
            self.observation[k], reward, terminated, truncated, _ = taken
            self._totals[k] += reward
            if terminated or truncated:
                return False
        return True

    def _set_support(self, k: int, fraction: float) -> None:
        if not math.isnan(fraction):
            self._support = fraction
            self._envs[k].unwrapped.support_force = fraction
