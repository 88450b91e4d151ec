"""Soft actor-critic: act in a batch of environments, learn from replay, validate, checkpoint."""

import time
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.trainers.buffers import ReplayBuffer
from spikedeploy.trainers.collect import EnvBatch
from spikedeploy.trainers.config import SacConfig
from spikedeploy.trainers.journal import Journal
from spikedeploy.trainers.normalizer import Moments
from spikedeploy.trainers.policies import from_config
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sac_learner import SacLearner
from spikedeploy.trainers.validation import Validator, sparsities

COLUMNS = (
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


class Sac:
    """One run of soft actor-critic.

    env_steps, updates, episodes: counters, which a resumed run continues
    """

    Config: ClassVar[type[SacConfig]] = SacConfig

    @staticmethod
    def columns(config: SacConfig) -> tuple[str, ...]:
        """Return the names of the metrics, the first of which is the step."""
        return (*COLUMNS, *sparsities(config.policy))

    def __init__(self, config: SacConfig, run: RunFolder) -> None:
        self._config, self._run = config, run
        torch.manual_seed(config.seed)
        self._rng = np.random.default_rng(config.seed)
        self._envs = EnvBatch(config.env, self._rng)
        self._envs.demand_numbers("sac")
        self._validate = Validator(config.env, config.validation)
        sizes = self._envs.observation.shape[1], self._envs.actions
        self.policy = from_config(config.policy, *sizes, config.normaliser.clip, self._envs.columns)
        self.learner = SacLearner(config, self.policy)
        self._buffer = ReplayBuffer(min(config.buffer, config.steps), *sizes)
        self._moments = Moments.empty(sizes[0])
        self.env_steps = self.updates = self.episodes = 0
        self.best = -np.inf
        self._losses: Mapping[str, Tensor] = {}
        self._clock = time.perf_counter(), 0

    def learn(self, journal: Journal, stopped: Callable[[], bool]) -> None:
        """Train to the end, or until stopped; leave checkpoints in the run."""
        if self._run.checkpoint("last").is_file():
            self._resume()
            journal.rewind(self.env_steps)
        if self.env_steps >= self._config.steps:
            return
        self._clock = time.perf_counter(), self.env_steps
        while self.env_steps < self._config.steps and not stopped():
            self._collect()
            self._update()
            journal.at(self.env_steps, self._config.steps)
            self._report(journal)
        self._checkpoint()

    @property
    def _temperature(self) -> float:
        return self._config.temperature.at(self.env_steps)

    @property
    def _hoist(self) -> float:
        return self._config.support_force.at(self.env_steps)

    def _due(self, every: int) -> bool:
        """Return whether the newest steps passed a multiple of `every`."""
        return self.env_steps // every > (self.env_steps - len(self._envs)) // every

    def _collect(self) -> None:
        """Take one step in every environment and remember it."""
        self._envs.support_force(self._hoist)
        steps = self._envs.step(self._actions())
        self._buffer.add(
            steps.observation, steps.action, steps.reward, steps.terminated, steps.following
        )
        if self.env_steps < self._config.normaliser.finish:
            self._moments.add(steps.observation)
            self.learner.adopt(self._moments)
        self.env_steps += len(self._envs)

    @torch.no_grad()
    def _actions(self) -> NDArray[np.float64]:
        """Return exploring actions (B, act): uniform while warming up, then the actor's."""
        if self.env_steps < self._config.warm_up:
            return self._envs.uniform()
        observation = torch.from_numpy(self._envs.observation).float()
        action: Tensor = self.learner.actor(observation)[0]
        return action.double().numpy()

    def _update(self) -> None:
        """Catch up with the updates that the steps so far call for."""
        wanted = (self.env_steps - self._config.warm_up) // self._config.update_every
        while self.updates < wanted:
            batch = self._buffer.sample(self._config.batch, self._rng)
            self._losses = self.learner.update(batch, self._temperature)
            self.updates += 1
            self.learner.average(self.updates)

    def _report(self, journal: Journal) -> None:
        """Validate, write metrics and checkpoints where they are due."""
        row: dict[str, float] = {}
        if self._due(self._config.validation.every):
            row = self._validate(self.policy)
            if row["eval_return"] >= self.best:
                self.best = row["eval_return"]
                self._run.save("best", self.policy, {**self._counters(), **row})
        if row or self._due(self._config.log_every):
            journal.add({**self._row(), **row})
        if self._due(self._config.checkpoint_every):
            self._checkpoint()

    def _row(self) -> dict[str, float]:
        """Return the metrics of training since the last row."""
        returns, self._envs.returns = self._envs.returns, []
        self.episodes += len(returns)
        (then, steps), now = self._clock, time.perf_counter()
        self._clock = now, self.env_steps
        row = {
            "env_steps": self.env_steps,
            "updates": self.updates,
            "episodes": self.episodes,
            "support_force": self._hoist,
            "temperature": self._temperature,
            "steps_per_s": (self.env_steps - steps) / (now - then),
            **{name: float(loss) for name, loss in self._losses.items()},
        }
        return {**row, "episode_return": float(np.mean(returns))} if returns else row

    def _counters(self) -> dict[str, Any]:
        names = ("env_steps", "updates", "episodes", "best")
        return {name: getattr(self, name) for name in names}

    def _checkpoint(self) -> None:
        """Write everything that going on needs; at the end the replay is no longer needed."""
        tensors = {
            **self.learner.tensors(),
            **self._moments.tensors(),
            "torch_rng": torch.get_rng_state(),
        }
        finished = self.env_steps >= self._config.steps
        if not finished:
            self._buffer.save(self._run.replay)
        state = {
            **self._counters(),
            "best": self.best if np.isfinite(self.best) else None,
            "finished": finished,
            "observed": self._moments.count,
            "rng": self._rng.bit_generator.state,
        }
        self._run.save("last", self.policy, state, tensors)
        if finished:
            self._run.replay.unlink(missing_ok=True)

    def _resume(self) -> None:
        """Take over the last checkpoint; episodes that were under way begin anew."""
        state, tensors = self._run.load("last")
        self.learner.load(tensors)
        self._moments = Moments.restored(tensors, state["observed"])
        self.env_steps, self.updates = state["env_steps"], state["updates"]
        self.episodes = state["episodes"]
        self.best = -np.inf if state["best"] is None else state["best"]
        self._rng.bit_generator.state = state["rng"]
        torch.set_rng_state(tensors["torch_rng"])
        if self.env_steps < self._config.steps:
            self._buffer.load(self._run.replay)
