"""What the defaults of `distill` make of teachers of Stable-Baselines3, on seven tasks.

    python -m lab students [--seeds 3] [--only Pendulum-v1]

Teachers are trained here, one a task, in three to twelve minutes of one core, and kept in
results/students. Of each seed `distill` trains a spiking student and its float rival, without any
setting; a linear policy is trained and pruned likewise. All play the same episodes: the student on
the chip, float policies with weights of 8 bits. Rows of regulators of the double pendulum stay as
they were made at commit 548e02fb.
"""

import csv
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lab.experiments import policies, runner
from lab.experiments.intervals import nested_ratio, t_interval
from lab.experiments.runner import RESULTS, ROOT, Experiment, Record, number, share, trained
from spikedeploy.commands.distillation import FLOAT, RIVAL, STUDENT
from spikedeploy.comparison.statistics import risk
from spikedeploy.envs.foreign import attribute, import_target
from spikedeploy.reports.table import ABSENT
from spikedeploy.runtime.files import replacing, write_json
from spikedeploy.runtime.metrics.energy_tables import TABLES
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.trainers.distill.teachers import teacher
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.training_settings import SPARSE

TEACHER, RANDOM, IDLE, LINEAR = "teacher", "random", "no action", "float linear"
REGULATORS = ("LQR", "LQR, late", "LQR, late, shown its last action")
RECIPES = {STUDENT: SPARSE, FLOAT: RIVAL, LINEAR: "distill-small-linear"}
ROLES = (TEACHER, RANDOM, IDLE, *RECIPES, *REGULATORS)
PRICES = ("horowitz45-int8", "horowitz45-int8-acc16")  # sums in registers, in memory
TASKS: Mapping[str, Record] = runner.TASKS["students"]["tasks"]
WANTED = 0.97  # of the teacher
_LOST = 0.5  # of the way to the teacher's mean: an episode that earns less is lost
Key = tuple[str, str, int]


# rows


def jobs(seeds: int) -> Iterator[Key]:
    """Yield task, role and seed: teachers first, then seed by seed."""
    yield from ((task, role, 0) for task in TASKS for role in (TEACHER, RANDOM, IDLE))
    yield from ((t, role, seed) for seed in range(seeds) for t in TASKS for role in RECIPES)


def measure(job: Key) -> Iterator[Record]:
    """Train what is to be trained, and play."""
    task, role, seed = job
    env = TASKS[task]["env"]
    counts: Record = {}
    if role in RECIPES:
        run = RunFolder(_run(task, role, seed))
        if role == STUDENT:
            policy: Any = policies.EmulatedPolicy(Path(runnable(str(run.path))), "loihi1")
        else:
            policy = policies.InEightBits(run.path, run.path / "int8.onnx")
        # `validation` may choose a training: these episodes choose none
        counts = {"minutes": _minutes(run), "validation": run.load("best")[0]["eval_share"]}
    elif role == TEACHER:
        policy = policies.of_teacher(str(_teacher(task)), env)
        widths = teacher(str(_teacher(task)), env).widths
        counts = {"operations": float(sum(a * b for a, b in pairwise(widths)))}
    else:
        policy = policies.idle(env) if role == IDLE else policies.at_random(env)
    scores, did = policies.play(env, policy)
    counts |= {"operations": did.pop("sops"), **did} if did else {}
    every = {"task": task, "role": role, "seed": seed, "episodes": len(scores), **counts}
    yield {name: every.get(name) for name in EXPERIMENT.columns} | {"scores": scores}


def _run(task: str, role: str, seed: int) -> Path:
    """Return the run folder of a training; the rival takes over the student's walks."""
    settings = [f'teacher="{_teacher(task)}"']
    if role == FLOAT:
        pool = _run(task, STUDENT, seed)
        settings += [f'pool="{pool}"', "teacher_walks=0", "noisy_walks=0"]
    name = f"students/{task}-{role.replace(' ', '-')}-s{seed}"
    return trained(name, RECIPES[role], TASKS[task]["env"], settings, seed)


def _teacher(task: str) -> Path:
    """Return the teacher's model from the repository's root, trained where there is none."""
    file = RESULTS / "students" / f"{task}.zip"
    if not file.is_file():
        of = {**TASKS[task]["teacher"], "env": TASKS[task]["env"]}
        write_json(file.with_suffix(".json"), {"of": of, "row": {"minutes": _teach(of, file)}})
    return file.relative_to(ROOT)


def _teach(of: Record, file: Path) -> float:
    """Train a teacher with Stable-Baselines3 and save it; return the minutes that it took."""
    sb3, tools = map(import_module, ("stable_baselines3", "stable_baselines3.common.env_util"))
    env: Any = of["env"]
    if ":" in env:
        module, _, within = env.partition(":")
        env = attribute(env, import_target(env, module, "an environment"), within)
    worlds = tools.make_vec_env(env, n_envs=of["copies"], seed=0)
    began = time.process_time()
    settings = deepcopy(of["settings"])  # Stable-Baselines3 writes into it
    model = getattr(sb3, of["algorithm"])("MlpPolicy", worlds, seed=0, device="cpu", **settings)
    model.learn(of["steps"])
    minutes = (time.process_time() - began) / 60
    with replacing(file) as part, part.open("wb") as whole:
        model.save(whole)
    return minutes


def _minutes(run: RunFolder) -> float:
    """Return minutes of updates, walks and validations, those of an interrupted training too."""
    with run.metrics.open(encoding="utf-8") as file:
        rows = [(int(r["updates"]), float(r["updates_per_s"])) for r in csv.DictReader(file)]
    return sum((n - m) / rate for (m, _), (n, rate) in pairwise([(0, 1.0), *rows])) / 60


# page


def facts(rows: Sequence[Record]) -> Record:
    """Return what the page shows."""
    by: dict[tuple[str, str], list[Record]] = {}
    for row in rows:
        by.setdefault((row["task"], row["role"]), []).append(row)
    tasks = [facts_of_task(task, by) for task in TASKS if (task, TEACHER) in by]
    # where the student keeps enough, too
    compared = [each["energy"] for each in tasks if each["kept"] and each["energy"]]
    seeds = 1 + max((row["seed"] for row in rows), default=0)
    there = {(row["task"], row["role"], row["seed"]) for row in rows}
    return {
        "seeds": seeds,
        "episodes": policies.EPISODES,
        "tasks": tasks,
        "count": {name: sum(each[name] for each in tasks) for name in ("kept", "surely")},
        "fewer": np.sum([each["fewer"] for each in tasks], axis=0),
        "spent": [(min(each), max(each)) for each in zip(*compared, strict=True)],
        "compared": len(compared),
        "known": [row["validation"] is not None for row in rows if row["role"] in RECIPES],
        "missing": ["-".join(map(str, job)) for job in jobs(seeds) if job not in there],
        "WANTED": WANTED,
        "PRICES": PRICES,
    }


def facts_of_task(task: str, by: Mapping[tuple[str, str], Sequence[Record]]) -> Record:
    """Return what the page shows of a task, of the rows of each role."""
    roles = {role: by[task, role] for role in ROLES if (task, role) in by}
    random = float(np.mean(roles[RANDOM][0]["scores"]))
    idle = float(np.mean(roles[IDLE][0]["scores"])) if IDLE in roles else None
    # of the way from what no policy earns to what the teacher does
    zero = max(random, -np.inf if idle is None else idle)
    solved = threshold(TASKS[task]["env"])
    taught = np.asarray(roles[TEACHER][0]["scores"])
    found = {
        role: facts_of_policy(rows, taught, zero, solved)
        for role, rows in roles.items()
        if role not in (RANDOM, IDLE)
    }
    student = found.get(STUDENT)
    cheapest = _cheapest([found[role] for role in (FLOAT, LINEAR, *REGULATORS) if role in found])
    energy = []
    for price in (TABLES[name].joules for name in PRICES if student and cheapest[0] < math.inf):
        spent = [_energy(row, price) for row in roles[STUDENT]]
        energy.append(float(np.median(spent) / (cheapest[0] * price["mac"])))
    mine = _cheapest([student] if student else [])
    return {
        "name": task,
        "random": random,
        "idle": idle,
        "solved": solved,
        "policies": found,
        "rows": [_cells(task, role, each, energy) for role, each in found.items()],
        "energy": energy,
        "kept": student is not None and student["kept"],
        "surely": student is not None and student["share"].ci95[0] >= WANTED,
        "fewer": [own < least < math.inf for own, least in zip(mine, cheapest, strict=True)],
    }


def threshold(env: str) -> float | None:
    """Return the return from which gymnasium calls an episode solved; None where it has none."""
    return None if ":" in env else gymnasium.spec(env).reward_threshold


def facts_of_policy(
    rows: Sequence[Record], taught: NDArray[np.float64], zero: float, solved: float | None
) -> Record:
    """Return what the trainings of a policy earned and took, and which keep enough."""
    scores = np.asarray([row["scores"] for row in rows])
    found = nested_ratio(scores - zero, taught - zero)
    minutes = [row["minutes"] for row in rows if row.get("minutes") is not None]
    return {
        "trainings": len(rows),
        "share": found,
        "kept": found.mean >= WANTED,
        "each": ((scores.mean(1) - zero) / (taught.mean() - zero)).tolist(),
        "lost": (scores < zero + _LOST * (taught.mean() - zero)).sum(1).tolist(),
        "solved": [] if solved is None else (scores >= solved).mean(1).tolist(),
        "worst": float(np.mean([risk(each) for each in scores])),
        "earned": float(scores.mean()),
        "minutes": float(np.mean(minutes)) if minutes else None,
        **{
            name: [row.get(name) for row in rows]
            for name in ("operations", "updates", "readout_updates", "validation")
        },
    }


def _cheapest(found: Sequence[Record]) -> tuple[float, float]:
    """Return the fewest operations with which policies keep enough; infinite where none does.

    By the median of a policy's trainings, of those policies whose mean in the episodes that are
    shown keeps enough; and of the cheapest training: of those whose validation is recorded, that
    decides, and of others the policy's mean.
    """
    medians = [median(each["operations"]) for each in found if each["kept"]]
    best = [
        count
        for each in found
        for count, known in zip(each["operations"], each["validation"], strict=True)
        if (each["kept"] if known is None else known >= WANTED)
    ]
    return min(medians, default=math.inf), min(best, default=math.inf)


def _energy(row: Record, price: Mapping[str, float]) -> float:
    """Return the energy [J] of a student's operations and updates; readouts hold one state."""
    whole = price["neuron_update"]
    alone = price.get("one_state_update", whole) - whole
    readouts = row.get("readout_updates") or 0.0
    return float(row["operations"] * price["sop"] + row["updates"] * whole + readouts * alone)


def _cells(task: str, role: str, of: Record, energy: Sequence[float]) -> list[str]:
    """Return the cells of a policy in the table."""
    several = of["trainings"] > 1
    low, high = t_interval(of["each"]).ci95 if several else (0.0, 0.0)
    over_trainings = f"{np.mean(of['each']):.1%} [{100 * low:.1f}, {100 * high:.1f}]"
    return [
        task,
        role,
        f"{of['earned']:,.4g}",
        ABSENT if role == TEACHER else share(of["share"]),
        over_trainings if several else ABSENT,
        _numbers(of["each"], ".1%") if several else ABSENT,
        _numbers(of["solved"], ".0%"),
        _numbers(of["lost"]),
        f"{of['worst']:,.4g}",
        _numbers(of["operations"]),
        _numbers(of["updates"]),
        _numbers(of["readout_updates"]),
        "; ".join(f"{each:,.1f}" for each in energy) or ABSENT if role == STUDENT else ABSENT,
        number(of["minutes"]),
    ]


def _numbers(values: Sequence[float | None], form: str = ",.0f") -> str:
    """Return a number for each training."""
    return ", ".join(number(value, form) for value in values if value is not None) or ABSENT


EXPERIMENT = Experiment(
    name="students",
    columns=(
        "task", "role", "seed", "episodes", "operations", "updates", "readout_updates", "minutes",
        "validation", "scores",
    ),
    texts=("task", "role"),
    jobs=jobs,
    measure=measure,
    facts=facts,
)  # fmt: skip
main = EXPERIMENT.main
