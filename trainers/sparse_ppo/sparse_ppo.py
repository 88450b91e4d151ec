"""PPO after imitation: a pruned policy learns from reward, with its masks as they are.

Each iteration plays whole episodes with exploration and the chip's rounded weights, replays them in
windows, and takes a few clipped steps (Schulman et al. 2017). The error against the teacher and the
penalty on operations stay in the loss. The policy at the start is the first that is validated, so
that the best is never worse on the validation seeds.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.trainers.distill.teachers import teacher
from spikedeploy.trainers.policies import Policy
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.runner import Runner
from spikedeploy.trainers.sparse.collect import Episodes
from spikedeploy.trainers.sparse.on_chip import on_chip
from spikedeploy.trainers.sparse.pool import WalkPool
from spikedeploy.trainers.sparse.rounding import deployed
from spikedeploy.trainers.sparse_ppo.config import SparsePpoConfig
from spikedeploy.trainers.sparse_ppo.learner import SparsePpoLearner
from spikedeploy.trainers.sparse_ppo.start import starting_point, stored_start

_TRAINING_SEEDS = 5_000  # validation and evaluation are above


class SparsePpo(Runner[SparsePpoConfig]):
    """One run.

    iterations, env_steps: counters, continued by a resumed run
    start_return, allowed: mean validation return of the policy at the start, and the operations of
        a control step that the best may take
    """

    Config = SparsePpoConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "iterations", "env_steps", "operations", "gain", "imitation", "kl", "clipped",
        "learning_rate", "critic_loss", "explained", "iterations_per_s", "episode_return",
        "eval_return", "eval_gain", "eval_operations", "eval_falls", "eval_finish",
    )  # fmt: skip
    COUNTERS = ("iterations", "env_steps", "start_return", "allowed", "best")
    SPEED = "iterations_per_s"
    learner: SparsePpoLearner

    @classmethod
    def columns(cls, config: SparsePpoConfig) -> tuple[str, ...]:  # type: ignore[override]
        """Return the names of the metrics, of which the first is the step."""
        return cls.COLUMNS

    def __init__(self, config: SparsePpoConfig, run: RunFolder) -> None:
        runs = run.path.parent
        start, source, self.policy = starting_point(config, runs)
        # the folder says which policy is in it, and can be moved with its start
        more = {"policy": source.policy, "start": stored_start(start, runs)}
        config = config.model_copy(update=more)
        run.write_config(config)
        super().__init__(
            config,
            run,
            total=config.iterations,
            log_every=1,
            checkpoint_every=config.checkpoint_every,
        )
        self._source = source
        self._teacher = teacher(
            source.teacher, config.env.name, source.env.options, source.teacher_units
        )
        self._chip = chip(source.chip)
        count = max(config.episodes, config.validation.episodes)
        self._episodes = Episodes(config.env, count, config.validation.limit)
        self.learner = SparsePpoLearner(config, source, self.policy)
        self.iterations = self.env_steps = 0
        self.start_return = self.allowed = math.nan
        self._learned: dict[str, float] = {}
        self._first: dict[str, float] = {}

    def _begin(self) -> None:
        """Validate the policy at the start: the first candidate."""
        self._first = {**self._evaluate(), "eval_gain": 0.0}
        self.start_return = self.best = self._first["eval_return"]
        of_start = max(self._source.budget, self._first["eval_operations"])
        self.allowed = self._config.budget or of_start
        self._run.save("best", self._deployed(), {**self._counters(), **self._first})

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        config, learner = self._config, self.learner
        learner.schedule(self.iterations / max(self._total - 1, 1))
        learner.student.round(self._chip)
        controller = learner.exploring()
        seeds = self._rng.integers(_TRAINING_SEEDS, size=config.episodes).tolist()
        walks, returns, _ = self._episodes.play(seeds, controller, self._teacher.act_all)
        self._returns += returns
        pool = WalkPool()
        pool.add(walks)
        self._learned = learner.learn(
            pool,
            torch.stack(controller.drawn),
            self._episodes.earned,
            actor=self.iterations >= config.warm_up,
        )
        self.env_steps += pool.steps
        self.iterations += 1
        return True

    def _deployed(self) -> Policy:
        return deployed(self.policy, self._chip, self._source.rounding)

    def _evaluate(self) -> dict[str, float]:
        first = self._config.validation.first_seed
        seeds = range(first, first + self._config.validation.episodes)
        controller = on_chip(self._deployed(), self._chip)
        walks, returns, infos = self._episodes.play(seeds, controller, self._teacher.act_all)
        pool = WalkPool()
        pool.add(walks)
        row = {
            "eval_return": float(np.mean(returns)),
            "eval_operations": self.learner.operations(pool),
        }
        row["eval_gain"] = row["eval_return"] - self.start_return
        for key, column in (("fall", "eval_falls"), ("finish", "eval_finish")):
            if key in infos[0]:
                row[column] = float(np.mean([info[key] for info in infos]))
        return row

    def _validate(self) -> dict[str, float]:
        """Validate the policy, and save it as "best" if it is, within the operations allowed."""
        row = self._evaluate()
        if row["eval_return"] > self.best and row["eval_operations"] <= self.allowed:
            self.best = row["eval_return"]
            self._run.save("best", self._deployed(), {**self._counters(), **row})
        return row

    def _report(self, journal: Any, before: int) -> None:  # noqa: ANN401
        if self._first:
            journal.add({"iterations": 0, "env_steps": 0, **self._first})
            self._first = {}
        super()._report(journal, before)

    def _metrics(self) -> dict[str, float]:
        return {"iterations": self.iterations, "env_steps": self.env_steps, **self._learned}

    def _state(self) -> dict[str, Any]:
        return {"first": self._first}

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        self.iterations, self.env_steps = state["iterations"], state["env_steps"]
        self.start_return, self.allowed = state["start_return"], state["allowed"]
        self._first = state.get("first", {})  # its row, where a stop came before the first report
