"""Soft actor-critic (Haarnoja et al. 2018): a run of it."""

import os
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import flush
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.env_batch import Steps
from spikedeploy.trainers.policies import from_config
from spikedeploy.trainers.run_folder import RunFolder, file_sha256, write_errors
from spikedeploy.trainers.runner import EnvRunner
from spikedeploy.trainers.sac.cuda import CudaLearner, CudaReplay
from spikedeploy.trainers.sac.learner import ReplayBuffer, SacConfig, SacLearner


class Sac(EnvRunner[SacConfig]):
    """One run of soft actor-critic.

    updates: gradient updates so far
    """

    Config = SacConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "env_steps", "updates", "episodes", "episode_return", "support_force", "temperature",
        "actor_loss", "critic_loss", "entropy", "steps_per_s", "eval_return", "eval_speed",
        "eval_cot", "eval_falls", "eval_speed_rmse", "eval_turn_rmse",
    )  # fmt: skip
    COUNTERS = ("env_steps", "updates", "episodes", "best")
    VALIDATES_AT_END = False
    learner: SacLearner

    def __init__(self, config: SacConfig, run: RunFolder) -> None:
        super().__init__(config, run, config.steps, config.checkpoint_every, config.log_every)
        sizes = self._envs.sizes
        if self._envs.head == "discrete":
            raise ConfigError(
                f"sac learns continuous actions, and {self._envs.env_id} takes one of {sizes[1]} "
                "discrete ones: train it with a recipe of ppo"
            )
        check_shaping(config.shaping, config.env)
        self.policy = from_config(config.policy, *sizes, config.normaliser.clip)
        gpu = config.device == "cuda"
        self.learner = (CudaLearner if gpu else SacLearner)(config, self.policy)
        capacity = min(config.buffer, config.steps)
        self._buffer = (CudaReplay if gpu else ReplayBuffer)(capacity, *sizes)
        self.updates = 0
        self._losses: Mapping[str, Tensor | float] = {}
        self._replay_sum: str | None = None  # checksum of the replay of the last checkpoint

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        self._collect()
        self._update()
        return True

    @property
    def _support_force(self) -> float:
        return self._config.support_force.value(self.env_steps)

    def _collect(self) -> None:
        """Take one step in every environment, and store it."""
        self._envs.support_force(self._support_force)
        warming_up = self.env_steps < self._config.warm_up
        explore = self.learner.explore
        actions = self._envs.uniform() if warming_up else explore(self._envs.observation)
        counts = self.env_steps < self._config.normaliser.finish
        steps = self._envs.step(actions)
        reward = shape_reward(self._config.shaping, steps)
        self._buffer.add(steps.observation, steps.action, reward, steps.terminated, steps.following)
        if counts:
            self._moments.add(steps.observation)
            self.learner.adopt(self._moments)

    def _update(self) -> None:
        """Make the updates that are due after the steps so far."""
        wanted = (self.env_steps - self._config.warm_up) // self._config.update_every
        scheduled = self._config.temperature.value(self.env_steps)
        while self.updates < wanted:
            batch = self._buffer.sample(self._config.batch, self._rng)
            self._losses = self.learner.update(batch, scheduled)
            self.updates += 1
            self.learner.average(self.updates)

    def _evaluate(self) -> dict[str, float]:
        self.learner.settle()
        return super()._evaluate()

    def _row(self) -> dict[str, float]:
        self._count_episodes()
        return super()._row()

    def _metrics(self) -> dict[str, float]:
        learned = self.learner.temperature
        scheduled = self._config.temperature.value(self.env_steps)
        return {
            "support_force": self._support_force,
            "temperature": scheduled if learned is None else learned.value,
            **{name: float(loss) for name, loss in self._losses.items()},
        }

    def _state(self) -> dict[str, Any]:
        losses = {name: float(loss) for name, loss in self._losses.items()}
        return {**super()._state(), "losses": losses, "replay_sha256": self._replay_sum}

    def _checkpoint(self) -> None:
        """Save everything that resuming needs; a finished run needs no replay."""
        self.learner.settle()
        self._replay_sum = None if self.finished else self._buffer.save(self._run.next_replay)
        # from here to the next line, a kill leaves this checkpoint's replay under its other name
        super()._checkpoint()
        self._take_replay(self._replay_sum)

    def _take_replay(self, checksum: str | None) -> None:
        """Give the replay of the last checkpoint its name; delete it where there is none."""
        run = self._run
        with write_errors(run.replay):
            if checksum is None:
                run.replay.unlink(missing_ok=True)
            elif run.next_replay.is_file() and file_sha256(run.next_replay) == checksum:
                os.replace(run.next_replay, run.replay)
                flush(run.path)
            run.next_replay.unlink(missing_ok=True)

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        super()._restore(state, tensors)
        self._losses, checksum = state["losses"], state["replay_sha256"]
        self._take_replay(checksum)
        if not self.finished:
            self._buffer.load(self._run.replay, checksum)


def check_shaping(weights: Mapping[str, float], env: EnvConfig) -> None:
    """Raise ConfigError if the environment's reward lacks one of the terms."""
    if not weights:
        return
    probe = envs.make(env.name, **env.options)
    probe.reset(seed=0)
    info = probe.step(np.zeros(probe.action_space.shape))[4]  # the first has all terms
    probe.close()
    terms = list(info.get("reward_terms", {}))
    if unknown := sorted(set(weights) - set(terms)):
        raise ConfigError(
            f"shaping names {', '.join(unknown)}, which the reward of {env.name} does not have: "
            + (f"its terms are {', '.join(terms)}" if terms else "it has no named terms")
        )


def shape_reward(weights: Mapping[str, float], steps: Steps) -> NDArray[np.float64]:
    """Return the reward of each step (B,) with the extra weights."""
    # r' = r + sum over terms of weight x term
    extra = np.zeros(len(steps.reward))
    if weights:
        each = (info["reward_terms"] for info in steps.infos)
        extra += [sum(weight * terms[name] for name, weight in weights.items()) for terms in each]
    return steps.reward + extra
