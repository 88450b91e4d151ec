"""The gymnasium experiment: sparse spiking policies on the field's own tasks, teacher to chip.

A task has one teacher. Of each seed, a sparse spiking policy imitates it and goes on with reward; a
float MLP takes over the walks of the imitation and is pruned to as many operations. One dense
PopSAN imitates the teacher, too: the reference of operations.

Each row is a file of its own, <runs>/evaluations/<training>@<place>.json, which says what it was
made with: a stopped experiment goes on after the last row, and a row whose policy or sizes have
changed is made again.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lab.experiments import DESIGNS, QUICK, pages
from lab.experiments.costs import INT8, column, energies, is_spiking
from lab.experiments.fronts import Point
from lab.experiments.networks import FLOAT, network, play, random_actions
from lab.experiments.pages import grouped, share
from lab.experiments.runner import Design, Part
from lab.experiments.training import Record, StoredRow, TrainingJob, read_rows
from spikedeploy import zoo
from spikedeploy.comparison.statistics import Estimate, stratified_bootstrap
from spikedeploy.reports.plots import BLUE, VERMILION, save
from spikedeploy.reports.table import write_rows
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.files import as_text, read_json, write_text
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TEACHER, SPARSE, TUNED, DENSE, MLP = ROLES = ("teacher", "sparse", "tuned", "dense", "small-mlp")
RANDOM = "random"  # actions, not a training
IDEAL, BITS = "ideal", "int8"  # places: without a chip, rounded
_FURTHER = ("xylo-a3", "int")  # chips beside the first one, on which the last policy is evaluated
_VERSION = 1  # of what a row holds; a higher one makes all rows again

# a PopSAN as published for these tasks (Tang et al. 2020)
_WIDTH, _POPULATION, TIMESTEPS = 256, 10, 5
RATE = 0.15  # of a dense network that is not trained here: spikes of a neuron and timestep


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
    budget: float
    settings: Sequence[str] = ()
    student: Sequence[str] = ()
    baseline: Sequence[str] = ()
    wanted: float | None = None
    dense: Sequence[str] = ()
    reward: Sequence[str] = ()

    @classmethod
    def of(cls, env: str, fields: Mapping[str, Any]) -> "Task":
        """The task of designs.toml; lists there name lists of settings."""
        named = DESIGNS["gymnasium"]["settings"]
        found: Record = {
            field: [setting for name in value for setting in named[name]]
            if isinstance(value, list)
            else value
            for field, value in fields.items()
        }
        return cls(env, **found)

    @property
    def is_continuous(self) -> bool:
        """Return whether actions are continuous, as SAC and PopSAN need them."""
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


TASKS = {env: Task.of(env, of) for env, of in DESIGNS["gymnasium"]["tasks"].items()}


@dataclass(frozen=True)
class TaskTraining(TrainingJob):
    """A training of a task.

    env   id of the task
    role  of ROLES
    """

    env: str = ""
    role: str = ""


# settings of trainings of seconds
_QUICK = QUICK | {
    "distill-popsan": [*QUICK["distill"], *QUICK["distill-popsan"]],
    "distill-small-mlp": QUICK["distill-sparse"],
}


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
        budget = (f"budget={task.budget:g}", *DESIGNS["gymnasium"]["settings"]["planned"])
        teacher = self._training(task, TEACHER, task.recipe, 0, task.settings, {})
        taught = {"teacher": teacher}
        yield teacher
        for seed in range(self.seeds):
            settings = (*budget, *task.student)
            sparse = self._training(task, SPARSE, "distill-sparse", seed, settings, taught)
            yield sparse
            start, recipe = {"start": sparse}, "distill-sparse-tuned"
            yield self._training(task, TUNED, recipe, seed, task.reward, start)
            if task.is_continuous and seed == 0:
                yield self._training(task, DENSE, "distill-popsan", 0, task.dense, taught)
            walks = {**taught, "pool": sparse}
            settings = (*budget, *task.baseline)
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
        parts = []
        for training in self.trainings():
            rows = partial(self.rows, training)
            name = f"{training.name}: evaluation"
            parts += [Part.to_train(training), Part(name, rows, of=training, after=[training.name])]
        return parts

    def rows(self, training: TaskTraining) -> list[StoredRow]:
        """The rows of a training that has ended."""
        digest = zoo.sha256(training.checkpoint())
        return [
            StoredRow(
                Path(self.runs) / "evaluations" / f"{training.name}@{place}.json",
                {
                    "training": training.name,
                    "place": place,
                    "policy": "" if place == RANDOM else digest,
                    "episodes": self.episodes,
                    "first_seed": EVALUATION,
                    "limit": self.limit,
                    "version": _VERSION,
                },
                partial(self._evaluate, training, place),
                form=dict.fromkeys(("env", "role", "place"), str),
            )
            for place in self.places(training.role)
        ]

    def _evaluate(self, training: TaskTraining, place: str) -> Record:
        facts = {"env": training.env, "role": training.role, "seed": training.seed, "place": place}
        counts: Record = {}
        env, is_random = EnvConfig(name=training.env), place == RANDOM
        try:
            if is_random:
                facts |= {"role": RANDOM, "seed": None}
                played = play(env, self.episodes, random_actions(training.env), self.limit)
            else:
                file = Path(self.runs) / "policies" / training.name
                made = network(training.existing_run, "best", place, file)
                played = play(env, self.episodes, made.controller, self.limit)
                counts |= made.counts(played.walks)
        except RuleError as error:
            return facts | {"refusal": str(error)}
        return (
            facts
            | counts
            | {
                "episodes": len(played.returns),
                "return_mean": float(np.mean(played.returns)),
                "terminated": float(np.mean(played.terminated)),
                "steps": float(np.mean([len(walk.observation) for walk in played.walks])),
                "scores": played.returns,
            }
        )

    def write(self, results: Path) -> list[Path]:
        """Write page, table and picture of what is complete; return the files."""
        table, made = results / "gymnasium.csv", results / "gymnasium.json"
        new, old = list(self.all_rows()), read_table(table) if table.is_file() else []
        fresh = {row["env"] for row in new}  # tasks without new rows keep the old ones
        rows = [*new, *(row for row in old if row["env"] not in fresh)]
        write_table((row for env in TASKS for row in rows if row["env"] == env), table)
        write_text(made, as_text(self._facts()))
        # as they stand in the table, so that the page can be written again from it
        by_task = {env: [r for r in read_table(table) if r["env"] == env] for env in TASKS}
        found = {env: points(of) for env, of in by_task.items()}
        drawn = tasks_figure(found, self.chip)
        picture = save(drawn, results / "gymnasium.png")
        rate = rate_of_trained(found, self.chip)
        page, shown = pages.write_page(
            results / "gymnasium.md",
            {"gymnasium.png": drawn},
            made=read_json(made),
            verdicts="\n".join(verdict(env, of, self.chip, rate) for env, of in by_task.items()),
            rows=by_task,
            points=found,
            dense={env: reference(env, of, self.chip).operations for env, of in found.items()},
            earned=earned,
            is_spiking=is_spiking,
            tasks=TASKS.values(),
            **{"SPARSE": SPARSE, "TUNED": TUNED, "DENSE": DENSE, "MLP": MLP, "RANDOM": RANDOM},
            **{"TIMESTEPS": TIMESTEPS, "RATE": RATE, "LABELS": LABELS, "ENERGY": ENERGY},
        )
        return [page, table, made, picture, shown]

    def _facts(self) -> Record:
        """Facts on the making of the page."""
        trainings = self.trainings()
        names = self.tasks if len(self.tasks) == 1 else ()
        text = pages.command(self, *names, sizes=("seeds", "episodes"))
        lack = [part.of.name for part in self.parts() if part.of and not part.is_done]
        more = " and others" if len(lack) > _NAMED else ""
        note = (
            f"{len(lack)} of {len(trainings)} trainings, or their rows, are missing: "
            f"{', '.join(lack[:_NAMED])}{more}."
        )
        return {
            "command": pages.with_settings(text, self.settings),
            "chip": self.chip,
            "missing": pages.missing_text([note] if lack else [], self.limit),
            "facts": [
                f"- {pages.releases('torch', 'numpy', 'gymnasium', 'mujoco')}",
                f"- {self.episodes} episodes from seed 10,000 on",
                *pages.other_settings(trainings, "{} was trained with "),
                *_on_gpu(trainings),
            ],
        }


def _on_gpu(trainings: Sequence[TaskTraining]) -> list[str]:
    """Trainings whose gradients a GPU computed, which another one repeats with other last bits."""
    return [
        f"- {training.name} was trained with device=cuda, torch {versions['torch']}"
        for training in trainings
        if training.is_trained
        and training.run is not None
        and read_json(training.run / "config.json").get("device") == "cuda"
        and (versions := read_json(training.run / "versions.json"))
    ]


ENERGY = column(INT8, "updates")  # operations and neuron updates
_COLUMNS = (
    "env", "role", "seed", "place", "episodes", "return_mean", "terminated", "steps", "operations",
    "graded_operations", "bias_operations", "neurons", "neuron_updates", "readout_updates",
    "neuron_idle", "messages", "events", "spikes_out", "sparsity", "saturations", "observations",
    "constants", "on_host", ENERGY, "refusal", "scores",
)  # fmt: skip
LABELS = {
    TEACHER: "float teacher",
    DENSE: "dense PopSAN 256-256",
    SPARSE: "sparse, by imitation",
    TUNED: "sparse, with reward",
    MLP: "float MLP, pruned",
    RANDOM: "random actions",
}
ENOUGH, FEW = 0.95, 0.01  # of the teacher's return, and of the dense network's operations
_NAMED = 6  # of the trainings that are missing


def write_table(found: Iterable[Record], path: Path) -> Path:
    """Write rows, one a training, with their energies; missing fields stay empty.

    A row that was read again keeps its own energy.
    """
    rows = []
    for row in found:
        joules = energies(row).get(ENERGY) if row.get(ENERGY) is None else None
        rows.append(row if joules is None else row | {ENERGY: joules})
    return write_rows(rows, _COLUMNS, path)


def read_table(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    return read_rows(path, ("env", "role", "place", "refusal"))


def points(rows: Sequence[Record]) -> list[Point]:
    """All points of a task, role by role; none before the teacher is evaluated.

    Where the teacher earns less than nothing, the mean of random actions counts as no score.
    """
    scores = {row["role"]: row["scores"] for row in rows if row.get("scores")}
    teacher, drawn = scores.get(TEACHER), scores.get(RANDOM)
    if teacher is None:
        return []
    lowest = 0.0 if np.mean(teacher) > 0 or drawn is None else float(np.mean(drawn))
    whole = (row for row in rows if len(row.get("scores") or ()) == len(teacher))
    order = (TEACHER, DENSE, SPARSE, TUNED, *ROLES, RANDOM)
    found = [Point(of, teacher, lowest=lowest) for _, of in grouped(whole, "role", "place")]
    return sorted(found, key=lambda point: order.index(role(point)))


def role(point: Point) -> str:
    """One of ROLES, or RANDOM."""
    return str(point.rows[0]["role"])


def earned(point: Point) -> Estimate:
    """Mean return, with the stratified bootstrap over trainings and episodes."""
    return stratified_bootstrap(
        [row["scores"] for row in point.rows], np.random.default_rng(0)
    ).mean


@dataclass(frozen=True)
class Reference:
    """SOPs of the dense PopSAN in a control step, and whether they were measured."""

    operations: float
    measured: bool


def reference(env: str, found: Sequence[Point], chip: str) -> Reference:
    """Those of the PopSAN that was trained, else what layer sizes and a rate give."""
    for point in found:
        if (role(point), point.place) == (DENSE, chip):
            return Reference(point.mean("operations") or 0.0, measured=True)
    return Reference(TASKS[env].dense_operations(), measured=False)


def rate_of_trained(tasks: Mapping[str, Sequence[Point]], chip: str) -> float | None:
    """Mean spike rate on the chip of the dense networks that were trained; None without one."""
    dense = {env: reference(env, found, chip) for env, found in tasks.items()}
    rates = [
        d.operations / TASKS[env].dense_operations(1) for env, d in dense.items() if d.measured
    ]
    return float(np.mean(rates)) if rates else None


def pick_judged(found: Sequence[Point], chip: str) -> Point | None:
    """The policy that a verdict is about: with reward where it was trained so, on the chip."""
    at = {role(point): point for point in found if point.place == chip}
    return at.get(TUNED) or at.get(SPARSE)


def verdict(env: str, rows: Sequence[Record], chip: str, trained: float | None = None) -> str:
    """A line on whether a task is done on the chip at few operations, or what is missing.

    Its mark is that of the return, and ✗ where the operations are too many.

    trained  mean spike rate of the dense networks that were trained, on whatever task
    """
    found = points(rows)
    point, dense = pick_judged(found, chip), reference(env, found, chip)
    if point is None:
        return f"* – **{env}**: no spiking policy is evaluated on {chip} yet."
    operations, wanted = point.mean("operations") or 0.0, TASKS[env].wanted
    mine, seeds = earned(point), len(point.rows)
    few = operations <= FEW * dense.operations
    mark = point.of_teacher.mark(ENOUGH) if wanted is None else mine.mark(wanted)
    goal = f"{ENOUGH:.0%} of the teacher" if wanted is None else f"a return of {wanted:g}"
    how = "measured" if dense.measured else f"computed for a rate of {RATE:g}"
    if trained is not None and not dense.measured:
        part = operations / TASKS[env].dense_operations(trained)
        how += f"; {part:.2%} at the {trained:.3f} of those that were trained"
    lack = ["missed by the return"] if mark == "✗" else []
    lack += ["missed by the operations"] if not few else []
    lack += ["the interval of the return is on both sides"] if mark == "≈" else []
    return (
        f"* {mark if few else '✗'} **{env}**: {mine.text(',.0f')}, "
        f"{share(point.of_teacher)} of the teacher, with {operations:,.0f} SOPs a control step on "
        f"{chip}, {operations / dense.operations:.2%} of the PopSAN's {dense.operations:,.0f} "
        f"({how}), {LABELS[role(point)]}, {seeds} training seed{'s' if seeds > 1 else ''}. "
        f"Asked for: {goal} at {FEW:.0%}{'; ' * bool(lack)}{' and '.join(lack)}."
    )


# Okabe and Ito 2008; markers differ too
_LOOKS = {
    TEACHER: ("#000000", "^"),
    DENSE: ("#8A939E", "s"),
    SPARSE: ("#E69F00", "v"),
    TUNED: (VERMILION, "o"),
    MLP: (BLUE, "D"),
}
_GREY = "#8A939E"
_LOWEST = -5.0  # [%]
_HIGHEST = 108  # at least: markers at 100 are whole


def tasks_figure(found: Mapping[str, Sequence[Point]], chip: str) -> "Figure":
    """The points of each task."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 3.4), layout="constrained")
    panels = figure.subplots(1, len(TASKS), sharey=True)
    for axes, env in zip(panels, TASKS, strict=True):
        _panel(axes, env, found.get(env, ()), chip)
    handles = [
        panels[0].plot([], [], marker, color=colour, label=LABELS[role])[0]
        for role, (colour, marker) in _LOOKS.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    figure.supxlabel("operations a control step: SOPs, or MACs")
    panels[0].set_ylabel("% of the teacher's return")
    return figure


def _panel(axes: "Axes", env: str, found: Sequence[Point], chip: str) -> None:
    """Spiking policies on the chip, and float ones where they are."""
    axes.set_title(env, fontsize=9)
    limit = FEW * reference(env, found, chip).operations
    axes.axvline(limit, color=_GREY, linewidth=0.8, linestyle="--")
    axes.axhline(100 * ENOUGH, color=_GREY, linewidth=0.8, linestyle=":")
    for point in (p for p in found if p.place == chip or role(p) in (TEACHER, MLP)):
        if role(point) in _LOOKS and (operations := point.mean("operations")):
            colour, marker = _LOOKS[role(point)]
            estimate = point.of_teacher
            low, high = (100 * abs(end - estimate.mean) for end in estimate.ci95)
            axes.errorbar(
                [operations], [100 * estimate.mean], [[low], [high]], fmt=marker, color=colour,
                markersize=5, linewidth=1.2, capsize=2,
            )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xlim(10, 1e6)
    axes.set_ylim(_LOWEST, max(axes.get_ylim()[1], _HIGHEST))
    pages.plain(axes)
