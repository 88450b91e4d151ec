"""Returns of sparse policies by each clock of loihi1, and those trained through a pipeline.

    python -m lab clocks [--only hexapod]

Rows are the shipped `sparse-gated`, trained for a gated clock, which Loihi has not, run gated and
free, and the policies of results/clocks/TASK-sSEED.nir, trained by `train TASK-sparse --seed SEED`
(or, TASK-tuned-sSEED.nir, by `train TASK-sparse-tuned` after it), pipelined. Episodes are the same
for all, from seed 80,000 on, which no training, validation or choice of a checkpoint has seen.
Rows of pruned float networks are those of results/pareto/, which is not made any more: they stay.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from lab.experiments.intervals import nested_ratio, t_interval
from lab.experiments.runner import RESULTS, TASKS, Experiment, Record
from spikedeploy import zoo
from spikedeploy.comparison.comparison import PolicyRow
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.comparison.statistics import (
    Estimate,
    risk,
    stratified_bootstrap,
)
from spikedeploy.policies import costs
from spikedeploy.policies.registry import Entry, find

FIRST_SEED, EPISODES = 80_000, 100
# task -> the float policy whose returns are 100 %, then small float ones
FLOATS: Mapping[str, Sequence[str]] = TASKS["clocks"]
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


def jobs(_: int) -> Iterator[tuple[str]]:
    """Yield the tasks, whose policies are there already."""
    yield from ((task,) for task in FLOATS)


def measure(job: tuple[str]) -> Iterator[Record]:
    """Yield the rows of a task: each kind of policy in a clock, over all of its trainings."""
    (task,) = job
    shipped, folder = f"{task}/sparse-gated", RESULTS / "clocks"
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
    played = compare_policies(task, entries, range(FIRST_SEED, FIRST_SEED + EPISODES))
    beside = played.row(reference)
    if beside is None:
        raise ValueError(f"{task}: the reference was not played")
    for kind, group in groups.items():
        if rows := [row for entry in group if (row := played.row(entry))]:
            yield _result(task, kind, rows, beside)
    yield from (r for r in EXPERIMENT.read() if r["task"] == task and "pruned" in r["kind"])


def _result(task: str, kind: str, rows: Sequence[PolicyRow], reference: PolicyRow) -> Record:
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


def _laps(rows: Sequence[PolicyRow]) -> float:
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


def facts(rows: Sequence[Record]) -> Record:
    """Return what the page shows."""
    rows = [
        {**row, "seconds": float(row["seconds"])}
        for task in FLOATS
        for row in rows
        if row["task"] == task
    ]
    return {
        "rows": [(row, share_over_trainings(row)) for row in rows],
        "name_of": name_of,
        "failed": failed,
        "worst_of_shipped": worst_of_shipped,
        "episodes": EPISODES,
        "first": FIRST_SEED,
        "missing": dict.fromkeys(row["task"] for row in rows if row["worst"] is None),
    }


EXPERIMENT = Experiment(
    name="clocks",
    columns=COLUMNS,
    texts=("task", "kind", "clock", "seconds", "each"),
    jobs=jobs,
    measure=measure,
    facts=facts,
)
main = EXPERIMENT.main
