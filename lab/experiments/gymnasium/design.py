"""The design of the gymnasium experiment: trainings of each task, and where they are evaluated.

A task has one teacher. Of each seed, a sparse spiking policy imitates it and goes on with reward; a
float MLP takes over the walks of the imitation and is pruned to as many operations. One dense
PopSAN imitates the teacher, too: the reference of operations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lab.experiments.gymnasium.tasks import TASKS, Task
from lab.experiments.gymnasium.training import TaskTraining
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError

TEACHER, SPARSE, TUNED, DENSE, MLP = ROLES = ("teacher", "sparse", "tuned", "dense", "small-mlp")
RANDOM = "random"  # actions, not a training
FLOAT, IDEAL, BITS = "float", "ideal", "int8"  # places: of float networks, without a chip, rounded
_FURTHER = ("xylo-a3", "int")  # chips beside the first one, on which the last policy is evaluated

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
class GymnasiumDesign:
    """The parts of the experiment.

    tasks     ids of the environments
    seeds     trainings of each student, from seed 0 up; teacher and dense network have one
    runs      folder of the run folders, of exported policies and of evaluations
    settings  more settings of trainings: `ROLE.KEY=VALUE`, as in teacher.steps=2000000
    episodes  of each evaluation
    chip      on which spiking policies are judged
    limit     control steps that an episode of an evaluation may take; None for all
    quick     whether trainings take seconds, for a first look and for tests
    """

    tasks: Sequence[str] = tuple(TASKS)
    seeds: int = 3
    runs: str = "runs/gymnasium"
    settings: Sequence[str] = ()
    episodes: int = 50
    chip: str = "loihi1"
    limit: int | None = None
    quick: bool = False

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
        chip(self.chip)  # raises on an unknown name

    def trainings(self) -> list[TaskTraining]:
        """All trainings, task by task; of a task the teacher first, then seed by seed."""
        return [training for env in self.tasks for training in self.of_task(TASKS[env])]

    def of_task(self, task: Task) -> list[TaskTraining]:
        """The trainings of a task."""
        budget = f"budget={task.budget:g}"
        teacher = self._training(task, TEACHER, task.recipe, 0, task.settings, {})
        found, taught = [teacher], {"teacher": teacher}
        for seed in range(self.seeds):
            settings = (budget, *task.student)
            sparse = self._training(task, SPARSE, "distill-sparse", seed, settings, taught)
            start, recipe = {"start": sparse}, "distill-sparse-tuned"
            found += [sparse, self._training(task, TUNED, recipe, seed, task.reward, start)]
            if task.continuous and seed == 0:
                found.append(self._training(task, DENSE, "distill-popsan", 0, task.dense, taught))
            baseline, walks = (budget, *task.baseline), {**taught, "pool": sparse}
            found.append(self._training(task, MLP, "distill-small-mlp", seed, baseline, walks))
        return found

    def _training(
        self,
        task: Task,
        role: str,
        recipe: str,
        seed: int,
        settings: Sequence[str],
        sources: Mapping[str, TaskTraining],
    ) -> TaskTraining:
        own = [each.partition(".") for each in self.settings]
        more = [setting for name, _, setting in own if name == role]
        small = _QUICK[recipe] if self.quick else ()
        every = (*settings, *small, *more)
        return TaskTraining(task.env, role, recipe, seed, self.runs, every, sources)

    def places(self, training: TaskTraining) -> list[str]:
        """Where a training is evaluated."""
        return {
            TEACHER: [FLOAT],
            SPARSE: [self.chip],
            TUNED: [IDEAL, self.chip, *_FURTHER],
            DENSE: [IDEAL, self.chip],
            MLP: [BITS],
        }[training.role]

    def arguments(self) -> dict[str, Any]:
        """The fields as arguments of a job."""
        return {**asdict(self), "tasks": list(self.tasks), "settings": list(self.settings)}


_OPTIONS = {
    "env": "tasks",
    "seeds": "seeds",
    "runs": "runs",
    "set": "settings",
    "episodes": "episodes",
    "chip": "chip",
    "quick": "quick",
}
_SMALL = {"seeds": 1, "episodes": 2, "limit": 40}


def asked(options: Mapping[str, Any]) -> GymnasiumDesign:
    """The design of the options of a command; ConfigError where one is of other experiments."""
    if other := sorted(options.keys() - _OPTIONS):
        raise ConfigError(f"the experiment gymnasium has no {other[0]}. Leave it out.")
    quick = options.get("quick", False)
    runs = Path("runs") / ("gymnasium-quick" if quick else "gymnasium")
    given = {_OPTIONS[name]: value for name, value in options.items()}
    if "env" in options:
        given["tasks"] = (options["env"],)
    return GymnasiumDesign(**{"runs": str(runs), **(_SMALL if quick else {}), **given})
