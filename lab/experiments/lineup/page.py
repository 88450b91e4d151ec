"""The page of the lineup experiment, results/lineup.md.

Every number is of results/lineup.csv, one row a training, and of the sparse policies' rows in
results/pareto.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from lab.experiments.lineup import records
from lab.experiments.lineup.design import LineupDesign, teachers
from lab.experiments.lineup.evaluation import key
from lab.experiments.lineup.tables import sparse_rows, table, verdicts
from lab.experiments.parts import command_line
from spikedeploy.reports.csv_rows import Record
from spikedeploy.reports.page import write_beside
from spikedeploy.trainers.versions import began_with, own

TABLE = "lineup.csv"
_INTRODUCTION = """\
A row of `spikedeploy compare` is one training. Here the shipped policies that imitate a float
teacher are trained again, by the recipes and settings of their cards, with other seeds; the shipped
file is one of the trainings. `popsan-256` is `popsan` with 256 neurons in each hidden layer instead
of 512, and not shipped. The trainings of `sparse-gated`, where it is shown, are those of the pareto
experiment: with reward, at the last level of pruning, on loihi1, without a record of success. All
are evaluated in the same episodes, on seeds from 10,000 on that no training and no choice of a
checkpoint saw; spiking policies run on the chip, the others in float.

Intervals of 95 % are of the stratified bootstrap over trainings and episodes (Agarwal et al. 2021),
of one training over episodes alone. IQM is the mean without the lowest and the highest quarter,
risk the mean of the worst 5 %. The teachers are one training each: no interval includes their
variance over seeds. Lowest and highest are mean returns of one training, operations are means.
Bootstrap intervals over five trainings are too narrow: for five normal values they cover the mean
in 84 % of cases instead of 95 %, so one that narrowly excludes 100 % is weak evidence. The shipped
float policies were trained with seed 0. The shipped `sparse-gated` was chosen by validation, and
was then trained with reward, which the others were not.
MACs are multiply-accumulates with an input that is not 0, SOPs synaptic operations, both of a
control step and without neuron updates and encoder."""


_TRIAL = "**A quick trial, whose trainings take seconds: its returns say nothing.**"


def write(design: LineupDesign, results: Path) -> list[Path]:
    """Write page and table of the complete rows; return the files, the page first."""
    rows, page = results / TABLE, results / "lineup.md"
    records.write(design, rows)
    # as they stand in the table, so that the page can be written again from it
    shown = write_beside(page, text(design, records.read(rows), results / "pareto"), {})
    return [page, rows, shown[1]]


def text(design: LineupDesign, rows: Sequence[Record], sparse: Path) -> str:
    """The page of the rows of the table.

    sparse  folder of the tables of the pareto experiment
    """
    parts = ["# The line-up over training seeds", f"    {command_line()}", _missing(design, rows)]
    parts += [_TRIAL if design.quick else "", _INTRODUCTION]
    for env in dict.fromkeys(row["env"] for row in rows):
        file = sparse / f"{env}.csv"
        shown = [row for row in rows if row["env"] == env]
        shown += sparse_rows(env, file, design.episodes) if file.is_file() else []
        parts += [
            f"## {env}",
            teachers(env),
            table(shown),
            "\n".join(f"- {line}" for line in verdicts(shown)),
        ]
    facts = [
        f"- spikedeploy {own()}",
        *began_with(row["versions"] for row in rows),
        "- every number: [lineup.csv](lineup.csv)",
    ]
    parts += ["## How this was made", "\n".join(facts)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _missing(design: LineupDesign, rows: Sequence[Record]) -> str:
    """The trainings that have no row; empty where there are none."""
    there = {key(row) for row in rows}
    lack = [member for member in design.members() if member.key not in there]
    if not lack:
        return ""
    found = [
        f"{env}: {', '.join(f'{name} {count}' for name, count in counts.items())}"
        for env in design.tasks
        if (counts := Counter(member.policy for member in lack if member.env == env))
    ]
    return f"**Trainings that are missing, or were not evaluated: {'; '.join(found)}.**"
