"""Tables and verdicts of the gymnasium page."""

from collections.abc import Sequence

from spikedeploy.comparison.statistics import Estimate
from spikedeploy.experiments.csv_rows import Record
from spikedeploy.experiments.gymnasium.design import DENSE, RANDOM, RIVAL, SPARSE, TEACHER, TUNED
from spikedeploy.experiments.gymnasium.points import Reference, TaskPoint, judged, points, reference
from spikedeploy.experiments.gymnasium.records import ENERGY
from spikedeploy.experiments.gymnasium.tasks import RATE, TASKS
from spikedeploy.experiments.pareto.costs import spikes
from spikedeploy.experiments.pareto.tables import number, share
from spikedeploy.reports.columns import ABSENT
from spikedeploy.reports.markdown import markdown_text

LABELS = {
    TEACHER: "float teacher",
    DENSE: "dense PopSAN 256-256",
    SPARSE: "sparse, by imitation",
    TUNED: "sparse, with reward",
    RIVAL: "float MLP, pruned",
    RANDOM: "random actions",
}
ENOUGH, FEW = 0.95, 0.01  # of the teacher's return, and of the dense network's operations
_PICO = 1e12


def task_table(env: str, rows: Sequence[Record], chip: str) -> str:
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
    return markdown_text(lines)


def _line(point: TaskPoint, dense: Reference) -> list[str]:
    operations, joules = point.mean("operations"), point.mean(ENERGY)
    unit = "SOPs" if spikes(point.rows[0]) else "MACs"
    counted = ABSENT if operations is None else f"{operations:,.0f} {unit}"
    part = ABSENT if operations is None else f"{operations / dense.operations:.2%}"
    return [
        LABELS[point.role],
        point.place,
        f"{len(point.rows)}",
        _estimate(point.earned),
        ABSENT if point.role == RANDOM else share(point.of_teacher),
        f"{point.mean('terminated') or 0.0:.0%}",
        counted,
        part,
        number(None if joules is None else joules * _PICO),
    ]


def _estimate(value: Estimate) -> str:
    low, high = value.ci95
    return f"{value.mean:,.0f} [{low:,.0f}, {high:,.0f}]"


def verdict(env: str, rows: Sequence[Record], chip: str) -> str:
    """Whether a task is done on the chip at few operations; what is missing where nobody knows."""
    found = points(rows)
    point, dense = judged(found, chip), reference(env, found, chip)
    if point is None:
        return f"* – **{env}**: no spiking policy is evaluated on {chip} yet."
    operations, wanted = point.mean("operations") or 0.0, TASKS[env].wanted
    good = point.of_teacher.mean >= ENOUGH if wanted is None else point.earned.mean >= wanted
    few = operations <= FEW * dense.operations
    goal = f"{ENOUGH:.0%} of the teacher" if wanted is None else f"a return of {wanted:g}"
    return (
        f"* {'✓' if good and few else '✗'} **{env}**: {_estimate(point.earned)}, "
        f"{share(point.of_teacher)} of the teacher, with {operations:,.0f} SOPs a control step on "
        f"{chip}, {operations / dense.operations:.2%} of the PopSAN's {dense.operations:,.0f} "
        f"({_how(dense)}), {LABELS[point.role]}, {_seeds(point)}. "
        f"Asked for: {goal} at {FEW:.0%}{_lack(good, few)}."
    )


def _seeds(point: TaskPoint) -> str:
    return f"{len(point.rows)} training seed{'s' if len(point.rows) > 1 else ''}"


def _how(dense: Reference) -> str:
    return "measured" if dense.measured else f"computed for a rate of {RATE:g}"


def _lack(good: bool, few: bool) -> str:
    missed = [word for word, met in (("the return", good), ("the operations", few)) if not met]
    return f"; missed by {' and '.join(missed)}" if missed else ""


def size_table() -> str:
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
    return markdown_text(lines)
