"""What a sweep shows: a table of its cells, every job as CSV, and a page in Markdown and HTML."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.comparison.metrics import drives
from spikedeploy.outputs import mark
from spikedeploy.reports.columns import (
    energy_cell,
    format_difference,
    format_operations,
    format_return,
    format_success,
    measured_columns,
    quoted_table,
)
from spikedeploy.reports.csv_rows import write_rows
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.table import ABSENT, Column, Table, field_cell
from spikedeploy.sweeps.cells import JobRow, cells
from spikedeploy.sweeps.grid import SweepGrid
from spikedeploy.sweeps.specification import JobSpecification

Record = dict[str, Any]
PAGE, SHOWN, NUMBERS = "sweep.md", "sweep.html", "sweep.csv"
_COLUMNS = (
    "key", "env", "policy", "kind", "chip", "bits", "disturb", "fault", "specimen", "seed",
    "episodes", "status", "return_mean", "success_rate", "spikes_per_inference",
    "sops_per_inference", "macs_dense", "energy_table", "energy_per_inference_j", "returns",
    "successes", "steps", "measured", "reason",
)  # fmt: skip

_ON_PAGES = ("episodes", "energy")  # for which a terminal is too narrow


@dataclass(frozen=True)
class SweepState:
    """How far a sweep is.

    grid    what was asked for
    jobs    all of them
    rows    key -> row of each that is done
    failed  key -> why it failed
    """

    grid: SweepGrid
    jobs: Sequence[JobSpecification]
    rows: Mapping[str, Mapping[str, Any]]
    failed: Mapping[str, str]

    @property
    def summary(self) -> str:
        """`200 of 200 jobs are done, 0 failed`."""
        missing = len(self.jobs) - len(self.rows) - len(self.failed)
        left = f", {missing} are missing" if missing else ""
        return (
            f"{len(self.rows)} of {len(self.jobs)} jobs are done, {len(self.failed)} failed{left}"
        )

    @property
    def found(self) -> list[JobRow]:
        """The jobs that are done."""
        return [JobRow(job, self.rows[job.key]) for job in self.jobs if job.key in self.rows]

    @property
    def failures(self) -> list[tuple[str, str]]:
        """Label of each job that failed, and why."""
        return [(job.label, self.failed[job.key]) for job in self.jobs if job.key in self.failed]

    def as_json(self) -> dict[str, Any]:
        """Plain data: how many jobs are done, why some failed, and the cells."""
        return {
            "name": self.grid.name,
            "jobs": len(self.jobs),
            "done": len(self.rows),
            "failed": dict(self.failures),
            "cells": cells(self.found),
        }


def print_sweep(state: SweepState) -> None:
    """The table on stdout, the axes in one column."""
    rows = cells(state.found)
    axes = _axes(rows)
    measured = [c for c in _measured(rows) if c.title not in _ON_PAGES]

    def name(row: Record) -> str:
        return " · ".join(cell for axis in axes if (cell := axis.cell(row)) != ABSENT)

    if rows:
        lines = [[name(row), *(column.cell(row) for column in measured)] for row in rows]
        heads = [" · ".join(axis.title for axis in axes), *(c.title for c in measured)]
        Table(heads, lines, state.grid.name, numbers=True).print()


def write_sweep(state: SweepState, folder: Path) -> list[Path]:
    """Write the page and the CSV of what is there; return both."""
    table = quoted_table([each.row for each in state.found])
    numbers = write_rows(
        (_line(state, job, table) for job in state.jobs), _COLUMNS, folder / NUMBERS
    )
    page, shown = write_beside(folder / PAGE, "\n".join(_page(state)), {})
    return [page, numbers, shown]


def _page(state: SweepState) -> list[str]:
    rows = cells(state.found)
    columns = [*_axes(rows), *_measured(rows)]
    lines = [f"# Sweep {state.grid.name}", "", f"<!-- {mark('sweep')} -->", f"{state.summary}.", ""]
    if rows:
        lines += [Table.of(columns, rows).markdown(), ""]
        lines += [*(f"* {c.title}: {c.meaning}" for c in columns if c.meaning), ""]
    if state.failures:
        lines += ["## Failed", "", *(f"* {label}: {why}" for label, why in state.failures), ""]
    versions = {tuple(job.versions.items()) for job in state.jobs}
    said = sorted({f"{name} {version}" for each in versions for name, version in each if version})
    return [*lines, f"Computed with {', '.join(said)}; every job in [{NUMBERS}]({NUMBERS}).", ""]


def _axes(rows: Sequence[Record]) -> list[Column]:
    """The axes on which rows differ; the policy at least."""
    names = ("env", "policy", "chip", "disturb", "fault")
    axes = [Column(name, "", _plain(name)) for name in names]
    found = [axis for axis in axes if len({axis.cell(row) for row in rows}) > 1] or axes[1:2]
    if len({row["specimen"] for row in rows} - {None}) > 1:
        found.append(Column("specimen", "which faulty chip", _plain("specimen")))
    return found


def _measured(rows: Sequence[Record]) -> list[Column]:
    """What is measured, in columns that some row fills."""
    success = (
        Column(
            "finished", "episodes that reach the last gate, with the 95% interval", format_success
        )
        if any(map(drives, rows))
        else Column("success", "episodes that succeed", field_cell("success_rate", ".0%"))
    )
    table = quoted_table(rows)
    columns = [
        Column("episodes", "", field_cell("episodes", ",d")),
        Column("return", "mean of all episodes, with its 95% bootstrap interval", format_return),
        Column(
            "to undisturbed",
            "paired difference of return to the same seeds without disturbance and fault, with its "
            "95% bootstrap interval",
            _difference,
        ),
        success,
        Column("operations", "a control step, of synapses", format_operations),
        Column("energy", f"a control step, of operations, by table {table}", energy_cell(table)),
        *measured_columns(rows),
    ]
    return [c for c in columns if any(c.cell(row) != ABSENT for row in rows)]


def _plain(name: str) -> Any:  # noqa: ANN401 - a Cell
    return lambda row: ABSENT if row[name] in (None, "") else str(row[name])


def _difference(row: Mapping[str, Any]) -> str:
    return ABSENT if row["difference_mean"] is None else format_difference(row)


def _line(state: SweepState, job: JobSpecification, table: str) -> Record:
    """A job in the CSV."""
    row = state.rows.get(job.key, {})
    status = "done" if row else "failed" if job.key in state.failed else "missing"
    prices = row.get("energy_per_inference_j", {})
    return {
        "key": job.key,
        **{name: getattr(job, name) for name in ("env", "policy", "bits", "seed", "episodes")},
        "chip": job.chip,
        "kind": row.get("kind"),
        "disturb": " ".join(job.disturb),
        "fault": " ".join(job.fault),
        "specimen": job.specimen if job.fault else None,
        "status": status,
        **{n: row.get(n) for n in ("return_mean", "success_rate", "returns", "steps")},
        **{n: row.get(n) for n in ("spikes_per_inference", "sops_per_inference", "macs_dense")},
        "successes": [int(each) for each in row["successes"]] if row else None,
        "energy_table": table if table in prices else None,
        "energy_per_inference_j": prices.get(table),
        "measured": row.get("measured"),
        "reason": state.failed.get(job.key),
    }
