"""Returns of sparse policies by each clock of loihi1, and those trained through a pipeline.

    python -m lab clocks -o results [--episodes 100] [--no-play] [TASK …]

Rows are the shipped `sparse-gated`, trained for a gated clock, which Loihi has not, run gated and
free, and the policies of OUTPUT/clocks/TASK-sSEED.nir, trained by `train TASK-sparse --seed SEED`
(or, TASK-tuned-sSEED.nir, by `train TASK-sparse-tuned` after it), pipelined. Episodes are the same
for all, from seed 80,000 on, which no training, validation or choice of a checkpoint has seen;
which policy of a training is taken was decided by its validation. Writes OUTPUT/clocks.csv and
OUTPUT/clocks.md; tasks that are not named keep their rows, with --no-play all do. The page has
pruned float networks of as many trainings beside them, from results/pareto/.
"""

import argparse
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lab.experiments import DESIGNS, fronts
from lab.experiments.pages import render
from lab.experiments.training import Record, read_rows, write_exactly
from spikedeploy import zoo
from spikedeploy.comparison.comparison import Row
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.comparison.lineup import Entry
from spikedeploy.comparison.statistics import (
    Estimate,
    nested_ratio,
    risk,
    stratified_bootstrap,
    t_interval,
)
from spikedeploy.envs.hexapod.env import HexapodEnv
from spikedeploy.policies import costs
from spikedeploy.policies.registry import find
from spikedeploy.runtime.files import write_text

FIRST_SEED = 80_000
RESULTS = Path(__file__).resolve().parents[2] / "results"
LEAST, FEWEST = 0.975, 3  # of the teacher's score, trainings: of pruned float networks shown
# task -> the float policy whose returns are 100 %, then small float ones
FLOATS: Mapping[str, Sequence[str]] = DESIGNS["clocks"]
KINDS = {
    "gated": "sparse-gated",
    "free": "sparse-gated",
    "pipelined": "trained pipelined",
    "pipelined, with reward": "trained pipelined, then with reward",
}


COLUMNS = (
    "task", "kind", "clock", "trainings", "episodes", "mean", "low", "high", "share", "share_low",
    "share_high", "succeeded", "failed", "worst", "seconds", "sops", "updates", "macs", "each",
)  # fmt: skip


def name_of(row: Record) -> str:
    """Name of a row: `hexapod/mlp-8`, `hexapod/sparse-gated, free`."""
    if row["kind"].startswith(("trained", "float")):
        return f"{row['task']}, {row['kind']}"
    clock = (row["clock"] or "").removesuffix(", assumed")
    return f"{row['task']}/{row['kind']}" + (f", {clock}" if clock else "")


def results(task: str, folder: Path, episodes: int) -> Iterator[Record]:
    """The rows of a task: each kind of policy in a clock, over all of its trainings."""
    shipped = f"{task}/sparse-gated"
    floats = [Entry(find(f"{task}/{name}")) for name in FLOATS[task]]
    groups: dict[str, list[Entry]] = {
        **{entry.label: [entry] for entry in floats},
        "gated": [Entry(find(shipped), "loihi1:clock=gated")],
        "free": [Entry(find(shipped), "loihi1:clock=free")],
        "pipelined": [Entry(find(str(p)), "loihi1") for p in sorted(folder.glob(f"{task}-s*.nir"))],
        "pipelined, with reward": [
            Entry(find(str(p)), "loihi1") for p in sorted(folder.glob(f"{task}-tuned-s*.nir"))
        ],
    }
    reference, entries = floats[0], [entry for group in groups.values() for entry in group]
    played = compare_policies(task, entries, range(FIRST_SEED, FIRST_SEED + episodes))
    beside = played.row(reference)
    if beside is None:
        raise ValueError(f"{task}: the reference was not played")
    for kind, group in groups.items():
        if rows := [row for entry in group if (row := played.row(entry))]:
            yield _result(task, kind, rows, beside)


def _result(task: str, kind: str, rows: Sequence[Row], reference: Row) -> Record:
    """A row of the table.

    share: of the reference's return in the same episodes, and its 95 % interval over trainings and
        episodes.
    failed, worst: episodes that ended early (Rollout.failed), mean return of the worst 5 %.
    seconds: mean duration of a lap over that of the reference's; NaN of walkers.
    clock: nothing of a float policy.
    sops, updates, macs: of a control step; MACs with an input that is not 0, as `sops` have.
    """
    returns = np.array([row.returns for row in rows])
    found = [costs.mean([e.costs for e in r.episodes], [e.steps for e in r.episodes]) for r in rows]
    earned, worst = stratified_bootstrap(returns, np.random.default_rng(0)).mean, risk(returns)
    of = nested_ratio(returns, np.array(reference.returns))
    clocks = {each.clock for each in found}
    if len(clocks) != 1:
        raise ValueError(f"{task}, {kind}: the policies run by clocks {sorted(map(str, clocks))}")
    values = (
        task, KINDS.get(kind, kind), clocks.pop() or "", len(rows), returns.shape[1],
        earned.mean, *earned.ci95, of.mean, *of.ci95,
        float(np.mean([row.successes for row in rows])),
        float(np.mean([row.failures for row in rows])), worst, _laps(rows) / _laps([reference]),
        float(np.mean([each.sops or 0 for each in found])),
        float(np.mean([each.neuron_updates or 0 for each in found])),
        float(np.mean([each.effective_macs or 0 for each in found])),
        " ".join(f"{mean:.4g}" for mean in returns.mean(axis=1)),
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def _laps(rows: Sequence[Row]) -> float:
    """Mean lap time [s] of the episodes that finished; NaN where none has one."""
    laps = [e.metrics["lap_time"] for row in rows for e in row.episodes if "lap_time" in e.metrics]
    return float(np.mean(laps)) if laps else float("nan")


def share_over_trainings(row: Mapping[str, Any]) -> Estimate | None:
    """Mean share of the reference's return, and the interval of Student's t over the trainings.

    The reference is one training, whose variance no interval includes. None of one training.
    """
    of = np.array([float(mean) for mean in row["each"].split()])
    return t_interval(of / row["mean"] * row["share"]) if of.size > 1 else None


def failed(row: Mapping[str, Any]) -> float | None:
    """Share of the episodes that ended early: 0 where all succeeded, None where it is unknown."""
    share: float | None = row["failed"]
    return 0.0 if share is None and row["succeeded"] == 1 else share


def worst_of_shipped(row: Mapping[str, Any]) -> float | None:
    """The worst 5 % of the file that is shipped, in the episodes of its card.

    Of a row of one training that is the file itself; of several, the one of them that is shipped.
    None of those that are not, or that their card has in another clock.
    """
    kind, clock = row["kind"], (row["clock"] or "").removesuffix(", assumed")
    chip = {"": None, "pipelined": "loihi1"}.get(clock, f"loihi1:clock={clock}")
    name = "sparse" if kind.startswith("trained") else kind
    if zoo.path(f"{row['task']}/{name}") is None:
        return None
    card = zoo.card(f"{row['task']}/{name}")
    if name == "sparse" and kind != shipped_kind(card):
        return None
    return next((each["risk"] for each in card["evaluation"] if each["chip"] == chip), None)


def shipped_kind(card: Mapping[str, Any]) -> str:
    """Of which trainings a task's `sparse` is, by its card."""
    return KINDS["pipelined, with reward" if card["recipe"].endswith("-tuned") else "pipelined"]


def pruned(task: str) -> Iterator[Record]:
    """Rows of the float networks of results/pareto/ that are pruned, as the spiking ones are.

    Those of several trainings with LEAST of the teacher's score. Of the command task nothing says
    which episodes succeeded, of karts how many ended early.
    """
    table = fronts.read_table(RESULTS / "pareto" / f"{task}.csv")
    beside = fronts.reference_rows(table)
    reference = beside.get("reference", beside["teacher"])  # FLOATS has the one before smooth
    for point in fronts.points([row for row in table if row.get("clock") != "free"]):
        is_float = point.place == "int8" and not point.is_spiking
        if is_float and len(point.rows) >= FEWEST and point.of_teacher.mean >= LEAST:
            yield _pruned_row(task, point, reference)


def _pruned_row(task: str, point: fronts.Point, reference: Record) -> Record:
    races = "kart" in task
    returns = np.array([row["returns" if races else "scores"] for row in point.rows])
    earned = stratified_bootstrap(returns, np.random.default_rng(0)).mean
    # of karts few teachers' returns are kept, episode by episode
    of = None if races else nested_ratio(returns, np.array(reference["scores"]))
    macs = point.mean("operations")
    values = (
        task, f"{point.label}, pruned to {macs:.0f} MACs", "", len(point.rows), returns.shape[1],
        earned.mean, *earned.ci95, of.mean if of else earned.mean / reference["return_mean"],
        *(of.ci95 if of else (None, None)),
        succeeded(task, point),
        None if races else point.mean("falls"), risk(returns), math.nan, 0.0, 0.0, macs,
        " ".join(f"{mean:.6g}" for mean in returns.mean(axis=1)),
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def succeeded(task: str, point: fronts.Point) -> float | None:
    """Share of the episodes that succeed; None where returns and falls do not say it."""
    scores = np.array([row["scores"] for row in point.rows])
    if "kart" in task:
        return float(np.mean(scores))
    if task != "hexapod" or any(row["falls"] for row in point.rows):
        return None
    return float(np.mean(scores >= HexapodEnv.SUCCESS_RETURN))


def page(found: Sequence[Record], episodes: int) -> str:
    """The table in Markdown, with what it says of each row."""
    rows = [
        row
        for task in FLOATS
        for row in (*(each for each in found if each["task"] == task), *pruned(task))
    ]
    return render(
        "clocks", rows=[(row, share_over_trainings(row)) for row in rows],
        name_of=name_of, failed=failed, worst_of_shipped=worst_of_shipped,
        episodes=episodes, first=FIRST_SEED,
        missing=dict.fromkeys(row["task"] for row in found if row["worst"] is None),
    )  # fmt: skip


def read(path: Path) -> list[Record]:
    """The rows of an earlier run."""
    rows = read_rows(path, ("task", "kind", "clock", "seconds", "each")) if path.is_file() else []
    return [dict.fromkeys(COLUMNS) | row | {"seconds": float(row["seconds"])} for row in rows]


def main() -> None:
    """Play the tasks that are named, and write the table of all."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=", ".join(FLOATS))
    parser.add_argument("-o", "--output", type=Path, default=Path("results"))
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--no-play", action="store_true", help="write the page of the rows kept")
    given = parser.parse_args()
    if unknown := set(given.tasks) - FLOATS.keys():
        parser.error(f"unknown: {', '.join(sorted(unknown))}. Choose of {', '.join(FLOATS)}.")
    path = given.output / "clocks.csv"
    tasks = [] if given.no_play else given.tasks or list(FLOATS)
    before = [row for row in read(path) if row["task"] not in tasks]
    if other := {row["episodes"] for row in before} - {given.episodes}:
        parser.error(
            f"{path}: rows that stay are of {min(other)} episodes: --episodes {min(other)}"
        )
    played = [
        row for task in tasks for row in results(task, given.output / "clocks", given.episodes)
    ]
    order = list(FLOATS)
    found = sorted([*before, *played], key=lambda row: order.index(row["task"]))
    write_exactly(found, COLUMNS, path)
    write_text(given.output / "clocks.md", page(found, given.episodes))
    print(given.output / "clocks.md")
