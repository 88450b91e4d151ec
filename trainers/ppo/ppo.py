"""Proximal policy optimisation: act in a batch of environments, learn from the newest steps."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.trainers.config import RunConfig
from spikedeploy.trainers.env_batch import Steps
from spikedeploy.trainers.journal import Journal
from spikedeploy.trainers.policies import from_config
from spikedeploy.trainers.ppo.batch import Transition
from spikedeploy.trainers.ppo.config import PpoConfig
from spikedeploy.trainers.ppo.episodes import EpisodeLog, GhostLog, episode_table, has_poses
from spikedeploy.trainers.ppo.learner import PpoLearner
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.runner import EnvRunner
from spikedeploy.trainers.tables import Table


class Ppo(EnvRunner[PpoConfig]):
    """One run of proximal policy optimisation.

    iterations: batches collected and learned from so far
    held: latest validations in a row in which at least `stop_at_greedy` of the episodes finished
    """

    Config = PpoConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
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
    COUNTERS = ("env_steps", "iterations", "episodes", "best", "finishes", "held")
    learner: PpoLearner

    def __init__(self, config: PpoConfig, run: RunFolder) -> None:
        super().__init__(
            config,
            run,
            total=config.steps,
            log_every=1,  # every iteration
            checkpoint_every=config.checkpoint_every,
        )
        self.policy = from_config(
            config.policy,
            self._envs.observation.shape[1],
            self._envs.actions,
            config.normaliser.clip,
            self._envs.columns,
            self._envs.head,
        )
        self.learner = PpoLearner(config, self.policy)
        self.iterations = self.held = 0
        self._totals: NDArray[np.float64] = np.zeros(len(self._envs))  # of the running episodes
        self._learned: dict[str, float] = {}
        self._log: EpisodeLog | None = None
        self._ghosts: GhostLog | None = None

    def learn(self, journal: Journal, stopped: Callable[[], bool]) -> None:
        """Train, from the checkpoint "last" if there is one, to the end or until stopped."""
        self._log = EpisodeLog(self._run.path, len(self._envs))
        if self._config.ghosts and has_poses(self._envs):
            self._ghosts = GhostLog(self._run.path / "ghosts", self._envs, self._config.env)
        super().learn(journal, stopped)

    def _forget(self) -> None:
        super()._forget()
        if self._ghosts:
            self._ghosts.rewind(0)

    @classmethod
    def tables(cls, run: RunFolder, config: RunConfig) -> list[Table]:
        """Return the tables that training appends to, and a checkpoint must agree with."""
        return [*super().tables(run, config), episode_table(run.path)]

    @property
    def finishes(self) -> int:
        """Episodes that ended at the finish."""
        return self._log.finishes if self._log else 0

    @property
    def finished(self) -> bool:
        """Whether all steps are taken, or as much was reached as was asked for."""
        return self._config.reached(self.finishes, self.held) or super().finished

    def _validate(self) -> dict[str, float]:
        row = super()._validate()
        enough = row.get("eval_finish", 0.0) >= self._config.stop_at_greedy
        self.held = self.held + 1 if enough else 0
        return row

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        before = self.env_steps
        self.learner.schedule(before)
        self._learned = self.learner.learn(self.collect(self._log))
        self._learned["learning_rate"] = self._config.actor_rate.at(before)
        self.iterations += 1
        self._count_episodes()
        if self._ghosts:
            self._ghosts.save(self.iterations)
        return True

    def collect(self, log: EpisodeLog | None = None) -> list[Transition]:
        """Take `horizon` steps in every environment."""
        transitions = []
        for _ in range(self._config.horizon):
            observation = torch.from_numpy(self._envs.observation).float()
            encoded, drawn, log_probability = self.learner.explore(observation)
            steps = self._envs.step(self.learner.head.action(drawn).numpy())
            paid = self._paid(steps)
            transitions.append(
                _transition(observation, steps, paid, encoded, drawn, log_probability)
            )
            if log:
                log.add(steps, self.env_steps)
            if self._ghosts:
                self._ghosts.add(steps, self.env_steps)
            self.env_steps += len(self._envs)
        self._update_normaliser(transitions)
        return transitions

    def _paid(self, steps: Steps) -> NDArray[np.float64]:
        """Return the rewards (B,) to learn from: of the step, or of the episode so far."""
        if not self._config.running_total:
            return steps.reward
        self._totals += steps.reward
        paid: NDArray[np.float64] = self._totals.copy()
        self._totals[steps.terminated | steps.truncated] = 0.0
        return paid

    def _update_normaliser(self, transitions: list[Transition]) -> None:
        """Add the observations to the normaliser, unless it is frozen."""
        begin = self.env_steps - len(transitions) * len(self._envs)
        if begin < self._config.normaliser.finish:
            for transition in transitions:
                seen = self.policy.features_of(transition.observation)
                self._moments.add(seen.double().numpy())
            self.policy.normalizer.adopt(self._moments)

    def _metrics(self) -> dict[str, float]:
        names = ("env_steps", "iterations", "episodes", "finishes")
        return {**{name: getattr(self, name) for name in names}, **self._learned}

    def _state(self) -> dict[str, Any]:
        return {**super()._state(), "episode_logged": self._log.latest if self._log else None}

    def episode_begun(self, k: int) -> None:
        """Forget what copy k did: its episode begins, when a run is resumed."""
        self._totals[k] = 0.0
        if self._log:
            self._log.begin(k)
        if self._ghosts:
            self._ghosts.begin(k)

    def step_repeated(
        self, k: int, action: NDArray[Any], reward: float, info: Mapping[str, Any]
    ) -> None:
        """Take a step of copy k into account that is repeated when a run is resumed."""
        self._totals[k] += reward
        if self._log:
            self._log.repeat(k, reward)
        if self._ghosts:
            self._ghosts.repeat(k, action, reward, info)

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        super()._restore(state, tensors)
        self.iterations, self.held = state["iterations"], state.get("held", 0)
        if self._log:
            self._log.finishes = state["finishes"]
            self._log.latest = state.get("episode_logged")
            self._log.rewind(self.env_steps)
        if self._ghosts:
            self._ghosts.rewind(self.iterations)


def _transition(
    observation: Tensor,
    steps: Steps,
    paid: NDArray[np.float64],
    encoded: Tensor,
    drawn: Tensor,
    log_probability: Tensor,
) -> Transition:
    return Transition(
        encoded=encoded,
        observation=observation,
        following=torch.from_numpy(steps.following).float(),
        drawn=drawn,
        log_probability=log_probability,
        reward=torch.from_numpy(paid).float(),
        terminated=torch.from_numpy(steps.terminated),
        ended=torch.from_numpy(steps.terminated | steps.truncated),
    )
