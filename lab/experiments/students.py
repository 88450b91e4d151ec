"""The students experiment: what the defaults of `distill` make of teachers of Stable-Baselines3.

They are trained here, one a task, in three to twelve minutes of one core, and kept in
results/students. Of each seed `distill` trains a spiking student and its float rival, without any
setting; a linear policy is trained and pruned likewise. All play the same episodes: the student on
the chip, float policies with weights of 8 bits.
"""

import csv
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, ClassVar

import numpy as np

from lab.experiments import DESIGNS, QUICK, pages
from lab.experiments.gymnasium import TaskTraining
from lab.experiments.networks import (
    float_actions,
    is_discrete,
    network,
    play,
    random_actions,
)
from lab.experiments.pages import ROOT, grouped, mean, number, share
from lab.experiments.runner import Design, Part
from lab.experiments.training import Record, StoredRow, TrainingJob, read_rows, write_exactly
from spikedeploy import envs, zoo
from spikedeploy.commands.distillation import FLOAT, RIVAL, SPARSE, STUDENT
from spikedeploy.comparison.statistics import nested_ratio
from spikedeploy.envs.foreign import attribute, import_target
from spikedeploy.files import replacing
from spikedeploy.reports.table import ABSENT
from spikedeploy.runtime.metrics.energy import TABLES
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.distill.teachers import teacher
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.pool import BatchController, Stateless

TEACHER, RANDOM, IDLE, LINEAR = "teacher", "random", "no action", "float linear"
ROLES = (TEACHER, RANDOM, IDLE, STUDENT, FLOAT, LINEAR)
PRICES = ("horowitz45-int8", "horowitz45-int8-acc16")  # sums in registers, in memory
TASKS: Mapping[str, Record] = DESIGNS["students"]["tasks"]
TEACHERS = ROOT / "results" / "students"
WANTED = 0.97  # of the teacher
_TYPICAL: Sequence[Callable[[Sequence[float]], float]] = (median, min)  # of trainings
_VERSION = 1  # of what a row holds; a higher one makes all rows again
_TEXT = ("task", "role")
_COLUMNS = ("task", "role", "seed", "episodes", "operations", "updates", "minutes", "scores")


@dataclass(frozen=True)
class StudentsDesign(Design):
    """The parts: of each task a teacher, and of each seed a student and its rivals.

    tasks     of designs.toml
    """

    tasks: Sequence[str] = tuple(TASKS)

    NAME = "students"
    OPTIONS: ClassVar = {n: n for n in ("seeds", "runs", "episodes", "chip", "quick")} | {
        "env": "tasks",
        "set": "settings",
    }

    def trainings(self) -> list[TaskTraining]:
        """Of each seed the student, its rival and a linear policy of every task."""
        return [
            each
            for seed in range(self.seeds)
            for task in self.tasks
            for each in (
                self._student(task, seed),
                self._rival(task, seed),
                self._job(task, LINEAR, seed, "distill-small-linear", {}),
            )
        ]

    def _student(self, task: str, seed: int) -> TaskTraining:
        return self._job(task, STUDENT, seed, SPARSE, {})

    def _rival(self, task: str, seed: int) -> TaskTraining:
        # as `distill` trains it
        return self._job(task, FLOAT, seed, RIVAL, {"pool": self._student(task, seed)})

    def _job(
        self, task: str, role: str, seed: int, recipe: str, parents: Mapping[str, TrainingJob]
    ) -> TaskTraining:
        every = (
            f'env.name="{TASKS[task]["env"]}"',
            f'teacher="{self._file(task)}"',
            *(QUICK["distill-sparse"] if self.quick else ()),
            *self.settings,
        )
        name = f"{task}-{role.replace(' ', '-')}-s{seed}"
        own = ("teacher_walks=0", "noisy_walks=0") if parents else ()
        telling = (*every, *own)
        return TaskTraining(name, recipe, seed, self.runs, every, parents, telling, task, role)

    def parts(self) -> list[Part]:
        """The teachers and their episodes; each training and its episodes."""
        found = []
        for task in self.tasks:
            name = f"{task}-{TEACHER}"
            found.append(Part(name, partial(self._taught, task)))
            rows = partial(self._teacher_rows, task)
            found.append(Part(f"{task}-episodes", rows, after=[name]))
        for training in self.trainings():
            parents = [each.name for each in training.parents.values()]
            after = [f"{training.env}-episodes", *parents]
            rows = partial(self._rows, training.env, training.role, training.seed, training)
            found.append(Part(training.name, rows, training, after=after))
        return found

    def _taught(self, task: str) -> list[StoredRow]:
        """How the teacher was trained, and in how many minutes."""
        made = TASKS[task]["teacher"] | ({"steps": 300} if self.quick else {})
        of, file = {**made, "env": TASKS[task]["env"]}, self._file(task)
        return [StoredRow(file.with_suffix(".json"), of, partial(_teach, of, file))]

    def _file(self, task: str) -> Path:
        """The model of Stable-Baselines3 that teaches, from where the command runs."""
        file = (Path(self.runs) / "teachers" if self.quick else TEACHERS) / f"{task}.zip"
        return file.relative_to(Path.cwd()) if file.is_relative_to(Path.cwd()) else file

    def _teacher_rows(self, task: str) -> list[StoredRow]:
        roles = (TEACHER, RANDOM, IDLE)
        return [row for role in roles for row in self._rows(task, role, 0, None)]

    def _rows(
        self, task: str, role: str, seed: int, training: TrainingJob | None
    ) -> list[StoredRow]:
        file = Path(self.runs) / "evaluations" / f"{task}-{role.replace(' ', '-')}-s{seed}.json"
        policy = training.checkpoint() if training else self._file(task)
        of = {
            "episodes": self.episodes,
            "limit": self.limit,
            "first_seed": EVALUATION,
            "chip": self.chip,
            "policy": zoo.sha256(policy) if policy.is_file() else "",  # a teacher yet to be trained
            "version": _VERSION,
        }
        return [StoredRow(file, of, partial(self._evaluate, task, role, seed, training))]

    def _evaluate(self, task: str, role: str, seed: int, training: TrainingJob | None) -> Record:
        env = EnvConfig(name=TASKS[task]["env"])
        counts: Record = {}
        if training is None:
            act: BatchController = random_actions(env.name)
            if role == IDLE:
                act = _idle(env.name)
            elif role == TEACHER:
                found = teacher(str(self._file(task)), env.name)
                act = float_actions(found, is_discrete(env.name))
                counts = {"operations": float(sum(a * b for a, b in pairwise(found.widths)))}
            played = play(env, self.episodes, act, self.limit)
        else:
            stem = Path(self.runs) / "policies" / training.name
            place = self.chip if role == STUDENT else "int8"
            placed = network(training.existing_run, "best", place, stem)
            played = play(env, self.episodes, placed.controller, self.limit)
            did = placed.counts(played.walks)
            counts = {
                "operations": did["operations"],
                "updates": did.get("neuron_updates"),
                "minutes": _minutes(RunFolder(training.existing_run)),
            }
        who = {"task": task, "role": role, "seed": seed, "episodes": self.episodes}
        return {**who, **counts, "scores": played.returns}

    def all_rows(self) -> Iterator[Record]:
        """The results so far, without what says how teachers were trained."""
        return (row for part in self.parts() for row in part.found if "scores" in row)

    def write(self, results: Path) -> list[Path]:
        """Write page and table of what is complete."""
        table = results / "students.csv"
        old = read_rows(table, _TEXT) if table.is_file() else []
        found = {(r["task"], r["role"], r["seed"]): r for r in (*old, *self.all_rows())}
        rows = sorted(found.values(), key=_place)
        write_exactly(({n: row.get(n) for n in _COLUMNS} for row in rows), _COLUMNS, table)
        rows = read_rows(table, _TEXT)
        by = dict(grouped(rows, "task", "role"))
        tasks = [_facts(task, by) for task in TASKS if (task, TEACHER) in by]
        page, shown = pages.write_page(
            results / "students.md",
            {},
            command=pages.command(self, sizes=("seeds", "episodes")),
            quick=self.quick,
            episodes=self.episodes,
            first_seed=EVALUATION,
            chip=self.chip,
            tasks=tasks,
            trained=sum(STUDENT in each["policies"] for each in tasks),
            count={name: sum(each[name] for each in tasks) for name in ("kept", "surely")},
            fewer=np.sum([each["fewer"] for each in tasks], axis=0),
            energies=[each["energy"] for each in tasks if each["energy"]],
            roles={"student": STUDENT, "mlp": FLOAT, "linear": LINEAR},
            missing=[
                training.name
                for training in self.trainings()
                if (training.env, training.role, training.seed)
                not in {(r["task"], r["role"], r["seed"]) for r in rows}
            ],
            each=_each,
            minutes=lambda of: number(of and of["minutes"]),
            number=number,
            share=share,
            facts=[f"- {pages.releases('torch', 'numpy', 'gymnasium', 'mujoco')}"],
            **{"WANTED": WANTED, "PRICES": PRICES},
        )
        return [page, table, shown]


def _idle(env: str) -> Stateless:
    """Actions of 0, the middle of their range."""
    world: Any = envs.make(env)
    actions = world.action_space.shape[0]
    world.close()
    return Stateless(lambda seen: np.zeros((len(seen), actions)))


def _teach(of: Record, file: Path) -> Record:
    """Train a teacher with Stable-Baselines3, and save it."""
    # nothing else here needs it
    sb3, tools = map(import_module, ("stable_baselines3", "stable_baselines3.common.env_util"))
    env: Any = of["env"]
    if ":" in env:
        module, _, within = env.partition(":")
        env = attribute(env, import_target(env, module, "an environment"), within)
    worlds = tools.make_vec_env(env, n_envs=of["copies"], seed=0)
    began = time.process_time()
    kind = getattr(sb3, of["algorithm"])
    settings = deepcopy(of["settings"])  # Stable-Baselines3 writes into it
    model = kind("MlpPolicy", worlds, seed=0, device="cpu", **settings)
    model.learn(of["steps"])
    minutes = (time.process_time() - began) / 60
    file.parent.mkdir(parents=True, exist_ok=True)
    with replacing(file) as part, part.open("wb") as whole:
        model.save(whole)
    return {"minutes": minutes}


def _minutes(run: RunFolder) -> float:
    """Minutes of updates, walks and validations, those of an interrupted training too."""
    with (run.path / "metrics.csv").open(encoding="utf-8") as file:
        rows = [(int(r["updates"]), float(r["updates_per_s"])) for r in csv.DictReader(file)]
    return sum((n - m) / rate for (m, _), (n, rate) in pairwise([(0, 1.0), *rows])) / 60


def _place(row: Record) -> tuple[int, int, int]:
    return list(TASKS).index(row["task"]), ROLES.index(row["role"]), row["seed"]


def _facts(task: str, by: Mapping[tuple[str, str], Sequence[Record]]) -> Record:
    """Facts that the page shows of a task."""
    taught = by[task, TEACHER][0]["scores"]
    earned, random = float(np.mean(taught)), float(np.mean(by[task, RANDOM][0]["scores"]))
    idle = float(np.mean(by[task, IDLE][0]["scores"])) if (task, IDLE) in by else None
    roles = {role: by[task, role] for role in (STUDENT, FLOAT, LINEAR) if (task, role) in by}
    # of the way from what no policy earns to what the teacher does
    zero = max(random, -np.inf if idle is None else idle)
    shares = {
        role: nested_ratio(
            np.asarray([row["scores"] for row in rows]) - zero, np.asarray(taught) - zero
        )
        for role, rows in roles.items()
    }
    enough = [role for role in (FLOAT, LINEAR) if role in shares and shares[role].mean >= WANTED]
    counts = {role: [row["operations"] for row in rows] for role, rows in roles.items()}
    cheapest = [
        min((typical(counts[role]) for role in enough), default=math.inf) for typical in _TYPICAL
    ]
    students = roles.get(STUDENT, [])
    energy = []
    for price in (TABLES[name].joules for name in PRICES if students and enough):
        spent = [
            r["operations"] * price["sop"] + r["updates"] * price["neuron_update"] for r in students
        ]
        energy.append(float(np.median(spent) / (cheapest[0] * price["mac"])))
    return {
        "name": task,
        "env": TASKS[task]["env"],
        "teacher": by[task, TEACHER][0],
        "earned": earned,
        "random": random,
        "idle": idle,
        "policies": {
            role: {
                "trainings": len(rows),
                "share": shares[role],
                "operations": counts[role],
                "updates": [row["updates"] for row in rows],
                "minutes": mean(rows, "minutes"),
            }
            for role, rows in roles.items()
        },
        "energy": energy,
        "kept": STUDENT in shares and shares[STUDENT].mean >= WANTED,
        "surely": STUDENT in shares and shares[STUDENT].ci95[0] >= WANTED,
        "fewer": [
            bool(students) and typical(counts[STUDENT]) < least
            for typical, least in zip(_TYPICAL, cheapest, strict=True)
        ],
    }


def _each(of: Record | None, what: str) -> str:
    """A count of each training."""
    return ", ".join(f"{count:,.0f}" for count in of[what]) if of else ABSENT
