"""Tables and verdicts of the gymnasium page."""

from collections.abc import Sequence

from lab.experiments.gymnasium.design import DENSE, MLP, RANDOM, SPARSE, TEACHER, TUNED
from lab.experiments.gymnasium.points import Reference, TaskPoint, judged, points, reference
from lab.experiments.gymnasium.records import ENERGY
from lab.experiments.gymnasium.tasks import RATE, TASKS
from lab.experiments.pareto.costs import spikes
from lab.experiments.pareto.tables import number, share
from spikedeploy.reports.csv_rows import Record
from spikedeploy.reports.table import ABSENT, markdown_text

LABELS = {
    TEACHER: "float teacher",
    DENSE: "dense PopSAN 256-256",
    SPARSE: "sparse, by imitation",
    TUNED: "sparse, with reward",
    MLP: "float MLP, pruned",
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
        point.earned.text(",.0f"),
        ABSENT if point.role == RANDOM else share(point.of_teacher),
        f"{point.mean('terminated') or 0.0:.0%}",
        counted,
        part,
        number(None if joules is None else joules * _PICO),
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
