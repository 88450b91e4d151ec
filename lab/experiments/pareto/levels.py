"""The tables of every level, the references below: score and activity; returns over trainings."""

from collections.abc import Callable, Sequence

from lab.experiments.pareto.fronts import (
    Point,
    Record,
    drives,
    earned,
    reference_row,
    score,
)
from lab.experiments.pareto.tables import number, of_teacher, share
from spikedeploy.comparison import statistics
from spikedeploy.comparison.statistics import Estimate
from spikedeploy.reports.table import ABSENT, markdown_text

_Cells = dict[str, Callable[[Point], str]]

_ACTIVITY: _Cells = {
    "operations": lambda p: number(p.mean("operations"), ",.1f"),
    "neurons": lambda p: number(p.mean("neurons")),
    "updates": lambda p: number(p.mean("neuron_updates"), ",.1f"),
    "of readouts": lambda p: number(p.mean("readout_updates"), ",.1f"),
    "events": lambda p: number(p.mean("events"), ",.1f"),
    "spikes": lambda p: number(p.mean("spikes_out"), ",.1f") if p.spiking else ABSENT,
    "sparsity": lambda p: number(p.mean("sparsity"), ".1%"),
    "saturations": lambda p: number(p.mean("saturations")),
}


def level_table(rows: Sequence[Record], found: Sequence[Point]) -> str:
    """Score and activity of every level."""
    cells = _cells(rows)
    lines = [["policy", *cells]]
    lines += [[p.label, *(cell(p) for cell in cells.values())] for p in found]
    for name in ("teacher", "reference"):
        if (row := reference_row(rows, name)) is not None:
            about = {f"% of {name}": "100.0%"} | _own_scores(row)
            own = [about.get(head, ABSENT) for head in cells]
            lines.append([f"{name}, {row.get('place')}", *own])
    return markdown_text(lines)


def _cells(rows: Sequence[Record]) -> _Cells:
    """Heads and cells: the score in the words of the task."""
    of_reference: _Cells = {"% of reference": lambda p: share(p.of_reference)}
    return {
        "aim": lambda p: f"{p.level:g}",
        "seeds": lambda p: f"{len(p.rows)}",
        "% of teacher": of_teacher,
        **(of_reference if reference_row(rows, "reference") else {}),
        **(_driving(rows) if any(map(drives, rows)) else _walking()),
        **_ACTIVITY,
    }


def _walking() -> _Cells:
    return {
        "return": lambda p: number(p.mean("return_mean")),
        "falls": lambda p: number(p.mean("falls"), ".1%"),
    }


def _driving(rows: Sequence[Record]) -> _Cells:
    teacher = (reference_row(rows) or {}).get("lap_time")

    def beside(point: Point) -> str:
        mine = point.mean("lap_time")
        return ABSENT if mine is None or teacher is None else f"{mine / teacher - 1:+.1%}"

    return {
        "finished": _finished,
        "lap [s]": lambda p: number(p.mean("lap_time"), ".3f"),
        "lap": beside,
    }


def _own_scores(row: Record) -> dict[str, str]:
    """Scores of a reference by the head of their column."""
    if not drives(row):
        return {"return": number(row["return_mean"]), "falls": number(row["falls"], ".1%")}
    finished = statistics.share(row["scores"]).mean
    return {"finished": f"{finished:.1%}", "lap [s]": number(row.get("lap_time"), ".3f")}


def _finished(point: Point) -> str:
    """Share of all episodes, with Wilson's interval: a bootstrap of successes alone has none."""
    found = statistics.share([score for row in point.rows for score in row["scores"]])
    return _between(found, ".1%")


def return_table(rows: Sequence[Record], found: Sequence[Point]) -> str:
    """Mean return, IQM and risk of every level, of karts the share of finishes before them."""
    racing = any(map(drives, rows))
    heads = ["policy", "aim", "training seeds", "episodes"]
    lines = [[*heads, *(["finished"] if racing else []), "return", "IQM", "risk"]]
    for p in found:
        counts = [f"{p.level:g}", f"{len(p.rows)}", f"{len(p.teacher)}"]
        lines.append([p.label, *counts, *_returns(p.rows, racing)])
    for name in ("teacher", "reference"):
        if (row := reference_row(rows, name)) is not None:
            counts = [ABSENT, ABSENT, f"{len(row['scores'])}"]
            lines.append([f"{name}, {row.get('place')}", *counts, *_returns([row], racing)])
    # older tables of karts have finishes alone
    filled = [k for k, cells in enumerate(zip(*lines[1:], strict=True)) if {*cells} != {ABSENT}]
    return markdown_text([[line[k] for k in filled] for line in lines])


def _returns(rows: Sequence[Record], racing: bool) -> list[str]:
    """Cells of rows on the same episodes, with intervals over trainings and episodes."""
    found = earned(rows)
    each = (found.mean, found.iqm, found.risk) if found else (None, None, None)
    form = ",.1f" if racing else ",.0f"  # karts earn tens, hexapods thousands
    return [*([_between(score(rows), ".1%")] if racing else []), *(_between(e, form) for e in each)]


def _between(found: Estimate | None, form: str) -> str:
    """`3,438 [3,430, 3,446]`; a dash where there is none."""
    return ABSENT if found is None else found.text(form)
