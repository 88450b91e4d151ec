"""Soft actor-critic (Haarnoja et al. 2018): a run of it."""

import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy import envs
from spikedeploy.files import flush
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.env_batch import Steps
from spikedeploy.trainers.policies import from_config
from spikedeploy.trainers.run_folder import RunFolder, of_file, write_errors
from spikedeploy.trainers.runner import EnvRunner
from spikedeploy.trainers.sac.cuda import CudaLearner, CudaReplay
from spikedeploy.trainers.sac.learner import ReplayBuffer, SacConfig, SacLearner, damaged

# -- Shaping: extra weights of reward terms in training, beside the reward that is reported.


def check_shaping(weights: Mapping[str, float], env: EnvConfig) -> None:
    """Raise ConfigError if the environment's reward lacks one of the terms."""
    if not weights:
        return
    terms = _terms(env)
    unknown = sorted(set(weights) - set(terms))
    if unknown:
        raise ConfigError(
            f"shaping names {', '.join(unknown)}, which the reward of {env.name} does not have: "
            + (f"its terms are {', '.join(terms)}" if terms else "it has no named terms")
        )


def shaped(weights: Mapping[str, float], steps: Steps) -> NDArray[np.float64]:
    """Return the reward of each step (B,) with the extra weights."""
    # r' = r + sum over terms of weight x term
    extra = [_weighted(weights, info["reward_terms"]) for info in steps.infos] if weights else 0.0
    return steps.reward + extra


def _weighted(weights: Mapping[str, float], terms: Mapping[str, float]) -> float:
    return sum(weight * terms[name] for name, weight in weights.items())


def _terms(env: EnvConfig) -> Iterable[str]:
    """Return the names of the reward's terms, which the info of a first step has."""
    probe = envs.make(env.name, **env.options)
    probe.reset(seed=0)
    found: Mapping[str, float] = probe.step(np.zeros(probe.action_space.shape))[4].get(
        "reward_terms", {}
    )
    probe.close()
    return list(found)


# -- Soft actor-critic (Haarnoja et al. 2018): a run of it.


class Sac(EnvRunner[SacConfig]):
    """One run of soft actor-critic.

    updates: gradient updates so far
    """

    Config = SacConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "env_steps",
        "updates",
        "episodes",
        "episode_return",
        "support_force",
        "temperature",
        "actor_loss",
        "critic_loss",
        "entropy",
        "steps_per_s",
        "eval_return",
        "eval_speed",
        "eval_cot",
        "eval_falls",
        "eval_speed_rmse",
        "eval_turn_rmse",
    )
    COUNTERS = ("env_steps", "updates", "episodes", "best")
    VALIDATES_AT_END = False
    learner: SacLearner

    def __init__(self, config: SacConfig, run: RunFolder) -> None:
        super().__init__(
            config,
            run,
            total=config.steps,
            log_every=config.log_every,
            checkpoint_every=config.checkpoint_every,
        )
        self._envs.require_continuous("sac")
        check_shaping(config.shaping, config.env)
        sizes = self._envs.observation.shape[1], self._envs.actions
        self.policy = from_config(config.policy, *sizes, config.normaliser.clip, self._envs.columns)
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
    def _temperature(self) -> float:
        if self.learner.temperature is not None:
            return self.learner.temperature.value
        return self._config.temperature.at(self.env_steps)

    @property
    def _support_force(self) -> float:
        return self._config.support_force.at(self.env_steps)

    def _collect(self) -> None:
        """Take one step in every environment, and store it."""
        self._envs.support_force(self._support_force)
        steps = self._envs.step(self._actions())
        reward = shaped(self._config.shaping, steps)
        self._buffer.add(steps.observation, steps.action, reward, steps.terminated, steps.following)
        if self.env_steps < self._config.normaliser.finish:
            self._moments.add(steps.observation)
            self.learner.adopt(self._moments)
        self.env_steps += len(self._envs)

    def _actions(self) -> NDArray[np.float64]:
        """Return exploring actions (B, act): uniform during warm-up, then the actor's."""
        if self.env_steps < self._config.warm_up:
            return self._envs.uniform()
        return self.learner.explore(self._envs.observation)

    def _update(self) -> None:
        """Make the updates that are due after the steps so far."""
        wanted = (self.env_steps - self._config.warm_up) // self._config.update_every
        scheduled = self._config.temperature.at(self.env_steps)
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
        return {
            "env_steps": self.env_steps,
            "updates": self.updates,
            "episodes": self.episodes,
            "support_force": self._support_force,
            "temperature": self._temperature,
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
            elif run.next_replay.is_file() and of_file(run.next_replay) == checksum:
                os.replace(run.next_replay, run.replay)
                flush(run.path)
            run.next_replay.unlink(missing_ok=True)

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        super()._restore(state, tensors)
        self.updates, self._losses = state["updates"], state.get("losses", {})
        checksum = state.get("replay_sha256")
        if "replay_sha256" in state:  # not in checkpoints of before
            self._take_replay(checksum)
        if self.finished:
            return
        if checksum and self._run.replay.is_file() and of_file(self._run.replay) != checksum:
            why = "its content does not have the checksum in checkpoints/last"
            raise ConfigError(damaged(self._run.replay, why))
        self._buffer.load(self._run.replay)
