"""The gymnasium experiment: sparse spiking policies on the field's own tasks, teacher to chip.

A task has one teacher. Of each seed, a sparse spiking policy imitates it and goes on with reward; a
float MLP takes over the walks of the imitation and is pruned to as many operations. One dense
PopSAN imitates the teacher, too: the reference of operations.

Each row is a file of its own, <runs>/evaluations/<training>@<place>.json, which says what it was
made with: a stopped experiment goes on after the last row, and a row whose policy or sizes have
changed is made again.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from lab.experiments.networks import FLOAT, Played, network, play, random_actions
from lab.experiments.runner import Design, Part, training_part
from lab.experiments.training import Record, StoredRow, TrainingJob, is_complete
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig

TEACHER, SPARSE, TUNED, DENSE, MLP = ROLES = ("teacher", "sparse", "tuned", "dense", "small-mlp")
RANDOM = "random"  # actions, not a training
IDEAL, BITS = "ideal", "int8"  # places: without a chip, rounded
_FURTHER = ("xylo-a3", "int")  # chips beside the first one, on which the last policy is evaluated
_VERSION = 1  # of what a row holds; a higher one makes all rows again

# a PopSAN as published for these tasks (Tang et al. 2020)
_WIDTH, _POPULATION, TIMESTEPS = 256, 10, 5
RATE = 0.15  # of a dense network that is not trained here: spikes of a neuron and timestep

_SAC = ("learn_temperature=true", "policy.hidden=[256,256]", "critic_hidden=[256,256]", "batch=256")
_MUJOCO = (
    *_SAC, "steps=1000000", "update_every=2", "learning_rate=3e-4", "env.count=4", "warm_up=10000",
    "validation.every=25000", "checkpoint_every=2000000",
)  # fmt: skip
# fast changes need finer and more events than walking does
_FINE = ("policy.hidden=128", "policy.most=8", "policy.integrated=true", "step=0.25")
# episodes of 1,000 steps: more states, and validations that are not most of the time
_DENSE = ("iterations=6", "states=10000", "updates=8000", "validation.every=1000")
# longer with reward, of all weights, and further from the teacher
_REWARD = ("iterations=160", "learns=all", "imitation=0.1")


@dataclass(frozen=True)
class Task:
    """A task of gymnasium.

    env                    its id
    observations, actions  their numbers
    recipe, settings       of the teacher
    student                settings of the sparse spiking policy
    baseline               settings of the float MLP
    budget                 operations of a control step of both
    dense                  settings of the dense PopSAN
    reward                 settings of the student's training with reward
    wanted                 return on the chip that is asked for; None for a share of the teacher's
    """

    env: str
    observations: int
    actions: int
    recipe: str
    settings: Sequence[str]
    student: Sequence[str]
    baseline: Sequence[str]
    budget: float
    wanted: float | None = None
    dense: Sequence[str] = ()
    reward: Sequence[str] = ()

    @property
    def is_continuous(self) -> bool:
        """Whether actions are continuous, as SAC and PopSAN need them."""
        return self.recipe == "sac-mlp"

    @property
    def synapses(self) -> int:
        """Synapses of the dense PopSAN: encoder onto 256, onto 256, onto the coded actions."""
        first, last = _POPULATION * self.observations, _POPULATION * self.actions
        return first * _WIDTH + _WIDTH * _WIDTH + _WIDTH * last

    def dense_operations(self, rate: float = RATE) -> float:
        """SOPs of its control step where each neuron spikes with this rate."""
        # SOPs = T rate sum(fan-outs)
        return TIMESTEPS * rate * self.synapses


TASKS = {
    task.env: task
    for task in (
        Task(
            "CartPole-v1", 4, 2, "ppo-mlp", (),
            ("policy.hidden=16",), ("policy.hidden=[16]",), 40, 475,
        ),
        Task(
            "Pendulum-v1", 3, 1, "sac-mlp", (*_SAC, "steps=20000"),
            ("policy.hidden=32",), ("policy.hidden=[32]",), 60, -200,
        ),
        Task("Hopper-v5", 11, 3, "sac-mlp", _MUJOCO, _FINE, (), 600, dense=_DENSE),
        Task("HalfCheetah-v5", 17, 6, "sac-mlp", _MUJOCO, _FINE, (), 900, dense=_DENSE),
        Task(
            "Ant-v5", 105, 8, "sac-mlp", _MUJOCO, _FINE, (), 2_400, dense=_DENSE, reward=_REWARD,
        ),
    )
}  # fmt: skip


@dataclass(frozen=True)
class TaskTraining(TrainingJob):
    """A training of a task.

    env   id of the task
    role  of ROLES
    """

    env: str = ""
    role: str = ""


_VALIDATION = ("validation.episodes=1", "validation.limit=40")
# trainings of seconds
_QUICK: dict[str, tuple[str, ...]] = {
    "ppo-mlp": (
        "env.count=2", "steps=256", "horizon=32", "minibatch=32", "epochs=1", "critic_hidden=[16]",
        "checkpoint_every=128", "validation.every=128", *_VALIDATION,
    ),
    "sac-mlp": (
        "steps=240", "warm_up=80", "update_every=4", "batch=16", "policy.hidden=[16,16]",
        "critic_hidden=[16]", "log_every=80", "checkpoint_every=120", "validation.every=120",
        *_VALIDATION,
    ),
    "distill-sparse": (
        "budget=60", "levels=[200]", "teacher_walks=2", "noisy_walks=1", "walks=1",
        "dense_updates=20", "dense_rounds=1", "level_updates=20", "polish=1", "polish_updates=10",
        "prune_every=5", "batch=8", "log_every=5", "checkpoint_every=20", "validation.every=10",
        *_VALIDATION,
    ),
    "distill-sparse-tuned": (
        "iterations=2", "warm_up=1", "episodes=2", "window=16", "burn_in=4", "batch=4", "epochs=1",
        "critic_hidden=[16]", "critic_epochs=1", "checkpoint_every=1", "validation.every=1",
        *_VALIDATION,
    ),
    "distill-popsan": (
        "policy.hidden=[16,16]", "policy.populations=3", "env.count=2", "iterations=2", "states=60",
        "updates=20", "batch=16", "log_every=10", "checkpoint_every=20", "validation.every=20",
        *_VALIDATION,
    ),
}  # fmt: skip
_QUICK["distill-small-mlp"] = _QUICK["distill-sparse"]


@dataclass(frozen=True)
class GymnasiumDesign(Design):
    """The parts of the experiment; teacher and dense network have one training each.

    settings  `ROLE.KEY=VALUE`, as in teacher.steps=2000000
    tasks     ids of the environments
    """

    episodes: int = 50
    tasks: Sequence[str] = tuple(TASKS)

    NAME = "gymnasium"
    OPTIONS: ClassVar = Design.OPTIONS | {"env": "tasks"}

    def __post_init__(self) -> None:
        for env in self.tasks:
            if env not in TASKS:
                raise ConfigError(
                    f"the gymnasium experiment has no task {env!r}; known: {', '.join(TASKS)}"
                )
        for setting in self.settings:
            if not setting.startswith(tuple(f"{role}." for role in ROLES)):
                raise ConfigError(
                    f"--set {setting}: say of which trainings: {', '.join(ROLES)}, as in "
                    "teacher.steps=2000000"
                )
        super().__post_init__()

    def trainings(self) -> list[TaskTraining]:
        """All trainings, task by task; of a task the teacher first, then seed by seed."""
        return [training for env in self.tasks for training in self._of_task(TASKS[env])]

    def _of_task(self, task: Task) -> Iterator[TaskTraining]:
        budget = f"budget={task.budget:g}"
        teacher = self._training(task, TEACHER, task.recipe, 0, task.settings, {})
        taught = {"teacher": teacher}
        yield teacher
        for seed in range(self.seeds):
            settings = (budget, *task.student)
            sparse = self._training(task, SPARSE, "distill-sparse", seed, settings, taught)
            yield sparse
            start, recipe = {"start": sparse}, "distill-sparse-tuned"
            yield self._training(task, TUNED, recipe, seed, task.reward, start)
            if task.is_continuous and seed == 0:
                yield self._training(task, DENSE, "distill-popsan", 0, task.dense, taught)
            walks = {**taught, "pool": sparse}
            settings = (budget, *task.baseline)
            yield self._training(task, MLP, "distill-small-mlp", seed, settings, walks)

    def _training(
        self,
        task: Task,
        role: str,
        recipe: str,
        seed: int,
        settings: Sequence[str],
        parents: Mapping[str, TrainingJob],
    ) -> TaskTraining:
        more = [each.partition(".") for each in self.settings]
        every = (
            f"env.name={json.dumps(task.env)}",
            *settings,
            *(_QUICK[recipe] if self.quick else ()),
            *(setting for name, _, setting in more if name == role),
        )
        extra = [] if "pool" not in parents else ["teacher_walks=0", "noisy_walks=0"]
        return TaskTraining(
            f"{task.env}-{role}-s{seed}", recipe, seed, self.runs, every, parents,
            (*every, *extra), task.env, role,
        )  # fmt: skip

    def places(self, role: str) -> list[str]:
        """Where a training is evaluated, by its role; beside the teacher random actions are."""
        return {
            TEACHER: [FLOAT, RANDOM],
            SPARSE: [self.chip],
            TUNED: [IDEAL, self.chip, *_FURTHER],
            DENSE: [IDEAL, self.chip],
            MLP: [BITS],
        }[role]

    def parts(self) -> list[Part]:
        """Each training, and its evaluation after it."""
        return [
            part
            for training in self.trainings()
            for part in (training_part(training), self._evaluation(training))
        ]

    def _evaluation(self, training: TaskTraining) -> Part:
        def perform() -> None:
            for row in self.rows(training):
                if row.found is None:
                    row.write(self._evaluate(training, row.of["place"]))

        name = f"{training.name}: evaluation"
        return Part(name, lambda: not self.is_missing(training), perform, [training.name])

    # rows

    def rows(self, training: TaskTraining) -> list[StoredRow]:
        """The rows of a training that has ended."""
        run = _run(training)
        digest = hashlib.sha256((run / "checkpoints" / "best.safetensors").read_bytes())
        return [
            StoredRow(
                Path(self.runs) / "evaluations" / f"{training.name}@{place}.json",
                {
                    "training": training.name,
                    "place": place,
                    "policy": "" if place == RANDOM else digest.hexdigest(),
                    "episodes": self.episodes,
                    "first_seed": EVALUATION,
                    "limit": self.limit,
                    "version": _VERSION,
                },
            )
            for place in self.places(training.role)
        ]

    def is_missing(self, training: TaskTraining) -> bool:
        """Whether a training, or a row of it, is missing."""
        return not training.is_trained or not is_complete(self.rows(training))

    def all_rows(self) -> Iterator[Record]:
        """The results so far."""
        for training in self.trainings():
            for row in self.rows(training) if training.is_trained else ():
                if (found := row.found) is not None:
                    yield found

    def _evaluate(self, training: TaskTraining, place: str) -> Record:
        facts = {"env": training.env, "role": training.role, "seed": training.seed, "place": place}
        env = EnvConfig(name=training.env)
        if place == RANDOM:
            actions = random_actions(training.env)
            facts |= {"role": RANDOM, "seed": None}
            return facts | _outcomes(play(env, self.episodes, actions, self.limit))
        file = Path(self.runs) / "policies" / training.name
        try:
            made = network(_run(training), "best", place, file)
        except RuleError as error:
            return facts | {"refusal": str(error)}
        played = play(env, self.episodes, made.controller, self.limit)
        return facts | made.counts(played.walks) | _outcomes(played)

    def write(self, results: Path) -> list[Path]:
        """Write page, table and picture of the complete rows; return the files."""
        from lab.experiments.gymnasium_page import write

        return write(self, results)


def _run(training: TrainingJob) -> Path:
    if training.run is None:
        raise ConfigError(f"{training.name} has no run folder")
    return training.run


def _outcomes(played: Played) -> Record:
    return {
        "episodes": len(played.returns),
        "return_mean": float(np.mean(played.returns)),
        "terminated": float(np.mean(played.terminated)),
        "steps": float(np.mean([len(walk.observation) for walk in played.walks])),
        "scores": played.returns,
    }
