"""The page of the lineup experiment, results/lineup.md.

Every number is of results/lineup.csv, one row a training, and of the sparse policies' rows in
results/pareto. Rows of trainings that are not here are kept as they are in the table.
"""

import csv
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from spikedeploy import zoo
from spikedeploy.comparison.statistics import Estimate, nested_ratio, stratified
from spikedeploy.experiments.csv_rows import Record, read_rows, write_rows
from spikedeploy.experiments.lineup.design import LineupDesign, teachers
from spikedeploy.experiments.lineup.evaluation import all_rows, whole
from spikedeploy.experiments.pareto import records as pareto
from spikedeploy.pages.markdown import write_beside
from spikedeploy.reports.columns import ABSENT
from spikedeploy.reports.markdown import markdown_text
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.versions import own

_COLUMNS = (
    "env", "policy", "seed", "shipped", "kind", "chip", "episodes", "return_mean", "success_rate",
    "falls", "cot", "speed_rmse", "turn_rmse", "sops_per_inference", "macs_dense",
    "macs_effective", "quick", "versions", "returns", "successes",
)  # fmt: skip
_TEXT = ("env", "policy", "shipped", "kind", "chip", "quick", "versions")
_SPARSE = "sparse"
_INTRODUCTION = """\
A row of `spikedeploy compare` is one training. Here the shipped policies that imitate a float
teacher are trained again, by the recipes and settings of their cards, with other seeds; the shipped
file is one of the trainings. `popsan-256` is `popsan` with 256 neurons in each hidden layer instead
of 512, and not shipped. `sparse` has its trainings from [pareto.md](pareto.md): with reward,
at the last level of pruning, on loihi1; no success was recorded there. All play the same episodes,
on seeds from 10,000 on that no training and no choice of a checkpoint saw, in float, spiking
policies on loihi1.

Intervals of 95 % are of the stratified bootstrap over trainings and episodes (Agarwal et al. 2021),
of one training over episodes alone. IQM is the mean without the lowest and the highest quarter,
risk the mean of the worst 5 %. The teachers are one training each, whose chance no interval covers.
Of five trainings such intervals are narrow: that of five normal values holds their mean in 84 % of
cases, not 95. So a share just beside 100 % shows little. The shipped files of float policies are of
seed 0; `sparse` was chosen by validation, and went on with reward, which the others did not.
MACs are multiply-accumulates with an input that is not 0, SOPs synaptic operations, both of a
control step and without neuron updates and encoder."""


def write(design: LineupDesign, results: Path) -> list[Path]:
    """Write page and table of the complete rows; return the files, the page first."""
    table, page = results / "lineup.csv", results / "lineup.md"
    kept = check_kept(design, results)
    about = {"quick": "yes" if design.quick else ""}
    new = [row | {"shipped": "yes" if row["shipped"] else ""} | about for row in all_rows(design)]
    rows = _merged(new, kept)
    results.mkdir(parents=True, exist_ok=True)
    write_rows(rows, _COLUMNS, table)
    # as they stand in the table, so that the page can be written again from it
    shown = write_beside(page, text(design, read(table), results / "pareto"), {})
    return [page, table, shown[1]]


def check_kept(design: LineupDesign, results: Path) -> list[Record]:
    """The rows of the table so far; ConfigError where they cannot stand beside those of the design.

    That is where they have other episodes, another chip, or quick trainings.
    """
    table = results / "lineup.csv"
    kept = read(table) if table.is_file() else []
    for row in kept:
        alike = row["episodes"] == design.episodes and bool(row["quick"]) == design.quick
        if not alike or row["chip"] not in (None, design.chip):
            raise ConfigError(
                f"{table} has rows of {row['episodes']} episodes"
                f"{', of quick trainings' if row['quick'] else ''}"
                f"{', on ' + row['chip'] if row['chip'] else ''}: name another folder with -o"
            )
    return kept


def read(table: Path) -> list[Record]:
    """The rows of the table; ConfigError where it is damaged."""
    try:
        rows = read_rows(table, _TEXT)
        for row in rows:
            if tuple(row) != _COLUMNS or not whole(row):
                raise ValueError(f"a row of {row.get('policy')}")
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"{table} is damaged ({error}): put it back, or move it away") from error
    return rows


def _merged(new: Sequence[Record], old: Sequence[Record]) -> list[Record]:
    """The new rows, and the old ones of trainings that have no new one."""
    here = {_key(row) for row in new}
    rows = [*new, *(row for row in old if _key(row) not in here)]
    return sorted(rows, key=lambda row: (row["env"], _size(row), row["policy"], row["seed"]))


def _key(row: Record) -> tuple[str, str, int]:
    return row["env"], row["policy"], row["seed"]


def _size(row: Record) -> float:
    """Weights, by which policies are ordered; the same for all trainings of a policy."""
    return float(row.get("macs_dense") or 0)


def text(design: LineupDesign, rows: Sequence[Record], sparse: Path) -> str:
    """The page of the rows of the table.

    sparse  folder of the tables of the pareto experiment
    """
    parts = ["# The line-up over training seeds", f"    {_command()}", _missing(design, rows)]
    parts += [_INTRODUCTION]
    for env in dict.fromkeys(row["env"] for row in rows):
        file = sparse / f"{env}.csv"
        shown = [row for row in rows if row["env"] == env]
        shown += _sparse(env, file, design.episodes) if file.is_file() else []
        parts += [
            f"## {env}",
            teachers(env),
            _table(shown),
            "\n".join(f"- {line}" for line in _verdicts(shown)),
        ]
    begun = Counter(row["versions"] for row in rows).most_common()
    facts = [
        f"- spikedeploy {own()}",
        "- versions when a training began: "
        + "; ".join(f"{versions} ({count} trainings)" for versions, count in begun),
        "- every number: [lineup.csv](lineup.csv)",
    ]
    parts += ["## How this was made", "\n".join(facts)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _command() -> str:
    return shlex.join(["spikedeploy", *sys.argv[1:]])


def _missing(design: LineupDesign, rows: Sequence[Record]) -> str:
    """The trainings that have no row; empty where there are none."""
    there = {_key(row) for row in rows}
    lack = [m for m in design.members() if (m.env, m.policy, m.seed) not in there]
    if not lack:
        return ""
    found = [
        f"{env}: {', '.join(f'{name} {count}' for name, count in counts.items())}"
        for env in design.tasks
        if (counts := Counter(member.policy for member in lack if member.env == env))
    ]
    return f"**Trainings that are missing, or were not evaluated: {'; '.join(found)}.**"


def _sparse(env: str, table: Path, episodes: int) -> list[Record]:
    """The trainings of the sparse policy that went on with reward, at its last level."""
    tuned = [
        row
        for row in pareto.read(table)
        if (row["student"], row["trained_by"], row["place"]) == (_SPARSE, "reward", "loihi1")
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


def _table(rows: Sequence[Record]) -> str:
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
            policy, _operations(own), f"{len(own)}", _thousands(found.mean),
            _of(_returns(rows, policy), teacher), f"{shipped[0]:,.0f}" if shipped else ABSENT,
            f"{min(means):,.0f}", f"{max(means):,.0f}", _thousands(found.iqm),
            _thousands(found.risk), _success(own),
        ])  # fmt: skip
    return markdown_text(lines)


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
    counts = [row[field] for row in rows if row.get(field) is not None]
    return f"{np.mean(counts):,.0f} {'SOPs' if spiking else 'MACs'}" if counts else ABSENT


def _success(rows: Sequence[Record]) -> str:
    each = [row["successes"] for row in rows if row.get("successes")]
    return _percent(stratified(each, np.random.default_rng(0)).mean, 0) if each else ABSENT


def _thousands(found: Estimate) -> str:
    low, high = found.ci95
    return f"{found.mean:,.0f} [{low:,.0f}, {high:,.0f}]"


def _percent(found: Estimate, digits: int = 1) -> str:
    low, high = (f"{100 * bound:.{digits}f}" for bound in found.ci95)
    return f"{found.mean:.{digits}%} [{low}, {high}]"


def _verdicts(rows: Sequence[Record]) -> list[str]:
    """The smallest float policies that earn as much, and how lucky the shipped ones are."""
    controls = list(dict.fromkeys(row["policy"] for row in rows if row["kind"] == "control"))
    beside = {rival: _returns(rows, rival) for rival in ("sac", _SPARSE)}
    found = [_smallest(rows, controls, rival, own) for rival, own in beside.items() if own]
    return [*found, *_luck(rows, controls)] if controls else []


def _smallest(
    rows: Sequence[Record], controls: Sequence[str], rival: str, beside: list[list[float]]
) -> str:
    rng = np.random.default_rng
    shares = {policy: nested_ratio(_returns(rows, policy), beside, rng(0)) for policy in controls}
    equal = [policy for policy in controls if shares[policy].ci95[1] >= 1]
    if not equal:
        return f"All of these float policies are shown to earn less than `{rival}`."
    least = min(equal, key=lambda policy: _macs(rows, policy))
    return (
        f"The smallest of these float policies not shown to earn less than `{rival}` is {least}: "
        f"{_macs(rows, least):,.0f} MACs, {_percent(shares[least])} of its return."
    )


def _macs(rows: Sequence[Record], policy: str) -> float:
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
