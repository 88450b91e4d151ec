"""Distillation by DAgger: a student learns what its teacher would do where the student goes.

Iteration 0 gathers states along the teacher's way, every later one along the student's, so that the
student learns to recover from its own mistakes. The teacher labels all of them, and the student
learns from all that was gathered so far (Ross et al. 2011).
"""

import time
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill_config import DistillConfig
from spikedeploy.trainers.distill_learner import DistillLearner
from spikedeploy.trainers.gather import fresh, walk
from spikedeploy.trainers.journal import Journal
from spikedeploy.trainers.lessons import DaggerDataset
from spikedeploy.trainers.normalizer import Moments
from spikedeploy.trainers.policies import from_config
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.teachers import of_policy, score, teacher
from spikedeploy.trainers.validation import Validator, sparsities

COLUMNS = (
    "updates",
    "env_steps",
    "iteration",
    "loss",
    "rate_penalty",
    "updates_per_s",
    "episode_return",
    "eval_return",
    "eval_of_teacher",
    "eval_speed",
    "eval_cot",
    "eval_falls",
    "eval_speed_rmse",
    "eval_turn_rmse",
)


class Distill:
    """One run of distillation.

    updates, iterations: counters, which a resumed run continues
    lessons: every labelled state so far
    """

    Config: ClassVar[type[DistillConfig]] = DistillConfig

    @staticmethod
    def columns(config: DistillConfig) -> tuple[str, ...]:
        """Return the names of the metrics, the first of which is the step."""
        return (*COLUMNS, *sparsities(config.policy))

    def __init__(self, config: DistillConfig, run: RunFolder) -> None:
        self._config, self._run = config, run
        torch.manual_seed(config.seed)
        self._rng = np.random.default_rng(config.seed)
        self._teacher = teacher(config.teacher, config.env.name)
        self._validate = Validator(config.env, config.validation)
        envs = fresh(config, 0)
        envs.demand_numbers("distill")
        sizes = envs.observation.shape[1], envs.actions
        if sizes != (self._teacher.observations, self._teacher.actions):
            raise ConfigError(
                f"the teacher {config.teacher} takes {self._teacher.observations} observations and "
                f"gives {self._teacher.actions} actions; {config.env.name} has {sizes}"
            )
        self.policy = from_config(config.policy, *sizes, config.normaliser.clip, envs.columns)
        self.learner = DistillLearner(config, self.policy)
        self.lessons = DaggerDataset(*sizes)
        self.updates = self.iterations = 0
        self.best = -np.inf
        self.teacher_return = np.nan
        self._losses: Mapping[str, Tensor] = {}
        self._returns: list[float] = []

    def learn(self, journal: Journal, stopped: Callable[[], bool]) -> None:
        """Train to the end, or until stopped; leave checkpoints in the run."""
        if self._run.checkpoint("last").is_file():
            self._resume()
            journal.rewind(self.updates)
            if self.updates >= self._config.updates:
                return
        else:
            self.teacher_return = score(self._teacher, self._config.env, self._config.validation)
        self._clock = time.perf_counter(), self.updates
        while self.updates < self._config.updates and not stopped():
            if self._due_for_lessons and not self._gather(stopped):
                break
            self._update()
            journal.at(self.updates, self._config.updates)
            self._report(journal)
        self._checkpoint()

    @property
    def env_steps(self) -> int:
        """Environment steps so far; each has become a lesson."""
        return len(self.lessons)

    @property
    def _due_for_lessons(self) -> bool:
        """Whether the updates of the iterations gathered so far are done."""
        done = self.updates * self._config.iterations // self._config.updates
        return self.iterations <= done

    def _gather(self, stopped: Callable[[], bool]) -> bool:
        """Walk, keep the labelled states, and return whether that was not stopped."""
        student = of_policy(self.policy)
        found = walk(self._config, self.iterations, self._teacher, student, stopped)
        if found is None:
            return False
        self.lessons.add(found.observation, found.label)
        self._returns = found.returns
        self.iterations += 1
        self._settle()
        return True

    @torch.no_grad()
    def _settle(self) -> None:
        """Fit the normaliser to the lessons, as long as it is not frozen."""
        if self.iterations > 1 and self.env_steps > self._config.normaliser.finish:
            return
        seen = self.policy.seen(self.lessons.observation.double()).numpy()
        moments = Moments.empty(seen.shape[1])
        moments.add(seen)
        self.policy.normalizer.adopt(moments)

    def _update(self) -> None:
        """Take one gradient step on lessons drawn at random."""
        lesson = self.lessons.sample(self._config.batch, self._rng)
        self._losses = self.learner.update(*lesson, self.updates / self._config.updates)
        self.updates += 1

    def _report(self, journal: Journal) -> None:
        """Validate, write metrics and checkpoints where they are due."""
        row: dict[str, float] = {}
        finished = self.updates == self._config.updates
        if finished or self.updates % self._config.validation.every == 0:
            row = self._validation()
        if row or self.updates % self._config.log_every == 0:
            journal.add({**self._row(), **row})
        if self.updates % self._config.checkpoint_every == 0:
            self._checkpoint()

    def _validation(self) -> dict[str, float]:
        """Return the metrics of the student as it is, and keep it when it is the best."""
        row = self._validate(self.policy)
        row["eval_of_teacher"] = row["eval_return"] / self.teacher_return
        if row["eval_return"] >= self.best:
            self.best = row["eval_return"]
            self._run.save("best", self.policy, {**self._counters(), **row})
        return row

    def _row(self) -> dict[str, float]:
        """Return the metrics of training since the last row."""
        returns, self._returns = self._returns, []
        (then, updates), now = self._clock, time.perf_counter()
        self._clock = now, self.updates
        row = {
            "updates": self.updates,
            "env_steps": self.env_steps,
            "iteration": self.iterations - 1,
            "updates_per_s": (self.updates - updates) / (now - then),
            **{name: float(loss) for name, loss in self._losses.items()},
        }
        return {**row, "episode_return": float(np.mean(returns))} if returns else row

    def _counters(self) -> dict[str, Any]:
        names = ("updates", "env_steps", "iterations", "teacher_return")
        return {
            **{name: getattr(self, name) for name in names},
            "best": self.best if np.isfinite(self.best) else None,
        }

    def _checkpoint(self) -> None:
        """Write everything that going on needs."""
        tensors = {**self.learner.tensors(), **self.lessons.tensors()}
        state = {**self._counters(), "rng": self._rng.bit_generator.state}
        self._run.save("last", self.policy, state, tensors)

    def _resume(self) -> None:
        """Take over the last checkpoint."""
        state, tensors = self._run.load("last")
        self.learner.load(tensors)
        self.lessons.load(tensors)
        self.updates, self.iterations = state["updates"], state["iterations"]
        self.teacher_return = state["teacher_return"]
        self.best = -np.inf if state["best"] is None else state["best"]
        self._rng.bit_generator.state = state["rng"]
