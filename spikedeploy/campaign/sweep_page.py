"""The tables of a sweep: its cells, in a terminal and on a page, and every job as CSV."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spikedeploy.campaign.sweep_grid import SweepJob
from spikedeploy.comparison.episode_metrics import drives
from spikedeploy.comparison.statistics import FEWEST, bootstrap, paired_difference, share
from spikedeploy.comparison.summary import has_few_episodes
from spikedeploy.console import print_text
from spikedeploy.outputs import mark
from spikedeploy.reports.columns import (
    energy_cell,
    field_cell,
    format_difference,
    format_operations,
    format_return,
    format_success,
    measured_columns,
    quoted_table,
)
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.table import ABSENT, Cell, Column, Table, write_rows

Record = dict[str, Any]
PAGE, SHOWN, NUMBERS = "sweep.md", "sweep.html", "sweep.csv"
_PER_INFERENCE = ("spikes_per_inference", "sops_per_inference", "macs_dense")
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
    axes = _axes(rows)
    measured = [c for c in _measured_columns(rows) if c.title not in _ON_PAGES]

    def name(row: Record) -> str:
        return " · ".join(cell for axis in axes if (cell := axis.cell(row)) != ABSENT)

    if rows:
        lines = [[name(row), *(column.cell(row) for column in measured)] for row in rows]
        heads = [" · ".join(axis.title for axis in axes), *(c.title for c in measured)]
        Table(heads, lines, sweep.name, numbers=True).print()
        if remark := _on_few_episodes(rows):
            print_text(remark)


def write_sweep(sweep: Sweep, folder: Path) -> list[Path]:
    """Write the page and the CSV of what is there; return both."""
    table = quoted_table([each.row for each in sweep.found])
    lines = [_line(sweep, job, table) for job in sweep.jobs]
    numbers = write_rows(lines, list(lines[0]), folder / NUMBERS)
    page, shown = write_beside(folder / PAGE, "\n".join(_page(sweep)), {})
    return [page, numbers, shown]


def _page(sweep: Sweep) -> list[str]:
    rows = cells(sweep.found)
    columns = [*_axes(rows), *_measured_columns(rows)]
    lines = [f"# Sweep {sweep.name}", "", f"<!-- {mark('sweep')} -->", f"{sweep.summary}.", ""]
    if rows:
        lines += [Table.from_records(columns, rows).markdown(), ""]
        meanings = [f"{c.title}: {c.meaning}" for c in columns if c.meaning]
        remarks = filter(None, [*meanings, _on_few_episodes(rows)])
        lines += [*(f"* {remark}" for remark in remarks), ""]
    if sweep.failures:
        lines += ["## Failed", "", *(f"* {label}: {why}" for label, why in sweep.failures), ""]
    versions = {pair for job in sweep.jobs for pair in job.record["versions"].items()}
    said = sorted(f"{name} {version}" for name, version in versions if version)
    return [*lines, f"Computed with {', '.join(said)}; every job in [{NUMBERS}]({NUMBERS}).", ""]


def _on_few_episodes(rows: Sequence[Record]) -> str:
    """Return why some cells have no interval; empty where all have one."""
    if not any(map(has_few_episodes, rows)):
        return ""
    return (
        f"Cells of fewer than {FEWEST} episodes have no interval: it would hold the truth too "
        "seldom. `episodes` and `seed` of the grid set how many there are."
    )


def _axes(rows: Sequence[Record]) -> list[Column]:
    names = ("env", "policy", "chip", "disturb", "fault")
    axes = [Column(name, "", _plain(name)) for name in names]
    found = [axis for axis in axes if len({axis.cell(row) for row in rows}) > 1] or axes[1:2]
    if len({row["specimen"] for row in rows} - {None}) > 1:
        found.append(Column("specimen", "which faulty chip", _plain("specimen")))
    return found


def _measured_columns(rows: Sequence[Record]) -> list[Column]:
    bounds = "" if all(map(has_few_episodes, rows)) else ", with its 95% {}interval"
    resampled = bounds.format("bootstrap ")
    success = (
        Column("finished", f"episodes that reach the last gate{bounds.format('')}", format_success)
        if any(map(drives, rows))
        else Column("success", "episodes that succeed", field_cell("success_rate", ".0%"))
    )
    table = quoted_table(rows)
    columns = [
        Column("episodes", "", field_cell("episodes", ",d")),
        Column("return", f"mean of all episodes{resampled}", format_return),
        Column(
            "to undisturbed",
            "paired difference of return to the same seeds without disturbance and fault"
            f"{resampled}",
            _difference_cell,
        ),
        success,
        Column("operations", "a control step, of synapses", format_operations),
        Column("energy", f"a control step, of operations, by table {table}", energy_cell(table)),
        *measured_columns(rows),
    ]
    return [c for c in columns if any(c.cell(row) != ABSENT for row in rows)]


def _plain(name: str) -> Cell:
    return lambda row: ABSENT if row[name] in (None, "") else str(row[name])


def _difference_cell(row: Mapping[str, Any]) -> str:
    return ABSENT if row["difference_mean"] is None else format_difference(row)


def _line(sweep: Sweep, job: SweepJob, table: str) -> Record:
    row = sweep.rows.get(job.key, {})
    prices = row.get("energy_per_inference_j", {})
    return {
        "key": job.key,
        "env": job.env,
        "policy": job.entry.candidate.name,
        "kind": row.get("kind"),
        **_setup_fields(job),
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


def _setup_fields(job: SweepJob) -> Record:
    setup = job.entry.setup
    return {
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
    returns = [value for each in jobs for value in each.row["returns"]]
    successes = [value for each in jobs for value in each.row["successes"]]
    estimate, rate = bootstrap(returns, _rng()), share(successes) if successes else None
    pooled: Record = {
        "env": job.env,
        "policy": job.entry.candidate.name,
        "kind": first["kind"],
        **_setup_fields(job),
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
    }
    rows = [each.row for each in jobs]
    # means over inferences, of which each control step has one; of metrics over episodes
    steps = [sum(row["steps"]) for row in rows]
    pooled |= {name: _mean([row.get(name) for row in rows], steps) for name in _PER_INFERENCE}
    for name in ("energy_per_inference_j", "energy_interval_j"):
        tables = first[name]
        pooled[name] = {t: _price([row[name][t] for row in rows], steps) for t in tables}
    measured = [row.get("measured", {}) for row in rows]
    episodes = [each.job.episodes for each in jobs]
    means = {name: _mean([row.get(name) for row in measured], episodes) for name in measured[0]}
    pooled["measured"] = {name: mean for name, mean in means.items() if mean is not None}
    return pooled


def _price(values: Sequence[Any], weights: Sequence[int]) -> Any:  # noqa: ANN401
    """Return a mean, or the means of lower and of upper bounds, of which none bounds."""
    if isinstance(values[0], Sequence):
        return [_mean(bounds, weights) for bounds in zip(*values, strict=True)]
    return _mean(values, weights)


def _mean(values: Sequence[float | None], weights: Sequence[int]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.average(known, weights=weights)) if len(known) == len(values) else None


def _difference(jobs: Sequence[JobRow], groups: Mapping[str, Sequence[JobRow]]) -> Record:
    job = jobs[0].job
    beside = groups.get(job.undisturbed.cell, ())
    seeds = [[each.job.seed for each in many] for many in (jobs, beside)]
    if job.undisturbed == job or seeds[0] != seeds[1]:
        return {"difference_mean": None, "difference_ci95": None}
    left, right = ([v for each in many for v in each.row["returns"]] for many in (jobs, beside))
    found = paired_difference(left, right, _rng())
    return {"difference_mean": found.mean, "difference_ci95": found.ci95}


def _rng() -> np.random.Generator:
    """Return a generator with a fixed seed: equal episodes have one interval in any table."""
    return np.random.default_rng(0)
