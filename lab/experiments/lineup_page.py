"""The page of the lineup experiment, results/lineup.md: each policy over its trainings.

Every number is of results/lineup.csv, one row a training, and of the sparse policies' rows in
results/pareto.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lab.experiments import pages
from lab.experiments.fronts import read_table as read_pareto
from lab.experiments.lineup import TABLE, LineupDesign, key, read_table, teachers
from lab.experiments.pages import mean
from lab.experiments.runner import command_line
from lab.experiments.training import Record
from spikedeploy import zoo
from spikedeploy.comparison.statistics import Estimate, nested_ratio, stratified
from spikedeploy.reports.table import ABSENT
from spikedeploy.trainers.versions import began_with, own

_SPARSE = "sparse-gated"


def write(design: LineupDesign, results: Path) -> list[Path]:
    """Write page and table of the complete rows; return the files, the page first."""
    table = results / TABLE
    design.write_table(table)
    # as they stand in the table, so that the page can be written again from it
    rows = read_table(table)
    page, shown = pages.write_page(
        results / "lineup.md",
        {},
        command=command_line(),
        quick=design.quick,
        missing=_missing(design, rows),
        tasks={
            env: _task(env, rows, results / "pareto" / f"{env}.csv", design.episodes)
            for env in dict.fromkeys(row["env"] for row in rows)
        },
        facts="\n".join([f"- spikedeploy {own()}", *began_with(row["versions"] for row in rows)]),
    )
    return [page, table, shown]


def _task(env: str, rows: Sequence[Record], sparse: Path, episodes: int) -> Record:
    """What the template shows of a task; sparse: the table of the pareto experiment."""
    shown = [row for row in rows if row["env"] == env]
    shown += sparse_rows(env, sparse, episodes) if sparse.is_file() else []
    return {
        "teachers": teachers(env),
        "table": table(shown),
        "verdicts": "\n".join(f"- {line}" for line in verdicts(shown)),
    }


def _missing(design: LineupDesign, rows: Sequence[Record]) -> str:
    """The trainings that have no row; empty where there are none."""
    there = {key(row) for row in rows}
    lack = [member for member in design.members() if member.key not in there]
    if not lack:
        return ""
    found = [
        f"{env}: {', '.join(f'{name} {count}' for name, count in counts.items())}"
        for env in design.tasks
        if (counts := Counter(member.policy for member in lack if member.env == env))
    ]
    return f"**Trainings that are missing, or were not evaluated: {'; '.join(found)}.**"


def sparse_rows(env: str, table: Path, episodes: int) -> list[Record]:
    """The trainings of the sparse policy that went on with reward, at its last level."""
    tuned = [
        row
        for row in read_pareto(table)
        if (row["student"], row["trained_by"], row["place"]) == ("sparse", "reward", "loihi1")
    ]
    last = min((row["level"] for row in tuned), default=0)
    shipped = zoo.card(f"{env}/{_SPARSE}").get("seed")
    return [
        {
            "policy": _SPARSE, "seed": row["seed"], "kind": "snn", "returns": row["scores"],
            "return_mean": row["return_mean"], "sops_per_inference": row["operations"],
            "shipped": row["seed"] == shipped,
        }
        for row in tuned
        if (row["level"], row["episodes"]) == (last, episodes)
    ]  # fmt: skip


def table(rows: Sequence[Record]) -> list[list[str]]:
    """A line for each policy, in the order of the rows."""
    teacher = _returns(rows, "sac")
    lines = [[
        "policy", "operations", "trainings", "return", "of `sac`", "shipped", "lowest", "highest",
        "IQM", "risk", "success",
    ]]  # fmt: skip
    for policy in dict.fromkeys(row["policy"] for row in rows):
        own = [row for row in rows if row["policy"] == policy]
        found = stratified([row["returns"] for row in own], np.random.default_rng(0))
        means = [row["return_mean"] for row in own]
        shipped = [row["return_mean"] for row in own if row.get("shipped")]
        lines.append([
            policy, _operations(own), f"{len(own)}", found.mean.text(",.0f"),
            _of(_returns(rows, policy), teacher), f"{shipped[0]:,.0f}" if shipped else ABSENT,
            f"{min(means):,.0f}", f"{max(means):,.0f}", found.iqm.text(",.0f"),
            found.risk.text(",.0f"), _success(own),
        ])  # fmt: skip
    return lines


def _of(returns: Sequence[Sequence[float]], teacher: Sequence[Sequence[float]]) -> str:
    """`104.2% [103.1, 105.3]` of the teacher; a dash for itself, and without it."""
    if not teacher or returns == teacher:
        return ABSENT
    return _percent(nested_ratio(returns, teacher, np.random.default_rng(0)))


def _returns(rows: Sequence[Record], policy: str) -> list[list[float]]:
    """Returns (S, n) of the trainings of a policy."""
    return [row["returns"] for row in rows if row["policy"] == policy]


def _operations(rows: Sequence[Record]) -> str:
    """Mean over the trainings, with its unit."""
    spiking = rows[0]["kind"] == "snn"
    field = "sops_per_inference" if spiking else "macs_effective"
    count = mean(rows, field)
    return ABSENT if count is None else f"{count:,.0f} {'SOPs' if spiking else 'MACs'}"


def _success(rows: Sequence[Record]) -> str:
    each = [row["successes"] for row in rows if row.get("successes")]
    return _percent(stratified(each, np.random.default_rng(0)).mean, 0) if each else ABSENT


def _percent(found: Estimate, digits: int = 1) -> str:
    low, high = (f"{100 * bound:.{digits}f}" for bound in found.ci95)
    return f"{found.mean:.{digits}%} [{low}, {high}]"


def verdicts(rows: Sequence[Record]) -> list[str]:
    """The smallest float policies that earn as much, and how lucky the shipped ones are."""
    controls = list(dict.fromkeys(row["policy"] for row in rows if row["kind"] == "control"))
    beside = {other: _returns(rows, other) for other in ("sac", _SPARSE)}
    found = [_smallest(rows, controls, other, own) for other, own in beside.items() if own]
    return [*found, *_luck(rows, controls)] if controls else []


def _smallest(
    rows: Sequence[Record], controls: Sequence[str], other: str, beside: list[list[float]]
) -> str:
    rng = np.random.default_rng
    shares = {policy: nested_ratio(_returns(rows, policy), beside, rng(0)) for policy in controls}
    equal = [policy for policy in controls if shares[policy].ci95[1] >= 1]
    if not equal:
        return f"All of these float policies are shown to earn less than `{other}`."
    least = min(equal, key=lambda policy: _macs(rows, policy))
    return (
        f"The smallest of these float policies not shown to earn less than `{other}` is {least}: "
        f"{_macs(rows, least):,.0f} MACs, {_percent(shares[least])} of its return."
    )


def _macs(rows: Sequence[Record], policy: str) -> float:
    """Mean over the trainings of a float policy."""
    return float(np.mean([row["macs_effective"] for row in rows if row["policy"] == policy]))


def _luck(rows: Sequence[Record], controls: Sequence[str]) -> list[str]:
    """How many shipped trainings earn more than the mean of all of their policy."""
    above = []
    for policy in controls:
        own = [row for row in rows if row["policy"] == policy]
        shipped = [row["return_mean"] for row in own if row.get("shipped")]
        if shipped and len(own) > 1:
            above.append(shipped[0] > np.mean([row["return_mean"] for row in own]))
    if not above:
        return []
    return [
        f"{sum(above)} of {len(above)} shipped float policies earn more than the mean of their "
        "trainings."
    ]
