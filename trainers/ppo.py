"""Proximal policy optimisation: act in a batch of environments, learn from the newest steps."""

import time
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from spikedeploy.trainers.collect import EnvBatch, Steps
from spikedeploy.trainers.episode_log import EpisodeLog
from spikedeploy.trainers.experience import Transition
from spikedeploy.trainers.ghost_log import GhostLog, leaves_ghosts
from spikedeploy.trainers.journal import Journal
from spikedeploy.trainers.normalizer import Moments
from spikedeploy.trainers.policies import from_config
from spikedeploy.trainers.ppo_config import PpoConfig
from spikedeploy.trainers.ppo_learner import PpoLearner
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.validation import Validator, sparsities

COLUMNS = (
    "env_steps",
    "iterations",
    "episodes",
    "finishes",
    "episode_return",
    "actor_loss",
    "critic_loss",
    "entropy",
    "kl",
    "clipped",
    "learning_rate",
    "steps_per_s",
    "eval_return",
    "eval_finish",
    "eval_crash",
    "eval_gates",
    "eval_speed",
)


class Ppo:
    """One run of proximal policy optimisation.

    env_steps, iterations, episodes: counters, which a resumed run continues
    """

    Config: ClassVar[type[PpoConfig]] = PpoConfig

    @staticmethod
    def columns(config: PpoConfig) -> tuple[str, ...]:
        """Return the names of the metrics, the first of which is the step."""
        return (*COLUMNS, *sparsities(config.policy))

    def __init__(self, config: PpoConfig, run: RunFolder) -> None:
        self._config, self._run = config, run
        torch.manual_seed(config.seed)
        self._rng = np.random.default_rng(config.seed)
        self._envs = EnvBatch(config.env, self._rng)
        self._validate = Validator(config.env, config.validation)
        self.policy = from_config(
            config.policy,
            self._envs.observation.shape[1],
            self._envs.actions,
            config.normaliser.clip,
            self._envs.columns,
            self._envs.head,
        )
        self.learner = PpoLearner(config, self.policy)
        self._moments = Moments.empty(self.policy.normalizer.mean.numel())
        self.env_steps = self.iterations = self.episodes = 0
        self.best = -np.inf
        self._log: EpisodeLog | None = None
        self._ghosts: GhostLog | None = None
        self._clock = time.perf_counter(), 0

    def learn(self, journal: Journal, stopped: Callable[[], bool]) -> None:
        """Train to the end, or until stopped; leave checkpoints in the run."""
        self._log = EpisodeLog(self._run.path / "episodes.csv", len(self._envs))
        if self._config.ghosts and leaves_ghosts(self._envs):
            self._ghosts = GhostLog(self._run.path / "ghosts", self._envs, self._config.env)
        if self._run.checkpoint("last").is_file():
            self._resume(self._log)
            journal.rewind(self.env_steps)
        if self._finished:
            return
        self._clock = time.perf_counter(), self.env_steps
        while not (self._finished or stopped()):
            before = self.env_steps
            self.learner.schedule(before)
            metrics = self.learner.learn(self.collect(self._log))
            self.iterations += 1
            journal.at(self.env_steps, self._config.steps)
            self._report(journal, metrics, before)
        self._checkpoint()

    @property
    def _finishes(self) -> int:
        return self._log.finishes if self._log else 0

    @property
    def _finished(self) -> bool:
        """Whether the budget is spent, or as many episodes finished as were asked for."""
        enough = 0 < self._config.stop_at_finishes <= self._finishes
        return enough or self.env_steps >= self._config.steps

    def _due(self, every: int, before: int) -> bool:
        """Return whether the newest steps passed a multiple of `every`."""
        return self.env_steps // every > before // every

    def collect(self, log: EpisodeLog) -> list[Transition]:
        """Take as many steps in every environment as the horizon says."""
        moments = []
        for _ in range(self._config.horizon):
            observation = torch.from_numpy(self._envs.observation).float()
            perceived, drawn, log_probability = self.learner.explore(observation)
            steps = self._envs.step(self.learner.head.action(drawn).numpy())
            moments.append(_moment(observation, steps, perceived, drawn, log_probability))
            log.add(steps, self.env_steps)
            if self._ghosts:
                self._ghosts.add(steps, self.env_steps)
            self.env_steps += len(self._envs)
        self._observe(moments)
        return moments

    def _observe(self, moments: list[Transition]) -> None:
        """Normalise by what was seen so far, until that is frozen."""
        if self.env_steps - len(moments) * len(self._envs) < self._config.normaliser.finish:
            for moment in moments:
                self._moments.add(self.policy.seen(moment.observation).double().numpy())
            self.policy.normalizer.adopt(self._moments)

    def _report(self, journal: Journal, metrics: dict[str, float], before: int) -> None:
        """Write metrics and ghosts, and validate and write checkpoints where they are due."""
        if self._ghosts:
            self._ghosts.save(self.iterations)
        row = self._row(before) | metrics
        if self._due(self._config.validation.every, before) or self._finished:
            found = self._validate(self.policy)
            row |= found
            if found["eval_return"] >= self.best:
                self.best = found["eval_return"]
                self._run.save("best", self.policy, {**self._counters(), **found})
        journal.add({name: row[name] for name in journal.metrics.columns if name in row})
        if self._due(self._config.checkpoint_every, before):
            self._checkpoint()

    def _row(self, before: int) -> dict[str, float]:
        """Return the metrics of training since the last row."""
        returns, self._envs.returns = self._envs.returns, []
        self.episodes += len(returns)
        (then, steps), now = self._clock, time.perf_counter()
        self._clock = now, self.env_steps
        row = {
            **{name: getattr(self, name) for name in ("env_steps", "iterations", "episodes")},
            "finishes": self._finishes,
            "learning_rate": self._config.actor_rate.at(before),
            "steps_per_s": (self.env_steps - steps) / (now - then),
        }
        return {**row, "episode_return": float(np.mean(returns))} if returns else row

    def _counters(self) -> dict[str, Any]:
        names = ("env_steps", "iterations", "episodes", "best")
        return {**{name: getattr(self, name) for name in names}, "finishes": self._finishes}

    def _checkpoint(self) -> None:
        """Write everything that going on needs."""
        tensors = {
            **self.learner.tensors(),
            **self._moments.tensors(),
            "torch_rng": torch.get_rng_state(),
        }
        state = {
            **self._counters(),
            "best": self.best if np.isfinite(self.best) else None,
            "finished": self._finished,
            "observed": self._moments.count,
            "rng": self._rng.bit_generator.state,
        }
        self._run.save("last", self.policy, state, tensors)

    def _resume(self, log: EpisodeLog) -> None:
        """Take over the last checkpoint; episodes that were under way begin anew."""
        state, tensors = self._run.load("last")
        self.learner.load(tensors)
        self._moments = Moments.restored(tensors, state["observed"])
        self.env_steps, self.iterations = state["env_steps"], state["iterations"]
        self.episodes, log.finishes = state["episodes"], state["finishes"]
        self.best = -np.inf if state["best"] is None else state["best"]
        self._rng.bit_generator.state = state["rng"]
        torch.set_rng_state(tensors["torch_rng"])
        log.rewind(self.env_steps)
        if self._ghosts:
            self._ghosts.rewind(self.iterations)


def _moment(
    observation: Tensor, steps: Steps, perceived: Tensor, drawn: Tensor, log_probability: Tensor
) -> Transition:
    return Transition(
        perceived=perceived,
        observation=observation,
        following=torch.from_numpy(steps.following).float(),
        drawn=drawn,
        log_probability=log_probability,
        reward=torch.from_numpy(steps.reward).float(),
        terminated=torch.from_numpy(steps.terminated),
        ended=torch.from_numpy(steps.terminated | steps.truncated),
    )
