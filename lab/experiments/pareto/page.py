"""The page of the pareto experiment, results/pareto.md: a section for each environment's CSV.

Every number is of results/pareto/<env>.csv, and what made it of <env>.json beside it, so that the
page can be written again without the runs.
"""

import shlex
from pathlib import Path

from lab.experiments.pareto import records, tables
from lab.experiments.pareto.costs import ACC16, ACC32, INT8, LEAN_UPDATE
from lab.experiments.pareto.design import ENVS, ParetoDesign
from lab.experiments.pareto.evaluation import all_rows
from lab.experiments.pareto.fronts import Record, points, reference_row
from lab.experiments.pareto.levels import level_table, return_table
from lab.experiments.pareto.overview import overview
from lab.experiments.pareto.plot import front_figure
from spikedeploy.files import as_text, read_json, write_text
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.plots import save
from spikedeploy.runtime.metrics.energy_tables import TABLES
from spikedeploy.trainers.versions import installed, own

_PICO = 1e12
_PACKAGES = ("torch", "numpy", "mujoco")


def _price(table: str, event: str) -> float:
    """In pJ."""
    return TABLES[table].joules[event] * _PICO


_INTRODUCTION = f"""\
Sparse policies and their float baselines: all imitate the same teacher on the same walks and are
pruned by the same ranking, each to levels of its own, in operations of a control step. Updates of a
level are as many for all; at their last level policies are polished once or more, and LIF walkers
have about a tenth more updates in all.
`LIF` is a delta encoder, a layer of spiking neurons and integrating readouts; `delta-linear` sends
the encoder's events straight into the readouts; `delta network` has sigma-delta ReLU neurons in
between, whose graded spikes only loihi2 and ideal have; `float MLP` and `float linear` multiply.
The last level of each, delta networks apart, is then trained on with reward, by PPO with as many
episodes of each student: "with reward"; MLPs from one earlier level too, and from no other: what
reward would do for the MLPs in between was not tried. Masks and budget stay.
"Reference" is the policy shipped before, where the teacher is another one.

Operations are synaptic operations of spiking policies, and multiply-accumulates with an input that
is not 0 of float ones. An operation of a graded spike multiplies too, and costs as much as a
multiply-accumulate. All weights have 8 bits: spiking policies run in the integers of the
emulated chip, float ones with weights rounded symmetrically, one scale a matrix, and activations in
float, whose multiplications are priced as of 8 bits. By {INT8} readouts are priced as whole
neurons, though they have one state: that favours float networks. Scores are returns of walks, and
finishes of karts, on seeds from 10,000 on that no training and no choice of a checkpoint saw;
teacher and students have the same. Intervals of 95 % are bootstrapped over training
seeds, then over episodes of student and teacher together; with one training seed they cover
episodes alone. "Finished" has Wilson's interval over all episodes. Other numbers are means over
training seeds. The second table of each task has return, IQM and risk of all trainings together,
with intervals by the stratified bootstrap over training seeds and episodes (Agarwal et al. 2021):
each of 10,000 resamples draws trainings, then episodes, the same for all of them. IQM is the mean
without the lowest and the highest quarter, risk the mean of the worst 5 %. Teacher and reference
are one training each. "Finished" of 100 % has no width there.

Energies are of a control step, in pJ, by {INT8}: {_price(INT8, "sop"):.2f} pJ a synaptic
operation, {_price(INT8, "mac"):.2f} a multiply-accumulate, {_price(INT8, "neuron_update"):.1f} a
neuron update. It takes sums for registers. "Sums of 16 bits in memory" are prices by
{ACC16}, "of 32 bits" by {ACC32}: a synaptic operation finds its sum by an index, reads and writes
it ({_price(ACC16, "sop"):.1f} and {_price(ACC32, "sop"):.1f} pJ), and a multiply-accumulate finds
its input by an index and reads it ({_price(ACC16, "mac"):.2f}). States are as wide as sums: an
update costs {_price(ACC16, "neuron_update"):.1f} and {_price(ACC32, "neuron_update"):.1f} pJ, that
of a readout, which has one state, {_price(ACC16, "one_state_update"):.1f} and
{_price(ACC32, "one_state_update"):.1f}. With its inputs in registers a float network would cost
1.25 pJ less a multiply-accumulate ([energy.md](energy.md) has that too). "The rest" are encoder,
messages and the constants of readouts. The encoder takes, for each observation that some synapse
reads, a subtraction and a comparison (0.1 pJ each, 32-bit integers) and a read of its level, and
for each event an addition and a write of the level; the observation is read by float networks too.
16 bits are read or written for 2.5 pJ, a quarter of an access of 64 bits (Horowitz 2014). What each
readout adds as a constant, and each float neuron as its bias, costs as much as an operation.
"Lean updates" have states of 16 bits and decays by powers of two, so shifts: five additions and
four accesses, {LEAN_UPDATE * _PICO:.1f} pJ. That is derived, not measured; the policies evaluated
here have other decays and would have to be trained with such, and whether their states fit into 16
bits is not checked. davies2018 and sanafe are prices of Loihi 1 and have none for
multiply-accumulates. They charge neurons without an update too, also in the timesteps that only
fill the pipeline; encoder and constants, which are the host's, cost the same as above."""
_OVERVIEW = f"""\
Of each student the level with the fewest operations of those with {tables.NEARLY:.0%} of the
teacher's score or more; where none has it, the one with the highest score. It is chosen on the
episodes that it is reported on, among the few levels below, for spiking and float students
alike."""
_BASELINES = f"""\
Each spiking policy with {tables.NEAR:.0%} of the teacher's score or more, beside the cheapest float
student whose mean score is not below its own: pJ against pJ. Few levels were trained, so a tenth of
a percent can decide which baseline that is. The sentences at the top take the same bounds for both,
and in brackets the least and the largest ratio as the intervals of the scores allow: policies whose
interval reaches the bound beside those whose whole interval is above it. ✓ and ✗ are ratios that
are on one side of 1 throughout; ≈ is undecided. No cheaper float policy was trained than those in
the tables, none of them longer, and MLPs went on with reward from few of their levels: a baseline
that is missing makes a ratio look better than it is."""


def write(design: ParetoDesign, results: Path) -> list[Path]:
    """Write page, table and picture of the complete parts; return the files.

    Where there are no run folders, the table that is there is kept.
    """
    found, folder = list(all_rows(design)), results / "pareto"
    table = folder / f"{design.env}.csv"
    if found or not table.is_file():
        records.write(found, table)
        write_text(table.with_suffix(".json"), as_text(_made(design)))
    drawn = {
        _picture(env): front_figure(env, points(records.read(csv))) for env, csv in _tables(folder)
    }
    pictures = [save(drawn[_picture(design.env)], table.with_suffix(".png"))]
    page, shown = write_beside(results / "pareto.md", text(folder), drawn)
    return [page, table, *pictures, shown]


def _picture(env: str) -> str:
    """Its address on the page."""
    return f"pareto/{env}.png"


def _tables(folder: Path) -> list[tuple[str, Path]]:
    """The environments that were run, and their tables."""
    found = [(env, folder / f"{env}.csv") for env in ENVS]
    return [(env, path) for env, path in found if path.is_file()]


def text(folder: Path) -> str:
    """The page, of the tables in the folder."""
    found = {env: records.read(path) for env, path in _tables(folder)}
    parts = ["# Return against operations and energy", _INTRODUCTION]
    parts += ["## All tasks", _OVERVIEW, overview(found)]
    for env, path in _tables(folder):
        made = read_json(path.with_suffix(".json"))
        parts += _section(env, found[env], made)
    return "\n\n".join(part for part in parts if part) + "\n"


def _section(env: str, rows: list[Record], made: Record) -> list[str]:
    found = points(rows)
    head = [f"## {env}", f"    {made['command']}"]
    if reference_row(rows) is None or not found:
        return [*head, "Nothing is evaluated yet."]
    return [
        *head,
        made["missing"],
        "\n".join(tables.sentences(found)),
        f"![return against operations and energy]({_picture(env)})",
        "### Every level",
        level_table(rows, found),
        "### Returns over training seeds and episodes",
        return_table(rows, found),
        "### What it costs [pJ]",
        tables.energy_table(found),
        "Terms of the last level:",
        tables.term_table(found),
        "### Against float students",
        _BASELINES,
        tables.baseline_table(found) or "There is none.",
        "### The last level elsewhere",
        f"On the first {made['chip_episodes']} of the seeds; counts of the first row of each "
        "policy are of all.",
        tables.place_table(rows, found),
        "### How this was made",
        "\n".join([*made["facts"], f"- every number: [{env}.csv](pareto/{env}.csv)"]),
    ]


def _made(design: ParetoDesign) -> Record:
    """What the page says about the making of a table."""
    return {
        "command": _command(design),
        "chip_episodes": design.chip_episodes,
        "missing": _missing(design),
        "facts": _facts(design),
    }


def _command(design: ParetoDesign) -> str:
    words = ["python", "-m", "lab", "experiment", "pareto", design.env]
    words += ["--quick"] if design.quick else []
    words += ["--seeds", f"{design.seeds}", "--episodes", f"{design.episodes}"]
    words += ["--chip-episodes", f"{design.chip_episodes}"]
    words += ["--chip", design.chip] if design.chip != "loihi1" else []
    words += ["--levels", f"{design.levels}"] if design.levels else []
    return shlex.join([*words, *(w for each in design.settings for w in ("--set", each))])


def _missing(design: ParetoDesign) -> str:
    trainings = design.everything()
    done = sum(training.trained for training in trainings)
    notes = [f"{done} of {len(trainings)} trainings are done."] if done < len(trainings) else []
    if design.limit:
        steps = f"{design.limit} control steps"
        notes.append(f"A quick trial, whose episodes end after {steps}: its scores say nothing.")
    return f"**{' '.join(notes)}**" if notes else ""


def _facts(design: ParetoDesign) -> list[str]:
    """What is needed to reproduce the table."""
    packages = ", ".join(f"{name} {installed(name)}" for name in _PACKAGES)
    trained = [training for training in design.everything() if training.trained]
    return [
        f"- spikedeploy {own()}, {packages}",
        f"- training seeds 0 to {design.seeds - 1}; {design.episodes} episodes of "
        f"{_levels(design)} from seed 10,000 on, {design.chip_episodes} elsewhere"
        + (f", of at most {design.limit} control steps" if design.limit else ""),
        *(
            f"- ✗ {training.name} was trained with other settings than its recipe has now: "
            + ", ".join(changed)
            for training in trained
            if (changed := training.changed_settings)
        ),
    ]


def _levels(design: ParetoDesign) -> str:
    if design.levels is None:
        return "every level"
    return "the last level" if design.levels == 1 else f"the last {design.levels} levels"
