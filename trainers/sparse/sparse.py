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
from torch import Tensor

from spikedeploy import envs
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.schema import validate
from spikedeploy.trainers.config import C, amend
from spikedeploy.trainers.distill.teachers import same_teacher, teacher
from spikedeploy.trainers.env_batch import TRAINING_SEEDS, EnvBatch
from spikedeploy.trainers.policies import Policy, from_config
from spikedeploy.trainers.policies.policy import Moments, PrunedWeight
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.run_folder import LEVEL, RunFolder, with_prefix
from spikedeploy.trainers.runner import Learner, Runner, adam, descend, mean_outcome, set_rate
from spikedeploy.trainers.sparse.batch_controllers import FloatController, controller_of
from spikedeploy.trainers.sparse.delta_encoder import binary_columns
from spikedeploy.trainers.sparse.phases import (
    Ended,
    Phase,
    expected_updates,
    planned,
    searched,
    target,
)
from spikedeploy.trainers.sparse.pruning import clear_idle, operations, prune
from spikedeploy.trainers.sparse.rounding import check_rounding
from spikedeploy.trainers.sparse.settings import SparseConfig
from spikedeploy.trainers.sparse.student import Student, student
from spikedeploy.trainers.sparse.walks import (
    BatchController,
    Episodes,
    Stateless,
    Walk,
    WalkPool,
    random_actions,
    walk_tensors,
    walks_of,
)

_ENV_COPIES = 50  # copies of the environment
_DENSE_BUDGET = 4_000.0  # operations for which the penalty is scaled while nothing is pruned


# what the operations of each kind of policy are called
_UNITS = {"delta-snn": "sops", "pruned-mlp": "macs"}


def with_budget(config: C, text: str) -> C:
    """Return a configuration with a budget [operations of a control step], such as "sops=480".

    Levels that the recipe names keep their ratio to the budget.
    """
    if not isinstance(config, SparseConfig):
        some = [name for name, recipe in RECIPES.items() if recipe.algorithm == "sparse"][:3]
        raise ConfigError(
            f"--budget {text}: recipe {config.recipe} has no budget of operations; "
            f"{', '.join(some)} and other recipes of the algorithm sparse have"
        )
    unit, _, number = text.partition("=")
    expected = _UNITS.get(config.policy.kind, "sops")
    if unit != expected or not number:
        raise ConfigError(
            f"--budget {text}: operations of a {config.policy.kind} policy are {expected}, so that "
            f"recipe {config.recipe} takes them as in --budget {expected}={config.budget:g}"
        )
    found = amend(config, overrides=[f"budget={number}"])
    if not found.budget:
        raise ConfigError(f"--budget {text}: 0 operations; leave it out to have them found")
    levels = [level * found.budget / config.budget for level in config.levels]
    return validate(type(found), found.model_dump() | {"levels": levels}, f"--budget {text}")


class Sparse(Runner[SparseConfig]):
    """One training by sparse imitation.

    updates, phase, start: counters, continued by a resumed run; `start` are the operations when the
        phase began
    pool: all walks so far
    teacher_return, random_return: mean return of the teacher, and of random actions, on the
        validation seeds
    kept: operations of the lowest level at which a search kept what it had to; 0 before one
    """

    Config = SparseConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "updates", "phase", "walks", "loss", "operations", "goal", "neurons", "updates_per_s",
        "episode_return", "eval_return", "eval_of_teacher", "eval_share", "eval_operations",
        "eval_falls", "eval_finish", "eval_missteps", "eval_success",
    )  # fmt: skip
    COUNTERS = (
        "updates", "phase", "start", "teacher_return", "random_return", "kept",
    )  # fmt: skip
    SPEED = "updates_per_s"
    VALIDATES_AT_END = RATES = False
    learner: "SparseLearner"

    def __init__(self, config: SparseConfig, run: RunFolder) -> None:
        self._chip = chip(config.chip)  # refused before environments are made
        if config.rounding:
            check_rounding(self._chip)
        self._ended: list[Ended] = []
        self._phases = searched(config, ()) if config.search else planned(config)
        total = expected_updates(config, ()) if config.search else self._phases[-1].end
        super().__init__(config, run, total, config.checkpoint_every, config.log_every)
        batch = EnvBatch(config.env.model_copy(update={"count": 1}), self._rng)
        self._sizes, self._discrete = batch.sizes, batch.head == "discrete"
        self._episodes = Episodes(config.env, _ENV_COPIES, config.validation.limit)
        self._teacher = teacher(
            config.teacher, config.env.name, config.env.options, config.teacher_units
        ).in_envs(self._episodes.worlds)
        self._teacher.check_sizes(config.teacher, config.env.name, self._sizes)
        self.policy = from_config(config.policy, *self._sizes, config.normaliser.clip, batch.head)
        self.pool = WalkPool()
        self._student = student(self.policy, config)
        self.learner = SparseLearner(config, self._student)
        self.updates = self.phase = 0
        self.start = 0.0
        self._shares: list[float] = []  # of the validations of the phase
        self.kept = 0.0
        self.teacher_return = self.random_return = self._loss = math.nan
        self._confirming = math.nan, math.nan  # the same two, on the seeds that confirm

    def _begin(self) -> None:
        """Collect walks of the teacher; fit the normaliser and the encoder to them."""
        config = self.config
        taken = _walks_of(config, self._sizes) if config.pool else []  # refused before walks
        taught = Stateless(self._taught)
        self.teacher_return, self.random_return = self._references(config.validation.seeds)
        if config.search and self.teacher_return <= self.random_return:
            raise ConfigError(
                f"the teacher {config.teacher} earns {self.teacher_return:,.4g} in "
                f"{config.env.name}, and random actions {self.random_return:,.4g}: it may act in "
                "other units (--set teacher_units=scaled) or need its normaliser"
            )
        if config.search:
            self._confirming = self._references(config.confirming)
        if taken:
            self.pool.add(taken)
        if config.teacher_walks:
            self._collect(taught, config.teacher_walks)
        if config.noisy_walks:
            self._collect(Stateless(self._noisy), config.noisy_walks)
        self._fit()
        self._student.prepare(self.pool, self._binary)

    def _references(self, seeds: list[int]) -> tuple[float, float]:
        """Return the mean returns of the teacher, and of random actions, on these seeds."""
        rng = np.random.default_rng(self.config.seed)
        at_random = random_actions(self._sizes[1], self._discrete, rng)
        both = (Stateless(self._taught), at_random)
        teacher, none = (float(np.mean(self._episodes.play(seeds, each)[1])) for each in both)
        return teacher, none

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        if self.updates == self._phases[self.phase].end:
            self._next_phase()
        phase = self._phases[self.phase]
        goal = phase.goal(self.updates, self.start)
        rate = phase.rate(self.updates)
        self._loss = self.learner.update(self.pool, self._rng, rate, dense=goal is None)
        if goal is not None and self.updates % self.config.prune_every == 0:
            if phase.prunes(self.updates):
                self.learner.prune(goal)
            # from now on, the forward pass computes with the weights of the chip
            self._student.round(self._chip)
        self.updates += 1
        return True

    def _next_phase(self) -> None:
        """Collect walks, set the encoder's steps, and start the next phase with a new optimiser."""
        # the validated policy collects: with the chip's numbers once training computes with them
        student = self._student
        walking = student.deployed(self._chip) if student.is_rounded else self.policy
        self._collect(FloatController(walking), self.config.walks)
        polished = self._phases[self.phase + 1].polish
        when = ("always",) if polished else ("always", "before-polish")
        if self.config.retune in when:
            student.retune(self.pool, self._binary)
        self._student.prepare(self.pool, self._binary)
        self.phase += 1
        self.start = operations(self._student.synapses())
        self.learner.restart()

    # walks

    def _taught(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """Return the teacher's actions."""
        label = self._teacher.act_all(observation)
        return label.argmax(-1) if self._discrete else label

    def _noisy(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """Return the teacher's actions with noise."""
        action, noise = self._taught(observation), self.config.noise
        if self._discrete:
            drawn = self._rng.integers(self._teacher.actions, size=len(action))
            return np.where(self._rng.random(len(action)) < noise, drawn, action)
        return np.clip(action + noise * self._rng.standard_normal(action.shape), -1.0, 1.0)

    def _collect(self, controller: BatchController, count: int) -> None:
        seeds = self._rng.integers(TRAINING_SEEDS, size=count).tolist()
        walks, returns, _ = self._episodes.play(seeds, controller, self._teacher.act_all)
        self._returns += returns
        self.pool.add(walks)

    @torch.no_grad()
    def _fit(self) -> None:
        """Fit the normaliser and the first steps of the encoder to the walks."""
        seen = np.concatenate([w.observation for w in self.pool.walks]).astype(np.float64)
        self._binary = binary_columns(seen)
        normaliser = self.policy.normalizer
        normaliser.adopt(Moments.from_batch(seen))
        # 0 and 1, since an input that is 0 takes no operation, in a float network either
        low, high = seen[:, self._binary].min(0), seen[:, self._binary].max(0)
        normaliser.mean[self._binary] = torch.from_numpy(low).float()
        normaliser.std[self._binary] = torch.from_numpy(high - low).float()
        self._student.start(self._binary)

    # validation and checkpoints

    def _measure(
        self, policy: Policy, seeds: list[int], references: tuple[float, float]
    ) -> dict[str, float]:
        controller = controller_of(policy, self._chip)
        _, returns, infos = self._episodes.play(seeds, controller)
        row = mean_outcome(returns, infos)
        earned, (teacher, none) = row["eval_return"], references
        return row | {
            "eval_of_teacher": earned / teacher if teacher else math.nan,
            "eval_share": (earned - none) / (teacher - none) if teacher != none else math.nan,
            "eval_operations": controller.operations(self._episodes.lengths),
        }

    def _validates(self, before: int) -> bool:
        """Return whether a validation is due: also at the end of each phase, when rates are low."""
        return super()._validates(before) or self.updates == self._phases[self.phase].end

    def _validate(self) -> dict[str, float]:
        """Validate the policy where its goal is reached, and save it as best of its level."""
        phase, config = self._phases[self.phase], self.config
        if phase.prunes(self.updates) or (phase.last is None and not config.search):
            return {}
        policy, references = (
            self._student.deployed(self._chip),
            (self.teacher_return, self.random_return),
        )
        row = self._measure(policy, config.validation.seeds, references)
        self._shares.append(row["eval_share"])
        if phase.last is not None:
            level = f"{LEVEL}{phase.last:g}"
            before = -math.inf
            if self._run.checkpoint(level).is_file():
                before = self._run.load(level)[0]["eval_return"]
            if row["eval_return"] >= before:
                self._run.save(level, policy, {**self._counters(), **row})
        # at the budget; of a search for one, while nothing is pruned
        if phase.last == (config.budget or None) and row["eval_return"] >= self.best:
            self._save_best(policy, row)
        if config.search and self.updates == phase.end:
            self._end_phase(phase)
        return row

    def _end_phase(self, phase: Phase) -> None:
        """Decide whether a level of a search keeps the required share; plan the next phase."""
        share, count = max(self._shares), operations(self._student.synapses())
        wanted = target(self.config, self._ended)
        if phase.last is not None and not self.config.budget and share >= wanted:
            policy = self._run.policy(f"{LEVEL}{phase.last:g}")
            row = self._measure(policy, self.config.confirming, self._confirming)
            share = row["eval_share"]
            if share >= wanted:
                self.kept = phase.last
                self._save_best(policy, row)
        self._ended.append(Ended(phase.last, count, share))
        self._shares = []
        self._plan_on()

    def _plan_on(self) -> None:
        """Plan the next phase of a search, or end it."""
        self._phases = searched(self.config, self._ended)
        over = len(self._phases) == len(self._ended)
        self._total = self._phases[-1].end if over else expected_updates(self.config, self._ended)

    def _metrics(self) -> dict[str, float]:
        return {
            "walks": len(self.pool),
            "loss": self._loss,
            "operations": operations(self._student.synapses()),
            "goal": self._phases[self.phase].last or math.nan,
            "neurons": self._student.neurons,
        }

    def _state(self) -> dict[str, Any]:
        if not self.config.search:
            return {}
        return {
            "ended": [vars(each) for each in self._ended],
            "shares": self._shares,
            "confirming": self._confirming,
        }

    def _tensors(self) -> dict[str, Tensor]:
        return {**walk_tensors(self.pool.walks), "binary": torch.from_numpy(self._binary)}

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        self.pool.add(walks_of(tensors))
        self._binary = tensors["binary"].numpy()
        self._student.prepare(self.pool, self._binary)
        if self.config.search:
            self._ended = [Ended(**each) for each in state["ended"]]
            self._shares, self._confirming = state["shares"], tuple(state["confirming"])
            self._plan_on()


def _walks_of(config: SparseConfig, sizes: tuple[int, int]) -> list[Walk]:
    """Return the walks of the run that the setting `pool` names."""
    run = RunFolder.find(config.pool)
    tensors = run.load("last")[1]
    if "walks.length" not in tensors:
        raise ConfigError(f"{config.pool} has no pool of walks. Give a run of a sparse recipe.")
    source = run.settings()
    there, here = str(source["env"]["name"]), config.env.name
    if envs.spec(there).id != envs.spec(here).id:
        raise ConfigError(
            f"pool: {config.pool} has walks in {there}, not in {here}. Give a run of its task."
        )
    labelled = str(source["teacher"])
    if not same_teacher(labelled, config.teacher):
        raise ConfigError(
            f"pool: {config.pool} has walks labelled by the teacher {labelled}, and the teacher "
            f"here is {config.teacher}. Give a run with this teacher, or set teacher={labelled}."
        )
    walks = walks_of(tensors)
    if (found := (walks[0].observation.shape[1], walks[0].label.shape[1])) != sizes:
        raise ConfigError(f"pool: {config.pool} has walks of sizes {found}, not {sizes}.")
    return walks


class SparseLearner(Learner):
    """Gradient updates of a student towards its teacher, and pruning by Adam's second moments.

    student: what learns
    """

    def __init__(self, config: SparseConfig, student: Student) -> None:
        self._config = config
        self.student, self.policy, self.modules = student, student.policy, {}
        self.restart()

    def restart(self) -> None:
        """Begin with a new optimiser."""
        self.optimizers = {"adam": adam(self.policy, self._config.learning_rate)}

    def update(self, pool: WalkPool, rng: np.random.Generator, rate: float, dense: bool) -> float:
        """Take one gradient step, and return the error; `dense` before anything is pruned."""
        config, optimizer = self._config, self.optimizers["adam"]
        set_rate(optimizer, rate)
        error, hidden = self.student.loss(pool, rng)
        budget = _DENSE_BUDGET if dense else max(config.budget, config.penalty_floor)
        descend(optimizer, self.policy, error + config.penalty * hidden / budget, 1.0)
        return float(error.detach())

    def prune(self, goal: float) -> None:
        """Take out synapses down to the goal, and those onto neurons from which none leads."""
        matrices = [m for m in self.policy.modules() if isinstance(m, PrunedWeight)]
        state = self.optimizers["adam"].state
        squares = {m: state[m.weight]["exp_avg_sq"] for m in matrices if m.weight in state}
        if not squares:  # before its first step
            return
        for into, out in self.student.hidden_layers():
            clear_idle(into, out)
        prune(self.student.synapses(), squares, goal)

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name."""
        own = {f"student.{name}": value for name, value in self.student.tensors().items()}
        return {**super().tensors(), **own}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        super().load(named)
        self.student.load(with_prefix("student", named))
