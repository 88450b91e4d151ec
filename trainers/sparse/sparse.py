"""Sparse policies: imitation of a teacher through whole walks, pruned by operations in rounds.

A dense student learns from windows of walks; then each round prunes to fewer operations, trains on,
and lets the student walk, so that the teacher can label what it now does. Policies are chosen by
their return on the chip.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill.teachers import teacher
from spikedeploy.trainers.env_batch import EnvBatch
from spikedeploy.trainers.learner import adam, adam_tensors, load_adam, under
from spikedeploy.trainers.policies import DeltaMlpPolicy, DeltaSnnPolicy, Policy, from_config
from spikedeploy.trainers.policies.policy import Moments
from spikedeploy.trainers.policies.pruned_mlp import PrunedWeight
from spikedeploy.trainers.run_folder import LEVEL, RunFolder, of_file
from spikedeploy.trainers.runner import Runner
from spikedeploy.trainers.sparse.config import SparseConfig, phases
from spikedeploy.trainers.sparse.pool import (
    Episodes,
    Stateless,
    Walk,
    WalkPool,
    collected,
    pool_file,
    pool_files,
    save_walks,
    walks_of,
)
from spikedeploy.trainers.sparse.student import (
    DeltaStudent,
    Student,
    binary_columns,
    check_rounding,
    deployed,
    in_float,
    on_chip,
    operations,
    prune,
    remove_neurons,
    retuned,
    rounding_offsets,
    student,
    tuned_thresholds,
)

# -- A student that learns from a pool of walks, and is pruned.

_DENSE_BUDGET = 4_000.0  # operations for which the penalty is scaled while nothing is pruned
_REMOVED = 1  # neurons at most in one pruning


class SparseLearner:
    """Gradient updates of a student towards its teacher, and pruning by Adam's second moments.

    student: what learns
    """

    def __init__(self, config: SparseConfig, student: Student) -> None:
        self._config = config
        self.student = student
        self.restart()

    def restart(self) -> None:
        """Begin with a new optimiser."""
        self.optimizer = adam(self.student.policy, self._config.learning_rate)

    def update(self, pool: WalkPool, rng: np.random.Generator, rate: float, dense: bool) -> float:
        """Take one gradient step, and return the error; `dense` before anything is pruned."""
        config = self._config
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        error, hidden = self.student.loss(pool, rng)
        budget = _DENSE_BUDGET if dense else max(config.budget, config.penalty_floor)
        self.optimizer.zero_grad()
        (error + config.penalty * hidden / budget).backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.student.policy.parameters(), 1.0)
        self.optimizer.step()
        return float(error.detach())

    def prune(self, goal: float) -> None:
        """Take out synapses, and neurons that are not worth their updates, down to the goal."""
        squares = self._squares()
        if not squares:
            return
        for into, out in self.student.hidden_layers():
            remove_neurons(into, out, squares, self._config.neuron_cost, _REMOVED)
        prune(self.student.synapses(), squares, goal)

    def _squares(self) -> Mapping[PrunedWeight, Tensor]:
        """Adam's second moment of each weight; nothing before its first step."""
        matrices = [m for m in self.student.policy.modules() if isinstance(m, PrunedWeight)]
        state = self.optimizer.state
        return {m: state[m.weight]["exp_avg_sq"] for m in matrices if m.weight in state}

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name."""
        state = adam_tensors(self.optimizer)
        own = {f"student.{name}": value for name, value in self.student.tensors().items()}
        return {**own, **{f"adam.{name}": value for name, value in state.items()}}

    def load(self, named: dict[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        self.student.policy.load_state_dict(under("policy", named))
        self.student.load(under("student", named))
        load_adam(self.optimizer, under("adam", named))


# -- Sparse policies: imitation of a teacher through whole walks, pruned by operations in
#    rounds.

_TRAINING_SEEDS = 5_000  # validation and evaluation are above
_TOGETHER = 50  # copies of the environment


class Sparse(Runner[SparseConfig]):
    """One run.

    updates, phase, start, collections: counters, continued by a resumed run; `start` are the
        operations when the phase began, `collections` the files of walks
    pool: all walks so far
    teacher_return: mean return of the teacher on the validation seeds
    """

    Config = SparseConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "updates", "phase", "walks", "loss", "operations", "goal", "neurons", "updates_per_s",
        "episode_return", "eval_return", "eval_of_teacher", "eval_operations", "eval_falls",
        "eval_finish",
    )  # fmt: skip
    COUNTERS = ("updates", "phase", "start", "collections", "teacher_return")
    SPEED = "updates_per_s"
    VALIDATES_AT_END = False
    learner: "SparseLearner"

    @classmethod
    def columns(cls, config: SparseConfig) -> tuple[str, ...]:  # type: ignore[override]
        """Return the names of the metrics, of which the first is the step."""
        return cls.COLUMNS

    def __init__(self, config: SparseConfig, run: RunFolder) -> None:
        self._chip = chip(config.chip)  # refused before environments are made
        if config.rounding:
            check_rounding(self._chip)
        self._phases = phases(config)
        super().__init__(
            config,
            run,
            total=self._phases[-1].end,
            log_every=config.log_every,
            checkpoint_every=config.checkpoint_every,
        )
        self._teacher = teacher(
            config.teacher, config.env.name, config.env.options, config.teacher_units
        )
        envs = EnvBatch(config.env.model_copy(update={"count": 1}), self._rng)
        self._discrete = envs.head == "discrete"
        sizes = envs.observation.shape[1], envs.actions
        if sizes != (self._teacher.observations, self._teacher.actions):
            raise ConfigError(
                f"the teacher {config.teacher} takes {self._teacher.observations} observations and "
                f"gives {self._teacher.actions} actions; {config.env.name} has {sizes}"
            )
        self.policy = from_config(
            config.policy, *sizes, config.normaliser.clip, envs.columns, envs.head
        )
        self._sizes = sizes
        self.pool = WalkPool()
        self._student = student(self.policy, config)
        self.learner = SparseLearner(config, self._student)
        self._episodes = Episodes(config.env, _TOGETHER, config.validation.limit)
        self.updates = self.phase = self.collections = 0
        self.start = 0.0
        self._sums: list[str] = []  # checksums of the files of walks
        self.teacher_return = np.nan
        self._loss = math.nan

    def _begin(self) -> None:
        """Let the teacher walk; fit the normaliser and the encoder to what it saw."""
        config = self._config
        taken = walks_of(config, self._sizes) if config.pool else []  # refused before anyone walks
        seeds = self._validation_seeds
        _, returns, _ = self._episodes.play(seeds, Stateless(self._taught))
        self.teacher_return = float(np.mean(returns))
        if taken:
            self._keep(taken)
        if config.teacher_walks:
            self._collect(Stateless(self._taught), config.teacher_walks)
        if config.noisy_walks:
            self._collect(Stateless(self._noisy), config.noisy_walks)
        self._fit()
        self._student.prepare(self.pool)
        self._set_thresholds()

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        if self.updates == self._phases[self.phase].end:
            self._next_phase()
        phase = self._phases[self.phase]
        goal = phase.goal(self.updates, self.start)
        self._loss = self.learner.update(
            self.pool, self._rng, phase.rate(self.updates), dense=goal is None
        )
        if goal is not None and self.updates % self._config.prune_every == 0:
            if phase.prunes(self.updates):
                self.learner.prune(goal)
            self._round()
        self.updates += 1
        return True

    @property
    def _retunes(self) -> bool:
        """Whether the encoder's steps are set anew before the next phase."""
        polished = self.phase + 1 >= len(self._phases) - self._config.polish
        choice = self._config.retune
        return choice == "always" or (choice == "before-polish" and not polished)

    def _round(self) -> None:
        """Let the forward pass compute with the weights of the chip from now on."""
        if self._config.rounding and isinstance(self._student, DeltaStudent):
            self._student.offsets = rounding_offsets(self._student.policy, self._chip)

    def _next_phase(self) -> None:
        """Walk, set the encoder's steps anew, and start the next phase with a new optimiser."""
        # who is judged is who walks: with the numbers of the chip, once training computes with them
        rounded = isinstance(self._student, DeltaStudent) and self._student.offsets
        walking = self._deployed() if rounded else self.policy
        self._collect(in_float(walking), self._config.walks)
        if self._retunes and isinstance(self.policy, DeltaSnnPolicy):
            step = retuned(self.policy, self.pool, self._binary, self._config)
            self.policy.step.copy_(torch.from_numpy(step))
        self._set_thresholds()
        self._student.prepare(self.pool)
        self.phase += 1
        self.start = operations(self._student.synapses())
        self.learner.restart()

    def _set_thresholds(self) -> None:
        """Set the thresholds of a delta network by the walks that are encoded."""
        if isinstance(self.policy, DeltaMlpPolicy):
            found = tuned_thresholds(self.policy, self.pool, self._config)
            self.policy.threshold.copy_(found)

    # walks

    def _taught(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """Return the teacher's actions."""
        label = self._teacher.act_all(observation)
        return label.argmax(-1) if self._discrete else label

    def _noisy(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """Return the teacher's actions with noise."""
        action, noise = self._taught(observation), self._config.noise
        if self._discrete:
            drawn = self._rng.integers(self._teacher.actions, size=len(action))
            return np.where(self._rng.random(len(action)) < noise, drawn, action)
        return np.clip(action + noise * self._rng.standard_normal(action.shape), -1.0, 1.0)

    def _collect(self, controller: Any, count: int) -> None:  # noqa: ANN401
        seeds = self._rng.integers(_TRAINING_SEEDS, size=count).tolist()
        walks, returns, _ = self._episodes.play(seeds, controller, self._teacher.act_all)
        self._returns += returns
        self._keep(walks)

    def _keep(self, walks: list[Walk]) -> None:
        # over what a run that was killed may have left after its last checkpoint
        self._sums.append(save_walks(walks, pool_file(self._run.path, self.collections)))
        self.collections += 1
        self.pool.add(walks)

    @torch.no_grad()
    def _fit(self) -> None:
        """Fit the normaliser and the first steps of the encoder to the walks."""
        seen = self.pool.observations().astype(np.float64)
        self._binary = binary_columns(seen)
        moments = Moments.empty(seen.shape[1])
        moments.add(seen)
        self.policy.normalizer.adopt(moments)
        if isinstance(self.policy, DeltaSnnPolicy):
            low, high = seen[:, self._binary].min(0), seen[:, self._binary].max(0)
            self.policy.normalizer.mean[self._binary] = torch.from_numpy(low).float()
            self.policy.normalizer.std[self._binary] = torch.from_numpy(high - low).float()
            self.policy.step.fill_(self._config.step)
            self.policy.step[self._binary] = 1.0

    # validation and checkpoints

    @property
    def _validation_seeds(self) -> list[int]:
        first = self._config.validation.first_seed
        return list(range(first, first + self._config.validation.episodes))

    def _deployed(self) -> Policy:
        return deployed(self.policy, self._chip, self._config.rounding)

    def _evaluate(self) -> dict[str, float]:
        controller = on_chip(self._deployed(), self._chip)
        _, returns, infos = self._episodes.play(self._validation_seeds, controller)
        share = np.mean(returns) / self.teacher_return if self.teacher_return else math.nan
        row = {
            "eval_return": float(np.mean(returns)),
            "eval_of_teacher": float(share),
            "eval_operations": operations(self._student.synapses()),
        }
        for key, column in (("fall", "eval_falls"), ("finish", "eval_finish")):
            if key in infos[0]:
                row[column] = float(np.mean([info[key] for info in infos]))
        return row

    def _validates(self, before: int) -> bool:
        """Return whether a validation is due: also at the end of each phase, when rates are low."""
        return super()._validates(before) or self.updates == self._phases[self.phase].end

    def _validate(self) -> dict[str, float]:
        """Validate the policy where its goal is reached, and save it as best of its level."""
        phase = self._phases[self.phase]
        if phase.last is None or phase.prunes(self.updates):
            return {}
        row = self._evaluate()
        name = f"{LEVEL}{phase.last:g}"
        if row["eval_return"] >= self._best_of(name):
            self._run.save(name, self._deployed(), {**self._counters(), **row})
        if phase.last == self._config.budget and row["eval_return"] >= self.best:
            self.best = row["eval_return"]
            self._run.save("best", self._deployed(), {**self._counters(), **row})
        return row

    def _best_of(self, name: str) -> float:
        """Return the highest validation return of a level so far."""
        if not self._run.checkpoint(name).is_file():
            return -math.inf
        return float(self._run.load(name)[0]["eval_return"])

    def _metrics(self) -> dict[str, float]:
        synapses = self._student.synapses()
        return {
            "updates": self.updates,
            "phase": self.phase,
            "walks": len(self.pool),
            "loss": self._loss,
            "operations": operations(synapses),
            "goal": self._phases[self.phase].last or math.nan,
            "neurons": self._student.neurons,
        }

    def _state(self) -> dict[str, Any]:
        return {"pool_sha256": self._sums}

    def _tensors(self) -> dict[str, Tensor]:
        return {"binary": torch.from_numpy(self._binary)}

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        for name in self.COUNTERS:
            setattr(self, name, state[name])
        files = pool_files(self._run.path, self.collections)
        self._sums = state.get("pool_sha256") or [of_file(path) for path in files]
        self.pool.add(collected(files, self._sums, self._sizes))
        self._binary = tensors["binary"].numpy()
        self._student.prepare(self.pool)
