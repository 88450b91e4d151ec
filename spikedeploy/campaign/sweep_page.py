"""The tables of a sweep: its cells, in a terminal and on a page, and every job as CSV."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spikedeploy.campaign.sweep_grid import SweepJob
from spikedeploy.comparison.statistics import FEWEST, bootstrap, paired_difference, share
from spikedeploy.console import print_text
from spikedeploy.policies.costs import weighted_mean
from spikedeploy.reports.columns import (
    earned_columns,
    field_cell,
    has_few_episodes,
    measured_columns,
    paid_columns,
    quoted_table,
)
from spikedeploy.reports.columns import format_difference as difference_cell
from spikedeploy.reports.page import provenance, render, write_page
from spikedeploy.reports.table import ABSENT, Cell, Column, Table, write_rows

Record = dict[str, Any]
NUMBERS = "sweep.csv"
_PER_INFERENCE = ("spikes_per_inference", "sops_per_inference", "macs_dense")
_PRICES = ("energy_per_inference_j", "energy_interval_j")
_ON_PAGES = ("episodes", "energy")  # for which a terminal is too narrow


class JobRow(NamedTuple):
    """A job that is done, and its row, as a report has it."""

    job: SweepJob
    row: Mapping[str, Any]


@dataclass
class Sweep:
    """A sweep and the results so far.

    name: of its grid
    jobs: all of them
    rows: key -> row of each that is done
    failed: key -> why it failed
    ran: number of jobs that were run now
    interrupted: whether it was stopped from outside
    files: page and CSV
    """

    name: str
    jobs: Sequence[SweepJob]
    rows: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    ran: int = 0
    interrupted: bool = False
    files: list[Path] = field(default_factory=list)

    def add(self, job: SweepJob, row: Mapping[str, Any] | None, failed: str) -> None:
        """Add the result of a job: its row, or why it failed."""
        if row is None:
            self.failed[job.key] = failed
        else:
            self.failed.pop(job.key, None)
            self.rows[job.key] = row

    @property
    def summary(self) -> str:
        """`200 of 200 jobs are done, 0 failed`."""
        done, failed = len(self.rows), len(self.failed)
        missing = len(self.jobs) - done - failed
        left = f", {missing} are missing" if missing else ""
        return f"{done} of {len(self.jobs)} jobs are done, {failed} failed{left}"

    @property
    def found(self) -> list[JobRow]:
        """The jobs that are done."""
        return [JobRow(job, self.rows[job.key]) for job in self.jobs if job.key in self.rows]

    @property
    def failures(self) -> list[tuple[str, str]]:
        """Label of each job that failed, and why."""
        return [(job.label, self.failed[job.key]) for job in self.jobs if job.key in self.failed]

    def as_json(self) -> dict[str, Any]:
        """Return plain data: how many jobs are done, why some failed, and the cells."""
        return {
            "name": self.name,
            "jobs": len(self.jobs),
            "done": len(self.rows),
            "failed": dict(self.failures),
            "cells": cells(self.found),
        }


def print_sweep(sweep: Sweep) -> None:
    """Print the table, the axes in one column."""
    rows = cells(sweep.found)
    if not rows:
        return
    axes = _axes(rows)

    def name(row: Mapping[str, Any]) -> str:
        return " · ".join(cell for axis in axes if (cell := axis.cell(row)) != ABSENT)

    measured = [column for column in _measured(rows) if column.title not in _ON_PAGES]
    columns = [Column(" · ".join(axis.title for axis in axes), "", name), *measured]
    Table.from_records(columns, rows, sweep.name).print()
    for remark in _remarks(rows):
        print_text(remark)


def write_sweep(sweep: Sweep, folder: Path) -> list[Path]:
    """Write the page and the CSV of what is there; return the page first."""
    table = quoted_table([each.row for each in sweep.found])
    lines = [_line(sweep, job, table) for job in sweep.jobs]
    numbers = write_rows(lines, list(lines[0]), folder / NUMBERS)
    return [*write_page("sweep", sweep_page(sweep), sweep.as_json(), folder), numbers]


def sweep_page(sweep: Sweep) -> str:
    """The page as one file."""
    rows = cells(sweep.found)
    columns = [*_axes(rows), *_measured(rows)] if rows else []
    meanings = [f"{c.title}: {c.meaning}" for c in columns if c.meaning]
    tables = [Table.from_records(columns, rows)] if rows else []
    if sweep.failures:
        tables.append(Table(("job", "why"), sweep.failures, "Failed"))
    versions = {pair for job in sweep.jobs for pair in job.record["versions"].items()}
    said = ", ".join(sorted(f"{name} {version}" for name, version in versions if version))
    return render(
        "campaign",
        title=f"Sweep {sweep.name}",
        lead=f"{sweep.summary}.",
        paragraphs=(),
        commands=(),
        drawings=(),
        tables=tables,
        remarks=[*meanings, *_remarks(rows)],
        made=[("jobs", NUMBERS), ("computed with", said), *provenance()],
    )


def _remarks(rows: Sequence[Record]) -> list[str]:
    """Return why some cells have no interval, where some have none."""
    if not any(map(has_few_episodes, rows)):
        return []
    return [
        f"Cells of fewer than {FEWEST} episodes have no interval: it would hold the truth too "
        "seldom. episodes and seed of the grid set how many there are."
    ]


def _axes(rows: Sequence[Record]) -> list[Column]:
    """Return columns for the axes of which there are several values, or for the policy."""
    axes = [Column(n, "", _axis_cell(n)) for n in ("env", "policy", "chip", "disturb", "fault")]
    found = [axis for axis in axes if len({axis.cell(row) for row in rows}) > 1] or axes[1:2]
    if len({row["specimen"] for row in rows} - {None}) > 1:
        found.append(Column("specimen", "which faulty chip", _axis_cell("specimen")))
    return found


def _axis_cell(name: str) -> Cell:
    return lambda row: ABSENT if row[name] in (None, "") else str(row[name])


def _measured(rows: Sequence[Record]) -> list[Column]:
    earned, success = earned_columns(rows)
    meaning = "of return, paired by seed, to the cell without disturbance and fault"
    columns = [
        Column("episodes", "", field_cell("episodes", ",d")),
        earned,
        Column("to undisturbed", meaning, difference_cell),
        success,
        *paid_columns(rows),
        *measured_columns(rows),
    ]
    return [c for c in columns if any(c.cell(row) != ABSENT for row in rows)]


def _line(sweep: Sweep, job: SweepJob, table: str) -> Record:
    row = sweep.rows.get(job.key, {})
    prices = row.get("energy_per_inference_j", {})
    return {
        "key": job.key,
        **_fields(job, row),
        "seed": job.seed,
        "episodes": job.episodes,
        "status": "done" if row else "failed" if job.key in sweep.failed else "missing",
        **{name: row.get(name) for name in ("return_mean", "success_rate", *_PER_INFERENCE)},
        "energy_table": table if table in prices else None,
        "energy_per_inference_j": prices.get(table),
        "returns": row.get("returns"),
        "successes": [int(each) for each in row["successes"]] if row else None,
        "steps": row.get("steps"),
        "measured": row.get("measured"),
        "reason": sweep.failed.get(job.key),
    }


def _fields(job: SweepJob, row: Mapping[str, Any]) -> Record:
    """Return what a line and a cell say of their job."""
    setup = job.entry.setup
    return {
        "env": job.env,
        "policy": job.entry.candidate.name,
        "kind": row.get("kind"),
        "chip": job.entry.chip,
        "disturb": " ".join(setup.disturb),
        "fault": " ".join(setup.fault),
        "specimen": setup.specimen if setup.fault else None,
    }


def cells(found: Iterable[JobRow]) -> list[Record]:
    """Return a row for each cell of the grid, over the seeds that are there, in the jobs' order.

    `difference_mean`, `difference_ci95` are to the cell without disturbance and fault, paired by
    seed, where that has the same seeds.
    """
    groups: dict[str, list[JobRow]] = {}
    for each in found:
        groups.setdefault(each.job.cell, []).append(each)
    return [_pooled(jobs) | _difference(jobs, groups) for jobs in groups.values()]


def _pooled(jobs: Sequence[JobRow]) -> Record:
    job, first = jobs[0]
    rows = [each.row for each in jobs]
    returns, successes = _values(jobs, "returns"), _values(jobs, "successes")
    estimate, rate = bootstrap(returns, _rng()), share(successes) if successes else None
    # means over inferences, of which each control step has one; of metrics over episodes
    steps, episodes = [sum(row["steps"]) for row in rows], [each.job.episodes for each in jobs]
    names = (*_PER_INFERENCE, *_PRICES)
    return {
        **_fields(job, first),
        "limits": first["limits"],
        "jobs": len(jobs),
        "episodes": len(returns),
        "return_mean": estimate.mean,
        "return_ci95": estimate.ci95,
        "success_rate": rate.mean if rate else None,
        "success_ci95": rate.ci95 if rate else None,
        "foreign": first.get("foreign", False),
        # so that tables speak of karts
        **({"gates": first["gates"]} if "gates" in first else {}),
        **{name: weighted_mean([row.get(name) for row in rows], steps) for name in names},
        "measured": weighted_mean([row.get("measured", {}) for row in rows], episodes),
    }


def _values(jobs: Sequence[JobRow], name: str) -> list[Any]:
    """Return a number of each episode of all jobs."""
    return [value for each in jobs for value in each.row[name]]


def _difference(jobs: Sequence[JobRow], groups: Mapping[str, Sequence[JobRow]]) -> Record:
    job = jobs[0].job
    beside = groups.get(job.undisturbed.cell, ())
    seeds = [[each.job.seed for each in many] for many in (jobs, beside)]
    if job.undisturbed == job or seeds[0] != seeds[1]:
        return {"difference_mean": None, "difference_ci95": None}
    found = paired_difference(_values(jobs, "returns"), _values(beside, "returns"), _rng())
    return {"difference_mean": found.mean, "difference_ci95": found.ci95}


def _rng() -> np.random.Generator:
    """Return a generator with a fixed seed: equal episodes have one interval in any table."""
    return np.random.default_rng(0)
