"""The page of the gymnasium experiment, results/gymnasium.md.

Every number is of results/gymnasium.csv, and what made it of gymnasium.json beside it, so that the
page can be written again without the runs. Rows of tasks without runs are kept as they are.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lab.experiments import pages
from lab.experiments.costs import INT8, column, energies, spikes
from lab.experiments.gymnasium import (
    DENSE,
    MLP,
    RANDOM,
    RATE,
    ROLES,
    SPARSE,
    TASKS,
    TEACHER,
    TIMESTEPS,
    TUNED,
    GymnasiumDesign,
    TaskTraining,
)
from lab.experiments.pages import grouped, mean, number, share
from lab.experiments.training import Record
from spikedeploy.comparison.statistics import Estimate, nested_ratio, stratified
from spikedeploy.files import as_text, read_json, write_text
from spikedeploy.reports.csv_rows import read_rows, write_rows
from spikedeploy.reports.plots import BLUE, VERMILION, save
from spikedeploy.reports.table import ABSENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ENERGY = column(INT8, "updates")  # operations and neuron updates
_COLUMNS = (
    "env", "role", "seed", "place", "episodes", "return_mean", "terminated", "steps", "operations",
    "graded_operations", "bias_operations", "neurons", "neuron_updates", "readout_updates",
    "neuron_idle", "messages", "events", "spikes_out", "sparsity", "saturations", "observations",
    "constants", "on_host", ENERGY, "refusal", "scores",
)  # fmt: skip
_TEXT = ("env", "role", "place", "refusal")
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


def write(design: GymnasiumDesign, results: Path) -> list[Path]:
    """Write page, table and picture of the complete rows; return the files."""
    table, made = results / "gymnasium.csv", results / "gymnasium.json"
    rows = _merged(list(design.all_rows()), read_table(table) if table.is_file() else [])
    write_table(rows, table)
    write_text(made, as_text(_made(design)))
    # as they stand in the table, so that the page can be written again from it
    by_task = {env: [r for r in read_table(table) if r["env"] == env] for env in TASKS}
    found = {env: points(of) for env, of in by_task.items()}
    drawn = tasks_figure(found, design.chip)
    picture = save(drawn, results / "gymnasium.png")
    rate = rate_of_trained(found, design.chip)
    page, shown = pages.write_page(
        results / "gymnasium.md",
        {"gymnasium.png": drawn},
        made=read_json(made),
        verdicts="\n".join(verdict(env, of, design.chip, rate) for env, of in by_task.items()),
        tables={
            env: _task_table(env, of, design.chip) if of else [] for env, of in by_task.items()
        },
        sizes=_size_table(),
        **{"SPARSE": SPARSE, "TUNED": TUNED, "DENSE": DENSE, "MLP": MLP},
        **{"TIMESTEPS": TIMESTEPS, "RATE": RATE},
    )
    return [page, table, made, picture, shown]


def write_table(found: Iterable[Record], path: Path) -> Path:
    """Write rows, one a training, with their energies; missing fields stay empty."""
    return write_rows([row | _energy(row) for row in found], _COLUMNS, path)


def _energy(row: Record) -> Record:
    """The energy of a new row; a row that was read again keeps its own."""
    if row.get(ENERGY) is not None or (joules := energies(row).get(ENERGY)) is None:
        return {}
    return {ENERGY: joules}


def read_table(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    return read_rows(path, _TEXT)


def _merged(new: Sequence[Record], old: Sequence[Record]) -> list[Record]:
    """The new rows, and the old ones of tasks that have no new ones; task by task."""
    fresh = {row["env"] for row in new}
    rows = [*new, *(row for row in old if row["env"] not in fresh)]
    return [row for env in TASKS for row in rows if row["env"] == env]


def _made(design: GymnasiumDesign) -> Record:
    """What the page says about its making."""
    trainings = design.trainings()
    names = design.tasks if len(design.tasks) == 1 else ()
    text = pages.command(design, *names, sizes=("seeds", "episodes"))
    return {
        "command": pages.with_settings(text, design.settings),
        "chip": design.chip,
        "missing": _missing(design, trainings),
        "facts": [
            f"- {pages.releases('torch', 'numpy', 'gymnasium', 'mujoco')}",
            f"- {design.episodes} episodes from seed 10,000 on",
            *pages.other_settings(trainings, "{} was trained with "),
            *_on_gpu(trainings),
        ],
    }


def _missing(design: GymnasiumDesign, trainings: Sequence[TaskTraining]) -> str:
    lack = [training.name for training in trainings if design.is_missing(training)]
    notes = []
    if lack:
        more = " and others" if len(lack) > _NAMED else ""
        notes.append(
            f"{len(lack)} of {len(trainings)} trainings, or their rows, are missing: "
            f"{', '.join(lack[:_NAMED])}{more}."
        )
    if design.limit:
        notes.append(
            f"A quick trial, whose episodes end after {design.limit} control steps: its scores "
            "say nothing."
        )
    return f"**{' '.join(notes)}**" if notes else ""


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


@dataclass(frozen=True, eq=False)
class TaskPoint:
    """A policy at a place, in all its trainings.

    role, place  as in its rows
    rows         of each training seed
    teacher      scores of the teacher on the same episodes
    lowest       what counts as no score: 0, or where the teacher earns less, random actions' mean
    """

    role: str
    place: str
    rows: Sequence[Record]
    teacher: Sequence[float]
    lowest: float

    @cached_property
    def of_teacher(self) -> Estimate:
        """Score in parts of the teacher's; the interval covers trainings and episodes."""
        scores = np.array([row["scores"] for row in self.rows]) - self.lowest
        return nested_ratio(scores, np.array(self.teacher) - self.lowest, np.random.default_rng(0))

    @cached_property
    def earned(self) -> Estimate:
        """Mean return, with the stratified bootstrap over trainings and episodes."""
        return stratified([row["scores"] for row in self.rows], np.random.default_rng(0)).mean

    def mean(self, field: str) -> float | None:
        """Mean of a field over the trainings; None where no row has it."""
        return mean(self.rows, field)


def points(rows: Sequence[Record]) -> list[TaskPoint]:
    """All points of a task, role by role; none before the teacher is evaluated."""
    scores = {row["role"]: row["scores"] for row in rows if row.get("scores")}
    teacher, drawn = scores.get(TEACHER), scores.get(RANDOM)
    if teacher is None:
        return []
    lowest = 0.0 if np.mean(teacher) > 0 or drawn is None else float(np.mean(drawn))
    whole = (row for row in rows if len(row.get("scores") or ()) == len(teacher))
    order = (TEACHER, DENSE, SPARSE, TUNED, *ROLES, RANDOM)
    found = [
        TaskPoint(role, place, of, teacher, lowest)
        for (role, place), of in grouped(whole, "role", "place")
    ]
    return sorted(found, key=lambda point: order.index(point.role))


@dataclass(frozen=True)
class Reference:
    """SOPs of the dense PopSAN in a control step, and whether they were measured."""

    operations: float
    measured: bool


def reference(env: str, found: Sequence[TaskPoint], chip: str) -> Reference:
    """Those of the PopSAN that was trained, else what layer sizes and a rate give."""
    for point in found:
        if (point.role, point.place) == (DENSE, chip):
            return Reference(point.mean("operations") or 0.0, measured=True)
    return Reference(TASKS[env].dense_operations(), measured=False)


def rate_of_trained(tasks: Mapping[str, Sequence[TaskPoint]], chip: str) -> float | None:
    """Mean spike rate on the chip of the dense networks that were trained; None without one."""
    dense = {env: reference(env, found, chip) for env, found in tasks.items()}
    rates = [
        d.operations / TASKS[env].dense_operations(1) for env, d in dense.items() if d.measured
    ]
    return float(np.mean(rates)) if rates else None


def judged(found: Sequence[TaskPoint], chip: str) -> TaskPoint | None:
    """The policy that a verdict is about: with reward where it was trained so, on the chip."""
    at = {point.role: point for point in found if point.place == chip}
    return at.get(TUNED) or at.get(SPARSE)


def _task_table(env: str, rows: Sequence[Record], chip: str) -> list[list[str]]:
    """Every policy at every place, and what chips refused."""
    found = points(rows)
    dense = reference(env, found, chip)
    lines = [
        ["policy", "where", "seeds", "return", "% of teacher", "falls", "operations",
         "% of PopSAN", "energy [pJ]"],
        *(_line(point, dense) for point in found),
        *([LABELS[row["role"]], row["place"], f"seed {row['seed']}", f"refused: {row['refusal']}",
           *[ABSENT] * 5] for row in rows if row.get("refusal")),
    ]  # fmt: skip
    return lines


def _line(point: TaskPoint, dense: Reference) -> list[str]:
    operations, joules = point.mean("operations"), point.mean(ENERGY)
    unit = "SOPs" if spikes(point.rows[0]) else "MACs"
    counted = ABSENT if operations is None else f"{operations:,.0f} {unit}"
    part = ABSENT if operations is None else f"{operations / dense.operations:.2%}"
    return [
        LABELS[point.role],
        point.place,
        f"{len(point.rows)}",
        point.earned.text(",.0f"),
        ABSENT if point.role == RANDOM else share(point.of_teacher),
        f"{point.mean('terminated') or 0.0:.0%}",
        counted,
        part,
        number(None if joules is None else joules * pages.PICO),
    ]


def verdict(env: str, rows: Sequence[Record], chip: str, trained: float | None = None) -> str:
    """Whether a task is done on the chip at few operations; what is missing where nobody knows.

    Its mark is that of the return, and ✗ where the operations are too many.

    trained  mean spike rate of the dense networks that were trained, on whatever task
    """
    found = points(rows)
    point, dense = judged(found, chip), reference(env, found, chip)
    if point is None:
        return f"* – **{env}**: no spiking policy is evaluated on {chip} yet."
    operations, wanted = point.mean("operations") or 0.0, TASKS[env].wanted
    earned, bound = (point.of_teacher, ENOUGH) if wanted is None else (point.earned, wanted)
    few = operations <= FEW * dense.operations
    mark = earned.mark(bound)
    goal = f"{ENOUGH:.0%} of the teacher" if wanted is None else f"a return of {wanted:g}"
    return (
        f"* {mark if few else '✗'} **{env}**: {point.earned.text(',.0f')}, "
        f"{share(point.of_teacher)} of the teacher, with {operations:,.0f} SOPs a control step on "
        f"{chip}, {operations / dense.operations:.2%} of the PopSAN's {dense.operations:,.0f} "
        f"({_how(env, dense, operations, trained)}), {LABELS[point.role]}, {_seeds(point)}. "
        f"Asked for: {goal} at {FEW:.0%}{_lack(mark, few)}."
    )


def _seeds(point: TaskPoint) -> str:
    return f"{len(point.rows)} training seed{'s' if len(point.rows) > 1 else ''}"


def _how(env: str, dense: Reference, operations: float, trained: float | None) -> str:
    if dense.measured:
        return "measured"
    assumed = f"computed for a rate of {RATE:g}"
    if trained is None:
        return assumed
    part = operations / TASKS[env].dense_operations(trained)
    return f"{assumed}; {part:.2%} at the {trained:.3f} of those that were trained"


def _lack(mark: str, few: bool) -> str:
    """What is missing, of a return with this mark."""
    said = ["missed by the return"] if mark == "✗" else []
    said += ["missed by the operations"] if not few else []
    said += ["the interval of the return is on both sides"] if mark == "≈" else []
    return f"; {' and '.join(said)}" if said else ""


def _size_table() -> list[list[str]]:
    """What the dense PopSAN of each task would take at most, and at the rate that is assumed."""
    lines = [
        ["task", "layers", "synapses", "SOPs at most", f"at a rate of {RATE:g}", "budget here"]
    ]
    for task in TASKS.values():
        layers = f"{10 * task.observations}-256-256-{10 * task.actions}"
        most, some = task.dense_operations(1.0), task.dense_operations()
        budget = f"{task.budget:,g} ({task.budget / some:.2%})"
        lines.append(
            [task.env, layers, *(f"{n:,.0f}" for n in (task.synapses, most, some)), budget]
        )
    return lines


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


def tasks_figure(found: Mapping[str, Sequence[TaskPoint]], chip: str) -> "Figure":
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


def _panel(axes: "Axes", env: str, found: Sequence[TaskPoint], chip: str) -> None:
    axes.set_title(env, fontsize=9)
    limit = FEW * reference(env, found, chip).operations
    axes.axvline(limit, color=_GREY, linewidth=0.8, linestyle="--")
    axes.axhline(100 * ENOUGH, color=_GREY, linewidth=0.8, linestyle=":")
    for point in found:
        operations = point.mean("operations")
        if point.role in _LOOKS and operations and _drawn(point, chip):
            colour, marker = _LOOKS[point.role]
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


def _drawn(point: TaskPoint, chip: str) -> bool:
    """Whether a point is drawn: spiking policies on the chip, float ones where they are."""
    return point.place == chip or point.role in (TEACHER, MLP)
