"""The students experiment: what the defaults of `distill` make of teachers of Stable-Baselines3.

They are trained here, one a task, in three to twelve minutes of one core, and kept in
results/students. Of each seed `distill` trains a spiking student and its float rival, without any
setting; a linear policy is trained and pruned likewise. Of the double pendulum there are regulators
beside them (late.py). All play the same episodes: the student on the chip, float policies with
weights of 8 bits.
"""

import csv
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lab.experiments import DESIGNS, QUICK, late, pages
from lab.experiments.gymnasium import TaskTraining
from lab.experiments.networks import (
    float_actions,
    is_discrete,
    network,
    play,
    random_actions,
)
from lab.experiments.pages import ROOT, grouped, mean, number, percent, share
from lab.experiments.runner import Design, Part
from lab.experiments.training import Record, StoredRow, TrainingJob, read_rows, write_exactly
from spikedeploy import envs, zoo
from spikedeploy.commands.distillation import FLOAT, RIVAL, STUDENT
from spikedeploy.comparison.statistics import nested_ratio, risk, t_interval
from spikedeploy.envs.foreign import attribute, import_target
from spikedeploy.reports.table import ABSENT
from spikedeploy.runtime.files import replacing
from spikedeploy.runtime.metrics.energy import TABLES
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.distill.teachers import teacher
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.pool import BatchController, Stateless
from spikedeploy.training_settings import SPARSE

TEACHER, RANDOM, IDLE, LINEAR = "teacher", "random", "no action", "float linear"
# role -> whether it is shown its last action, and whether it acts a control step late
REGULATORS = {
    "LQR": (False, False), "LQR, late": (False, True),
    "LQR, late, shown its last action": (True, True),
}  # fmt: skip
ROLES = (TEACHER, RANDOM, IDLE, STUDENT, FLOAT, LINEAR, *REGULATORS)
PRICES = ("horowitz45-int8", "horowitz45-int8-acc16")  # sums in registers, in memory
TASKS: Mapping[str, Record] = DESIGNS["students"]["tasks"]
TEACHERS = ROOT / "results" / "students"
WANTED = 0.97  # of the teacher
_LOST = 0.5  # of the way to the teacher's mean: an episode that earns less is lost
_VERSION = 2  # of what a row holds; a higher one makes all rows again
_TEXT = ("task", "role")
_COLUMNS = (
    "task", "role", "seed", "episodes", "operations", "updates", "readout_updates", "minutes",
    "validation", "scores",
)  # fmt: skip


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
            if task == late.NAME:
                found.append(Part(f"{task}-regulators", partial(self._played, task, REGULATORS)))
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
        return self._played(task, (TEACHER, RANDOM, IDLE))

    def _played(self, task: str, roles: Iterable[str]) -> list[StoredRow]:
        return [row for role in roles for row in self._rows(task, role, 0, None)]

    def _rows(
        self, task: str, role: str, seed: int, training: TrainingJob | None
    ) -> list[StoredRow]:
        name = role.replace(",", "").replace(" ", "-")
        file = Path(self.runs) / "evaluations" / f"{task}-{name}-s{seed}.json"
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
            elif role in REGULATORS:
                gains = late.gain(REGULATORS[role][0])
                act = late.Regulator(gains, REGULATORS[role][1])
                counts = {"operations": float(gains.size)}
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
            run = RunFolder(training.existing_run)
            counts = {
                "operations": did["operations"],
                "updates": did.get("neuron_updates"),
                "readout_updates": did.get("readout_updates"),
                "minutes": _minutes(run),
                # by which a training may be chosen: these episodes choose none
                "validation": run.load("best")[0]["eval_share"],
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
        # where the student keeps enough, too
        compared = [each["energy"] for each in tasks if each["kept"] and each["energy"]]
        page, shown = pages.write_page(
            results / "students.md",
            {},
            command=pages.command(self, sizes=("seeds", "episodes")),
            quick=self.quick,
            episodes=self.episodes,
            first_seed=EVALUATION,
            chip=self.chip,
            tasks=tasks,
            count={name: sum(each[name] for each in tasks) for name in ("kept", "surely")},
            fewer=np.sum([each["fewer"] for each in tasks], axis=0),
            spent=[(min(by), max(by)) for by in zip(*compared, strict=True)],
            compared=len(compared),
            unknown=_unknown(rows),
            lost=_LOST,
            rows=[row for each in tasks for row in each["rows"]],
            missing=[
                training.name
                for training in self.trainings()
                if (training.env, training.role, training.seed)
                not in {(r["task"], r["role"], r["seed"]) for r in rows}
            ],
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
    roles = {role: by[task, role] for role in ROLES if (task, role) in by}
    # of the way from what no policy earns to what the teacher does
    zero = max(random, -np.inf if idle is None else idle)
    solved = _threshold(task)
    policies = {
        role: _policy(rows, np.asarray(taught), zero, solved)
        for role, rows in roles.items()
        if role not in (RANDOM, IDLE)
    }
    student = policies.get(STUDENT)
    floats = [policies[role] for role in (FLOAT, LINEAR, *REGULATORS) if role in policies]
    cheapest = _cheapest(floats)
    energy = []
    for price in (TABLES[name].joules for name in PRICES if student and cheapest[0] < math.inf):
        spent = [_energy(row, price) for row in roles[STUDENT]]
        energy.append(float(np.median(spent) / (cheapest[0] * price["mac"])))
    return {
        "name": task,
        "earned": earned,
        "random": random,
        "idle": idle,
        "solved": solved,
        "policies": policies,
        "rows": [_line(task, role, each, energy) for role, each in policies.items()],
        "energy": energy,
        "kept": student is not None and student["kept"],
        "surely": student is not None and student["share"].ci95[0] >= WANTED,
        "fewer": [
            mine < least < math.inf
            for mine, least in zip(_cheapest([student] if student else []), cheapest, strict=True)
        ],
    }


def _unknown(rows: Sequence[Record]) -> str:
    """How many trainings have no record of their validation; nothing where all have."""
    trained = [row for row in rows if row["role"] in (STUDENT, FLOAT, LINEAR)]
    lacking = sum(row["validation"] is None for row in trained)
    if not lacking:
        return ""
    if lacking == len(trained):
        return f"No training here was chosen by validation: none of the {lacking} recorded it"
    return f"Of {len(trained)} trainings {lacking} recorded no validation"


def _threshold(task: str) -> float | None:
    """The return from which gymnasium calls an episode solved; None of tasks that have none."""
    env = TASKS[task]["env"]
    return None if ":" in env else gymnasium.spec(env).reward_threshold


def _policy(
    rows: Sequence[Record], taught: NDArray[np.float64], zero: float, solved: float | None
) -> Record:
    """Facts of the trainings of a policy: returns, operations, and which keep enough."""
    scores = np.asarray([row["scores"] for row in rows])
    share_of = nested_ratio(scores - zero, taught - zero)
    each = (scores.mean(1) - zero) / (taught.mean() - zero)
    return {
        "trainings": len(rows),
        "share": share_of,
        "kept": share_of.mean >= WANTED,
        "each": each.tolist(),
        "lost": (scores < zero + _LOST * (taught.mean() - zero)).sum(1).tolist(),
        "solved": [] if solved is None else (scores >= solved).mean(1).tolist(),
        "worst": float(np.mean([risk(each) for each in scores])),
        "earned": float(scores.mean()),
        "operations": [row.get("operations") for row in rows],
        "updates": [row.get("updates") for row in rows],
        "readouts": [row.get("readout_updates") for row in rows],
        "validation": [row.get("validation") for row in rows],
        "minutes": mean(rows, "minutes"),
    }


def _cheapest(policies: Sequence[Record]) -> tuple[float, float]:
    """Fewest operations with which policies keep enough; infinite where none does.

    By the median of a policy's trainings, of those policies whose mean in the episodes that are
    shown keeps enough; and of the cheapest training: of those whose validation is recorded, that
    decides, and of others the policy's mean.
    """
    medians = [median(each["operations"]) for each in policies if each["kept"]]
    best = [
        count
        for each in policies
        for count, known in zip(each["operations"], each["validation"], strict=True)
        if (each["kept"] if known is None else known >= WANTED)
    ]
    return min(medians, default=math.inf), min(best, default=math.inf)


def _energy(row: Record, price: Mapping[str, float]) -> float:
    """Energy [J] of a student's synaptic operations and updates; readouts hold one state."""
    whole = price["neuron_update"]
    alone = price.get("one_state_update", whole) - whole
    return float(
        row["operations"] * price["sop"]
        + row["updates"] * whole
        + (row.get("readout_updates") or 0.0) * alone
    )


def _line(task: str, role: str, of: Record, energy: Sequence[float]) -> list[str]:
    """The cells of a policy in the table."""
    several = of["trainings"] > 1
    alone = role == TEACHER
    return [
        task,
        role,
        f"{of['earned']:,.4g}",
        ABSENT if alone else share(of["share"]),
        percent(t_interval(of["each"]), 1) if several else ABSENT,
        _counts(of["each"], ".1%") if several else ABSENT,
        _counts(of["solved"], ".0%"),
        _counts(of["lost"]),
        f"{of['worst']:,.4g}",
        _counts(of["operations"]),
        _counts(of["updates"]),
        _counts(of["readouts"]),
        "; ".join(f"{each:,.1f}" for each in energy) or ABSENT if role == STUDENT else ABSENT,
        number(of["minutes"]),
    ]


def _counts(values: Sequence[float | None], form: str = ",.0f") -> str:
    """A number of each training."""
    return ", ".join(number(value, form) for value in values if value is not None) or ABSENT
