"""Jobs that differ in their seeds alone, pooled into one row with its interval."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spikedeploy.comparison.metrics import drives
from spikedeploy.comparison.statistics import bootstrap, paired_difference, share
from spikedeploy.sweeps.specification import JobSpecification

Record = dict[str, Any]
# means over inferences, of whole rows and of each energy table
_PER_INFERENCE = ("spikes_per_inference", "sops_per_inference", "macs_dense")


@dataclass(frozen=True)
class JobRow:
    """A job and its row, as a report has it."""

    of: JobSpecification
    row: Mapping[str, Any]


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
    pooled = {
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
        "measured": _asked(jobs),
        **({"gates": first["gates"]} if drives(first) else {}),  # so that tables speak of karts
    }
    return pooled | _costs(jobs)


def _costs(jobs: Sequence[JobRow]) -> Record:
    """Means over all inferences of the jobs, of which each control step has one."""
    steps = [sum(each.row["steps"]) for each in jobs]
    rows = [each.row for each in jobs]
    found: Record = {name: _mean([row.get(name) for row in rows], steps) for name in _PER_INFERENCE}
    for field in ("energy_per_inference_j", "energy_interval_j"):
        found[field] = {
            table: _price([row[field][table] for row in rows], steps) for table in rows[0][field]
        }
    return found


def _price(values: Sequence[Any], weights: Sequence[int]) -> Any:  # noqa: ANN401
    """A mean, or the means of lower and of upper bounds, of which none bounds."""
    if isinstance(values[0], Sequence):
        return [_mean(bounds, weights) for bounds in zip(*values, strict=True)]
    return _mean(values, weights)


def _asked(jobs: Sequence[JobRow]) -> dict[str, float]:
    """Means over episodes of the metrics that were asked for."""
    weights = [each.of.episodes for each in jobs]
    rows = [each.row.get("measured", {}) for each in jobs]
    found = {name: _mean([row.get(name) for row in rows], weights) for name in rows[0]}
    return {name: value for name, value in found.items() if value is not None}


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
