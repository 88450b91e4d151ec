"""Returns of sparse policies by each clock of loihi1, and those trained through a pipeline.

    python -m lab clocks -o results [--episodes 100] [TASK …]

Rows are the shipped `sparse-gated`, trained for a gated clock, which Loihi has not, run gated and
free, and the policies of OUTPUT/clocks/TASK-sSEED.nir, trained by `train TASK-sparse --seed SEED`
(or, TASK-tuned-sSEED.nir, by `train TASK-sparse-tuned` after it), pipelined. Episodes are the same
for all, from seed 80,000 on, which no training, validation or choice of a checkpoint has seen;
which policy of a training is taken was decided by its validation. Writes OUTPUT/clocks.csv and
OUTPUT/clocks.md; tasks that are not named keep their rows.
"""

import argparse
import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from lab.experiments.pages import render
from lab.experiments.ratios import nested_ratio
from spikedeploy.comparison.comparison import Row
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.comparison.lineup import Entry
from spikedeploy.comparison.statistics import stratified
from spikedeploy.files import replacing, write_text
from spikedeploy.policies import costs
from spikedeploy.policies.registry import find

FIRST_SEED = 80_000
# what each task's returns are shares of: the float policy that earns its README's 100 %
REFERENCES = {
    "hexapod": "sac",
    "hexapod-command": "sac",
    "kart-grid": "ann",
    "kart-gazebo": "ann",
    "kart-steer": "ann",
}
# small float policies that are shipped, beside the spiking ones
BASELINES = {
    "hexapod": ("linear", "mlp-8"),
    "hexapod-command": ("fourier", "mlp-16", "mlp-32"),
    "kart-grid": ("linear", "small"),
    "kart-gazebo": ("linear", "small"),
    "kart-steer": ("linear", "small"),
}
KINDS = {
    "gated": "sparse-gated",
    "free": "sparse-gated",
    "pipelined": "trained pipelined",
    "pipelined, with reward": "trained pipelined, then with reward",
}


@dataclass(frozen=True)
class Result:
    """A kind of policy in a clock, over all of its trainings.

    share: of the reference's return in the same episodes, and its 95 % interval over trainings and
        episodes.
    seconds: mean duration of a lap over that of the reference's; NaN of walkers.
    clock: nothing of a float policy.
    sops, updates, macs: of a control step; MACs with an input that is not 0, as `sops` have.
    """

    task: str
    kind: str
    clock: str
    trainings: int
    episodes: int
    mean: float
    low: float
    high: float
    share: float
    share_low: float
    share_high: float
    succeeded: float
    seconds: float
    sops: float
    updates: float
    macs: float
    each: str

    @property
    def name(self) -> str:
        """Name of its row: `hexapod/mlp-8`, `hexapod/sparse-gated, free`."""
        if self.kind.startswith("trained"):
            return f"{self.task}, {self.kind}"
        clock = self.clock.removesuffix(", assumed") if self.clock else ""
        return f"{self.task}/{self.kind}" + (f", {clock}" if clock else "")


def results(task: str, folder: Path, episodes: int) -> Iterator[Result]:
    """The rows of a task."""
    shipped = f"{task}/sparse-gated"
    floats = [Entry(find(f"{task}/{name}")) for name in (REFERENCES[task], *BASELINES[task])]
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
    seeds = range(FIRST_SEED, FIRST_SEED + episodes)
    played = compare_policies(task, entries, seeds)
    beside = played.row(reference)
    if beside is None:
        raise ValueError(f"{task}: the reference was not played")
    for kind, group in groups.items():
        rows = [row for entry in group if (row := played.row(entry))]
        if rows:
            yield _result(task, kind, rows, beside)


def _result(task: str, kind: str, rows: Sequence[Row], reference: Row) -> Result:
    returns = np.array([row.returns for row in rows])
    found = [costs.mean([e.costs for e in r.episodes], [e.steps for e in r.episodes]) for r in rows]
    earned = stratified(returns, np.random.default_rng(0)).mean
    of = nested_ratio(returns, np.array(reference.returns))
    clocks = {each.clock for each in found}
    if len(clocks) != 1:
        raise ValueError(f"{task}, {kind}: the policies run by clocks {sorted(map(str, clocks))}")
    return Result(
        task=task,
        kind=KINDS.get(kind, kind),
        clock=clocks.pop() or "",
        trainings=len(rows),
        episodes=returns.shape[1],
        mean=earned.mean,
        low=earned.ci95[0],
        high=earned.ci95[1],
        share=of.mean,
        share_low=of.ci95[0],
        share_high=of.ci95[1],
        succeeded=float(np.mean([row.successes for row in rows])),
        seconds=_laps(rows) / _laps([reference]),
        sops=float(np.mean([each.sops or 0 for each in found])),
        updates=float(np.mean([each.neuron_updates or 0 for each in found])),
        macs=float(np.mean([each.effective_macs or 0 for each in found])),
        each=" ".join(f"{mean:.4g}" for mean in returns.mean(axis=1)),
    )


def _laps(rows: Sequence[Row]) -> float:
    """Mean lap time [s] of the episodes that finished; NaN where none has one."""
    laps = [e.metrics["lap_time"] for row in rows for e in row.episodes if "lap_time" in e.metrics]
    return float(np.mean(laps)) if laps else float("nan")


def page(found: Iterable[Result], episodes: int) -> str:
    """The table in Markdown, with what it says of each row."""
    heads = (
        "policy", "clock on loihi1", "trainings", "return", "of reference", "succeeded",
        "lap", "SOPs", "neuron updates", "MACs",
    )  # fmt: skip
    rows = [
        (
            r.name,
            r.clock or "–",
            str(r.trainings),
            f"{r.mean:,.4g} [{r.low:,.4g}, {r.high:,.4g}]",
            f"{r.share:.1%} [{r.share_low:.1%}, {r.share_high:.1%}]",
            f"{r.succeeded:.1%}",
            "–" if np.isnan(r.seconds) else f"{r.seconds:.3f}",
            f"{r.sops:.1f}" if r.clock else "–",
            f"{r.updates:.1f}" if r.clock else "–",
            "–" if r.clock else f"{r.macs:,.0f}",
        )
        for r in found
    ]
    return render("clocks", rows=[heads, *rows], episodes=episodes, first=FIRST_SEED)


def read(path: Path) -> list[Result]:
    """The rows of an earlier run."""
    if not path.is_file():
        return []
    kinds = {name: each.type for name, each in Result.__dataclass_fields__.items()}
    texts = [name for name, kind in kinds.items() if kind is str]
    found = csv.DictReader(path.read_text("utf-8").splitlines())
    return [
        Result(**{n: v if n in texts else kinds[n](v) for n, v in row.items()})  # type: ignore[operator]
        for row in found
    ]


def main() -> None:
    """Play the tasks that are named, and write the table of all."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=", ".join(REFERENCES))
    parser.add_argument("-o", "--output", type=Path, default=Path("results"))
    parser.add_argument("--episodes", type=int, default=100)
    given = parser.parse_args()
    if unknown := set(given.tasks) - REFERENCES.keys():
        parser.error(f"unknown: {', '.join(sorted(unknown))}. Choose of {', '.join(REFERENCES)}.")
    path = given.output / "clocks.csv"
    before = [r for r in read(path) if given.tasks and r.task not in given.tasks]
    if other := {row.episodes for row in before} - {given.episodes}:
        parser.error(
            f"{path}: rows that stay are of {min(other)} episodes: --episodes {min(other)}"
        )
    played = [
        row
        for task in given.tasks or REFERENCES
        for row in results(task, given.output / "clocks", given.episodes)
    ]
    order = list(REFERENCES)
    found = sorted([*before, *played], key=lambda row: order.index(row.task))
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(Result.__dataclass_fields__), lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(row) for row in found)
    write_text(given.output / "clocks.md", page(found, given.episodes))
    print(given.output / "clocks.md")
