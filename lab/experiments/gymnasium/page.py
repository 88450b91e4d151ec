"""The page of the gymnasium experiment, results/gymnasium.md.

Every number is of results/gymnasium.csv, and what made it of gymnasium.json beside it, so that the
page can be written again without the runs. Rows of tasks without runs are kept as they are.
"""

import shlex
from collections.abc import Sequence
from pathlib import Path

from lab.experiments.gymnasium import records, tables
from lab.experiments.gymnasium.design import DENSE, MLP, SPARSE, TUNED, GymnasiumDesign
from lab.experiments.gymnasium.evaluation import all_rows, missing
from lab.experiments.gymnasium.plot import tasks_figure
from lab.experiments.gymnasium.points import points, rate_of_trained
from lab.experiments.gymnasium.published import published
from lab.experiments.gymnasium.tasks import RATE, TASKS, TIMESTEPS
from lab.experiments.gymnasium.training import TaskTraining
from spikedeploy.files import as_text, read_json, write_text
from spikedeploy.reports.csv_rows import Record
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.plots import save
from spikedeploy.trainers.versions import installed, own

_PACKAGES = ("torch", "numpy", "gymnasium", "mujoco")
_NAMED = 6  # of the trainings that are missing
_INTRODUCTION = f"""\
Sparse spiking policies on the field's own tasks, from a float teacher to an emulated chip. One
teacher a task is trained by SAC (CartPole: PPO). Students imitate it: `{SPARSE}` is a delta
encoder, a layer of LIF neurons (16 on CartPole, 32 on Pendulum, else 128) and integrating readouts,
pruned to a budget of operations; `{TUNED}` goes on from it with reward; `{DENSE}` is a PopSAN
256-256 with T = {TIMESTEPS} and ten encoding neurons an observation, the size published for these
tasks; `{MLP}` is a float MLP that learned from the same episodes and was pruned by the same
ranking to as many operations, its weights rounded to 8 bits. `{DENSE}` and `{MLP}` imitate only:
neither went on with reward.

Operations are synaptic operations (SOPs) of spiking policies and multiply-accumulates of float
ones, of a teacher all, of a pruned network those with an input that is not 0. "% of PopSAN" is the
share of the SOPs of the dense PopSAN, measured on the chip where it was trained, else computed for
spikes of {RATE:.0%} of its neurons in each timestep. Energy is by horowitz45-int8, operations and
neuron updates together; encoders, constants and the dense network's state resets are left out.
"Falls" are episodes that ended in a terminal state. Returns are on seeds from 10,000 on, the same
for all, that no training and no choice of a checkpoint saw; intervals of 95 % are bootstrapped over
training seeds, then over episodes. There is one teacher seed, whose chance no interval covers.
"% of teacher" is the share of its return; where that is negative, of the way from random actions to
the teacher. `ideal` is float64 without a chip."""

_PICTURE = "gymnasium.png"
_VERDICTS = """\
✓: the whole interval of the return is good enough; ✗: none of it is, or the operations are too
many; ≈: the interval is on both sides."""


def write(design: GymnasiumDesign, results: Path) -> list[Path]:
    """Write page, table and picture of the complete rows; return the files."""
    table, page = results / "gymnasium.csv", results / "gymnasium.md"
    rows = _merged(list(all_rows(design)), records.read(table) if table.is_file() else [])
    records.write(rows, table)
    made = table.with_suffix(".json")
    write_text(made, as_text(_made(design)))
    # as they stand in the table, so that the page can be written again from it
    by_task = _by_task(records.read(table))
    found = {env: points(of) for env, of in by_task.items()}
    drawn = tasks_figure(found, design.chip)
    picture = save(drawn, results / _PICTURE)
    written = text(by_task, read_json(made))
    _, shown = write_beside(page, written, {_PICTURE: drawn})
    return [page, table, made, picture, shown]


def _merged(new: Sequence[Record], old: Sequence[Record]) -> list[Record]:
    """The new rows, and the old ones of tasks that have no new ones; task by task."""
    fresh = {row["env"] for row in new}
    rows = [*new, *(row for row in old if row["env"] not in fresh)]
    return [row for env in TASKS for row in rows if row["env"] == env]


def _by_task(rows: Sequence[Record]) -> dict[str, list[Record]]:
    return {env: [row for row in rows if row["env"] == env] for env in TASKS}


def text(by_task: dict[str, list[Record]], made: Record) -> str:
    """The page, of the rows of each task and of what made them."""
    chip = made["chip"]
    rate = rate_of_trained({env: points(rows) for env, rows in by_task.items()}, chip)
    parts = [
        "# Gymnasium's tasks",
        f"    {made['command']}",
        made["missing"],
        _INTRODUCTION,
        "## Verdicts",
        _VERDICTS,
        "\n".join(tables.verdict(env, rows, chip, rate) for env, rows in by_task.items()),
        f"![% of the teacher's return against operations]({_PICTURE})",
        "Dashed: 1 % of the dense PopSAN's SOPs. Dotted: 95 % of the teacher.",
    ]
    for env, rows in by_task.items():
        parts += [f"## {env}", tables.task_table(env, rows, chip) if rows else "Not evaluated yet."]
    parts += ["## The dense PopSAN", tables.size_table(), "## Published results", published()]
    facts = [*made["facts"], "- every number: [gymnasium.csv](gymnasium.csv)"]
    parts += ["## How this was made", "\n".join(facts)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _made(design: GymnasiumDesign) -> Record:
    """What the page says about its making."""
    trainings = design.trainings()
    packages = ", ".join(f"{name} {installed(name)}" for name in _PACKAGES)
    return {
        "command": _command(design),
        "chip": design.chip,
        "missing": _missing(design, trainings),
        "facts": [
            f"- spikedeploy {own()}, {packages}",
            f"- {design.episodes} episodes from seed 10,000 on",
            *_other_settings(trainings),
            *_on_gpu(trainings),
        ],
    }


def _missing(design: GymnasiumDesign, trainings: Sequence[TaskTraining]) -> str:
    lack = [training.name for training in trainings if missing(design, training)]
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


def _other_settings(trainings: Sequence[TaskTraining]) -> list[str]:
    """Trainings whose settings are not all those of the recipe and the design."""
    return [
        f"- {training.name} was trained with {', '.join(changed)}"
        for training in trainings
        if training.trained and (changed := training.changed_settings)
    ]


def _on_gpu(trainings: Sequence[TaskTraining]) -> list[str]:
    """Trainings whose gradients a GPU computed, which another one repeats with other last bits."""
    return [
        f"- {training.name} was trained with device=cuda, torch {versions['torch']}"
        for training in trainings
        if training.trained
        and training.run is not None
        and read_json(training.run / "config.json").get("device") == "cuda"
        and (versions := read_json(training.run / "versions.json"))
    ]


def _command(design: GymnasiumDesign) -> str:
    words = ["python", "-m", "lab", "experiment", "gymnasium"]
    words += [*design.tasks] if len(design.tasks) == 1 else []
    words += ["--quick"] if design.quick else []
    words += ["--seeds", f"{design.seeds}", "--episodes", f"{design.episodes}"]
    words += ["--chip", design.chip] if design.chip != "loihi1" else []
    return shlex.join([*words, *(w for each in design.settings for w in ("--set", each))])
