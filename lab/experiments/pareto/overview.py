"""The table over all tasks: of each student its cheapest level that is nearly as good."""

from collections.abc import Mapping, Sequence

from lab.experiments.pareto.costs import TOTALS
from lab.experiments.pareto.fronts import Point, Record, points
from lab.experiments.pareto.tables import NEARLY, number, of_teacher, pico, share
from spikedeploy.reports.table import markdown_text


def overview(tables: Mapping[str, Sequence[Record]]) -> str:
    """One row for each student of each environment, with the rows of its CSV."""
    heads = ["task", "policy", "aim", "seeds", "% of teacher", "% of reference", "operations"]
    heads += ["neurons", "sparsity", "operations alone [pJ]", "+ updates", "+ the rest"]
    lines = [heads]
    for env, rows in tables.items():
        lines += [[env, *_cells(point)] for point in cheapest(points(rows))]
    return markdown_text(lines)


def cheapest(found: Sequence[Point]) -> list[Point]:
    """Of each student, by imitation and with reward, the level with the fewest operations.

    Only levels with NEARLY of the teacher's score count; where none has it, the best one does.
    """
    groups: dict[tuple[str, bool], list[Point]] = {}
    for point in found:
        groups.setdefault((point.student, point.rewarded), []).append(point)
    return [_cheapest(group) for group in groups.values()]


def _cheapest(group: Sequence[Point]) -> Point:
    near = [point for point in group if point.of_teacher.mean >= NEARLY]
    if not near:
        return max(group, key=lambda point: point.of_teacher.mean)
    return min(near, key=lambda point: point.mean("operations") or 0.0)


def _cells(point: Point) -> list[str]:
    return [
        point.label,
        f"{point.level:g}",
        f"{len(point.rows)}",
        of_teacher(point),
        share(point.of_reference),
        number(point.mean("operations"), ",.1f"),
        number(point.mean("neurons")),
        number(point.mean("sparsity"), ".1%"),
        *(pico(point.energy(of)) for of in TOTALS),
    ]
