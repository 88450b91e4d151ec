"""The tables of a sweep: its cells, in a terminal and on a page, and every job as CSV."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.campaign.sweep_grid import JobSpecification, SweepGrid
from spikedeploy.comparison.episode_metrics import drives
from spikedeploy.comparison.statistics import FEWEST, bootstrap, paired_difference, share
from spikedeploy.comparison.summary import has_few_episodes
from spikedeploy.console import print_text
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
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.table import ABSENT, Column, Table, field_cell, write_rows

Record = dict[str, Any]
PAGE, SHOWN, NUMBERS = "sweep.md", "sweep.html", "sweep.csv"
_PER_INFERENCE = ("spikes_per_inference", "sops_per_inference", "macs_dense")
_ON_PAGES = ("episodes", "energy")  # for which a terminal is too narrow


@dataclass(frozen=True)
class JobRow:
    """A job and its row, as a report has it."""

    of: JobSpecification
    row: Mapping[str, Any]


@dataclass
class Sweep:
    """A sweep and the results so far.

    grid    what was asked for
    jobs    all of them
    rows    key -> row of each that is done
    failed  key -> why it failed
    ran     number of jobs that were run now
    interrupted  whether it was stopped from outside
    files   page and CSV
    """

    grid: SweepGrid
    jobs: Sequence[JobSpecification]
    rows: dict[str, Record] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    ran: int = 0
    interrupted: bool = False
    files: list[Path] = field(default_factory=list)

    def add(self, job: JobSpecification, row: Record | None, failed: str) -> None:
        """Add the result of a job: its row, or why it failed."""
        if row is None:
            self.failed[job.key] = failed
        else:
            self.failed.pop(job.key, None)
            self.rows[job.key] = row

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


def print_sweep(sweep: Sweep) -> None:
    """The table on stdout, the axes in one column."""
    rows = cells(sweep.found)
    axes = _axes(rows)
    measured = [c for c in _measured_columns(rows) if c.title not in _ON_PAGES]

    def name(row: Record) -> str:
        return " · ".join(cell for axis in axes if (cell := axis.cell(row)) != ABSENT)

    if rows:
        lines = [[name(row), *(column.cell(row) for column in measured)] for row in rows]
        heads = [" · ".join(axis.title for axis in axes), *(c.title for c in measured)]
        Table(heads, lines, sweep.grid.name, numbers=True).print()
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
    lines = [f"# Sweep {sweep.grid.name}", "", f"<!-- {mark('sweep')} -->", f"{sweep.summary}.", ""]
    if rows:
        lines += [Table.from_records(columns, rows).markdown(), ""]
        meanings = [f"{c.title}: {c.meaning}" for c in columns if c.meaning]
        remarks = filter(None, [*meanings, _on_few_episodes(rows)])
        lines += [*(f"* {remark}" for remark in remarks), ""]
    if sweep.failures:
        lines += ["## Failed", "", *(f"* {label}: {why}" for label, why in sweep.failures), ""]
    versions = {tuple(job.versions.items()) for job in sweep.jobs}
    said = sorted({f"{name} {version}" for each in versions for name, version in each if version})
    return [*lines, f"Computed with {', '.join(said)}; every job in [{NUMBERS}]({NUMBERS}).", ""]


def _on_few_episodes(rows: Sequence[Record]) -> str:
    """Why some cells have no interval; empty where all have one."""
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


def _plain(name: str) -> Any:  # noqa: ANN401 - a Cell
    return lambda row: ABSENT if row[name] in (None, "") else str(row[name])


def _difference_cell(row: Mapping[str, Any]) -> str:
    return ABSENT if row["difference_mean"] is None else format_difference(row)


def _line(sweep: Sweep, job: JobSpecification, table: str) -> Record:
    row = sweep.rows.get(job.key, {})
    prices = row.get("energy_per_inference_j", {})
    return {
        "key": job.key,
        "env": job.env,
        "policy": job.policy,
        "kind": row.get("kind"),
        "chip": job.chip,
        "bits": job.bits,
        "disturb": " ".join(job.disturb),
        "fault": " ".join(job.fault),
        "specimen": job.specimen if job.fault else None,
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


def cells(found: Iterable[JobRow]) -> list[Record]:
    """A row for each cell of the grid, over the seeds that are there, in the order of the jobs.

    `difference_mean`, `difference_ci95` are to the cell without disturbance and fault, paired by
    seed, where that has the same seeds.
    """
    groups: dict[str, list[JobRow]] = {}
    for each in found:
        groups.setdefault(each.of.cell, []).append(each)
    return [_pooled(jobs) | _difference(jobs, groups) for jobs in groups.values()]


def _pooled(jobs: Sequence[JobRow]) -> Record:
    of, first = jobs[0].of, jobs[0].row
    returns = [value for each in jobs for value in each.row["returns"]]
    successes = [value for each in jobs for value in each.row["successes"]]
    estimate, rate = bootstrap(returns, _rng()), share(successes) if successes else None
    pooled: Record = {
        "env": of.env,
        "policy": of.policy,
        "kind": first["kind"],
        "chip": of.place,
        "disturb": " ".join(of.disturb),
        "fault": " ".join(of.fault),
        "specimen": of.specimen if of.fault else None,
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
    episodes = [each.of.episodes for each in jobs]
    means = {name: _mean([row.get(name) for row in measured], episodes) for name in measured[0]}
    pooled["measured"] = {name: mean for name, mean in means.items() if mean is not None}
    return pooled


def _price(values: Sequence[Any], weights: Sequence[int]) -> Any:  # noqa: ANN401
    """A mean, or the means of lower and of upper bounds, of which none bounds."""
    if isinstance(values[0], Sequence):
        return [_mean(bounds, weights) for bounds in zip(*values, strict=True)]
    return _mean(values, weights)


def _mean(values: Sequence[float | None], weights: Sequence[int]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.average(known, weights=weights)) if len(known) == len(values) else None


def _difference(jobs: Sequence[JobRow], groups: Mapping[str, Sequence[JobRow]]) -> Record:
    of = jobs[0].of
    calm = replace(of, disturb=(), fault=(), specimen=0)
    beside = groups.get(calm.cell, ())
    if calm == of or [each.of.seed for each in beside] != [each.of.seed for each in jobs]:
        return {"difference_mean": None, "difference_ci95": None}
    left, right = ([v for each in many for v in each.row["returns"]] for many in (jobs, beside))
    found = paired_difference(left, right, _rng())
    return {"difference_mean": found.mean, "difference_ci95": found.ci95}


def _rng() -> np.random.Generator:
    """A generator with a fixed seed: the same episodes give the same interval in any table."""
    return np.random.default_rng(0)
