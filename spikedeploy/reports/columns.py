"""The columns of a comparison: its tables, its table of 80 columns, one row in one line.

Most columns are fields of `Performance`, `ReferenceAgreement` and `Costs`, which say their title,
meaning and format; `comparison.episode_metrics` has those of episodes.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from spikedeploy.comparison.comparison import Performance, ReferenceAgreement
from spikedeploy.comparison.episode_metrics import drives, metrics_of
from spikedeploy.comparison.statistics import FEWEST
from spikedeploy.policies.costs import Costs, report_fields
from spikedeploy.reports.table import (
    ABSENT,
    COMMON_TABLE,
    Cell,
    Column,
    Row,
    Table,
    escape_markdown,
    format_si,
    price_cell,
)
from spikedeploy.runtime.chips.chip import CHIPS
from spikedeploy.runtime.metrics.energy_tables import STATIC

COST = "What does an inference cost?"
WIDTH = 80  # of the short table
_STAMP = re.compile(r"-\d{8}-\d{6}(-\d+)?$")  # when a training began, at the end of its run's name


def label(row: Row) -> str:
    """The name of a row: `popsan · loihi1`."""
    if not row["chip"]:
        return str(row["policy"])
    return f"{row['policy']} · {row['chip']}{'' if row.get('limits', True) else ', limits off'}"


def has_few_episodes(row: Row) -> bool:
    """Return True if a row has too few episodes for an interval."""
    return bool(row.get("episodes", FEWEST) < FEWEST)


def describe_episodes(row: Row) -> str:
    """`100 episodes`, `2 episodes, too few for an interval`."""
    count = row["episodes"]
    remark = ", too few for an interval" if has_few_episodes(row) and count > 1 else ""
    return f"{count} episode{'s' if count > 1 else ''}{remark}"


# cells


def field_cell(key: str, form: str = "", bounds: str = "") -> Cell:
    """A cell with a field, such as `3,413 [3,405, 3,420]`; a dash where it is not known.

    form: as of ReportField
    bounds: key of the interval, which few episodes do not have
    """

    def cell(row: Row) -> str:
        if row.get(key) is None:
            return ABSENT
        text = _format(row, row[key], form)
        if not bounds or row.get(bounds) is None or has_few_episodes(row):
            return text
        low, high = (_format(row, bound, form).rstrip("%") for bound in row[bounds])
        return f"{text} [{low}, {high}]"

    return cell


def _format(row: Row, value: Any, form: str) -> str:  # noqa: ANN401
    text = format(value, form.replace("R", str(_decimals(row))).replace("p", "%"))
    return text.rstrip("%") if "p" in form else text


def _decimals(row: Row) -> int:
    """Decimals of a return: hexapods earn thousands, karts tens, others anything."""
    if row.get("foreign"):
        size = abs(row["return_mean"])
        return 0 if size >= 1000 else 1 if size >= 10 else 3
    return 1 if drives(row) else 0


def _columns(record: type, table: str = "") -> dict[str, Column]:
    """Key -> column, for the fields of a record that have one in a table."""
    return {
        each.key: Column(each.title, each.meaning, field_cell(each.key, each.form, each.bounds))
        for each in report_fields(record).values()
        if each.title and each.table == table
    }


def _in_order(columns: Mapping[str, Column], *keys: str) -> dict[str, Column]:
    """The columns in the order of these keys, which must name each of them."""
    if unplaced := columns.keys() - {*keys}:
        raise ValueError(f"columns without a place in a table: {', '.join(sorted(unplaced))}")
    return {key: columns[key] for key in keys}


_PERFORMANCE = _in_order(
    _columns(Performance),
    "return_mean", "return_iqm", "risk", "success_rate", "failure_rate", "ratio_to_float_ann",
    "normalised_score",
)  # fmt: skip
_ENDED_EARLY, _OF_ANN = _PERFORMANCE["failure_rate"], _PERFORMANCE["ratio_to_float_ann"]
format_return = _PERFORMANCE["return_mean"].cell  # `3,413 [3,405, 3,420]`
format_success = field_cell("success_rate", ".0%", "success_ci95")  # `97% [92, 99]`
_FINISHED = Column(
    "finished", "episodes that reach the end, with the 95% Wilson interval", format_success
)
_CLOCK = Column(
    "clock",
    "gated: layers advance one after the other; pipelined: all at once; free: in every timestep",
    field_cell("clock"),
)
_NAME = Column("policy", "policy · chip; `float` is the float twin of a spiking policy", label)


def _divergence(row: Row) -> str:
    """The median first divergence; `never` where half of the episodes never diverge."""
    if row["reference"] is None:
        return ABSENT
    step = row["first_divergence"]
    return "never" if step is None else f"{step:,.0f}"


_AGREEMENT = _columns(ReferenceAgreement)
_AGREEMENT["first_divergence"] = replace(_AGREEMENT["first_divergence"], cell=_divergence)
format_difference = _AGREEMENT["difference_mean"].cell  # paired: `-20 [-41, +3]`


# tables


def tables(rows: Sequence[Row]) -> dict[str, list[Column]]:
    """Title -> columns that some row fills."""
    title, earned = _earnings(rows)
    agreement = dict(_AGREEMENT)
    if not any(map(drives, rows)):
        del agreement["success_difference_mean"]
    found = {
        title: [_CLOCK, *earned, *measured_columns(rows)],
        "Does it act like its reference?": agreement.values(),
        "How large is the network?": _columns(Costs, "size").values(),
        "What does an inference take?": [_CLOCK, *_columns(Costs, "operations").values()],
        COST: _price_columns(rows),
    }
    filled = {title: _drop(columns, rows, ABSENT) for title, columns in found.items()}
    filled["Where does the energy go, in nJ?"] = _drop(_TERMS, rows, ABSENT, "0")
    return {title: [_NAME, *columns] for title, columns in filled.items() if columns}


def markdown_tables(rows: Sequence[Row]) -> str:
    """The tables in Markdown, each under its title."""
    parts = []
    for title, columns in tables(rows).items():
        found = Table.from_records(columns, rows)
        heads = [escape_markdown(head) for head in found.columns]
        cells = [[escape_markdown(name), *rest] for name, *rest in found.rows]
        parts.append(f"### {title}\n\n{Table(heads, cells).markdown()}\n")
    return "\n".join(parts)


def _earnings(rows: Sequence[Row]) -> tuple[str, Sequence[Column]]:
    """Return the title and columns of the first table, by the world that the rows are of."""
    of_world = [
        Column(m.title, m.meaning, field_cell(m.name, m.form))
        for m in metrics_of(name for row in rows for name in row)
    ]
    if any(map(drives, rows)):
        placed = ("success_rate", "failure_rate", "ratio_to_float_ann")  # the last is left out
        others = [column for key, column in _PERFORMANCE.items() if key not in placed]
        return "Does the kart still finish?", [_FINISHED, _ENDED_EARLY, *of_world, *others]
    earned = [*_PERFORMANCE.values()]
    if any(row.get("foreign") for row in rows):
        return "What does it earn?", earned
    return "Does the robot still walk?", [*earned, *of_world]


def measured_columns(rows: Sequence[Row]) -> list[Column]:
    """A column for each metric of --metric."""
    names = dict.fromkeys(name for row in rows for name in row.get("measured", ()))
    return [_measured_column(name) for name in names]


def _measured_column(text: str) -> Column:
    name, _, reduction = text.rpartition(":")
    meaning = f"{reduction} of {name} in the step infos, mean over the episodes"
    cell = field_cell(text, ".4g")
    return Column(f"{name} {reduction}", meaning, lambda row: cell(row.get("measured", {})))


def _drop(columns: Iterable[Column], rows: Sequence[Row], *empty: str) -> list[Column]:
    """The columns of which some cell is not empty."""
    return [column for column in columns if {column.cell(row) for row in rows} - {*empty}]


# energy: by every table, then term by term by COMMON_TABLE


def energy_cell(table: str) -> Cell:
    """A cell with the energy of a control step by a table."""
    return price_cell("energy_per_inference_j", table, "J", "energy_interval_j")


def _price_columns(rows: Sequence[Row]) -> list[Column]:
    """Energies and latencies by every table that some row has."""
    latency = "latency_per_inference_s"
    energies = [
        Column(name, f"energy by table {name}", energy_cell(name))
        for name in dict.fromkeys(name for row in rows for name in row["energy_per_inference_j"])
    ]
    latencies = [
        Column(
            f"{name} time",
            f"time by table {name}, as if one core did everything",
            price_cell(latency, name, "s", "latency_interval_s"),
        )
        for name in dict.fromkeys(name for row in rows for name in row[latency])
    ]
    return [*energies, *latencies]


def _unknown(row: Row) -> Sequence[str]:
    found: Sequence[str] = row.get("energy_unknown", {}).get(COMMON_TABLE, ())
    return found


def _nanojoules(field: str, term: str = "") -> Cell:
    """A cell in nJ with a field by COMMON_TABLE, or a term of it; `?` where it has no price."""

    def cell(row: Row) -> str:
        if term in _unknown(row):
            return "?"
        value = row.get(field, {}).get(COMMON_TABLE)
        value = value.get(term) if term and value is not None else value
        if value is None:
            return ABSENT
        return f"{1e9 * value:,.0f}" if 1e9 * value >= 100 else f"{1e9 * value:.3g}"

    return cell


def _total(row: Row) -> str:
    """All known terms: a lower bound where each price is, and what is missing marked elsewhere."""
    value = _nanojoules("energy_total_j")(row)
    if value == ABSENT:
        return ABSENT
    low, _ = row.get("energy_interval_j", {}).get(COMMON_TABLE, (0, None))
    if low and low == row["energy_per_inference_j"].get(COMMON_TABLE):
        return f"≥ {value}"
    return f"{value} + ?" if _unknown(row) else value


def _static(row: Row) -> str:
    """Each measurement by name; whether a chip has none that is published."""
    found = row.get("static_energy_j", {})
    if found:
        return ", ".join(f"{format_si(joules)}J ({name})" for name, joules in found.items())
    name = (row.get("chip") or "float").partition(":")[0]
    sold = name in CHIPS and name not in ("ideal", "int")
    return "not published" if sold and name not in STATIC else ABSENT


def _level(row: Row) -> str:
    fields = ("break_even_sops", "break_even_sops_zero_skipping")
    found = [row.get(field, {}).get(COMMON_TABLE) for field in fields]
    levels = [f"{value:,.0f}" if value > 0 else "none" for value in found if value is not None]
    return " / ".join(levels) or ABSENT


_PRICED_TERMS = {
    "operations": f"by {COMMON_TABLE}: synaptic operations, or dense MACs",
    "bias": "the axon of the biases; of float networks their addition",
    "updates": "neurons with something to add up",
    "encoder": "numbers to spikes; of float networks their reading",
    "readout": "weights and constants on the host",
    "resets": "states set to 0 between inferences",
}
_TERMS = [
    *(Column(n, what, _nanojoules("energy_terms_j", n)) for n, what in _PRICED_TERMS.items()),
    Column("all known", "≥: prices are lower bounds; + ?: some terms have no price", _total),
    Column(
        "level at", "SOPs that would cost what the float ANN does, dense / skipping zeros", _level
    ),
    Column(
        "no price",
        "terms that happen and that the table has no price for",
        lambda row: ", ".join(_unknown(row)) or ABSENT,
    ),
    Column("static", "a published idle power over a control step; never added", _static),
]
_TERMS.insert(
    1,
    Column(
        "skipping zeros",
        "MACs with an input that is not 0",
        _nanojoules("energy_zero_skipping_j"),
    ),
)


# one table of 80 columns, and one line


def short_columns(rows: Sequence[Row], env: str = "") -> list[Column]:
    """Policy, return, share of the float ANN, success, operations, and energy by one table.

    env: id of the environment, which names of runs need not repeat
    """
    earned, success = earned_columns(rows)
    if any(map(drives, rows)):  # what counts there is how many finish
        earned = replace(earned, cell=field_cell("return_mean", ".1f"))
    columns = [earned, _OF_ANN, success, *paid_columns(rows)]
    return [
        Column("policy", "policy · chip", short_label(rows, env)),
        *_drop(columns, rows, ABSENT),
    ]


def earned_columns(rows: Sequence[Row]) -> tuple[Column, Column]:
    """Return the mean return, and successes or finishes."""
    success = _FINISHED if any(map(drives, rows)) else _PERFORMANCE["success_rate"]
    return _PERFORMANCE["return_mean"], success


def paid_columns(rows: Sequence[Row]) -> tuple[Column, Column]:
    """Return operations of a control step, and their energy by one table."""
    table = quoted_table(rows)
    operations = "a control step, of synapses; dense MACs: zeros are not skipped"
    energy = f"a control step, by table {table}"
    return (
        Column("operations", operations, format_operations),
        Column("energy", energy, energy_cell(table)),
    )


def short_label(rows: Sequence[Row], env: str) -> Callable[[Row], str]:
    """Labels whose run names have neither date nor environment, where they still differ."""
    names = {str(row["policy"]) for row in rows}
    part = re.sub(r"[^A-Za-z0-9.-]+", "-", f"-{env}-")  # as the run folder has it
    short = {name: _STAMP.sub("", name).replace(part, "-", 1) for name in names}
    if len(set(short.values())) < len(names):
        return label
    return lambda row: label({**row, "policy": short[str(row["policy"])]})


def quoted_table(rows: Sequence[Row]) -> str:
    """The energy table to quote: the one that prices chips and float networks alike, if any."""
    return quoted_among(name for row in rows for name in row["energy_per_inference_j"])


def quoted_among(tables: Iterable[str]) -> str:
    """The one to quote of these energy tables, if any."""
    names = dict.fromkeys(tables)
    return COMMON_TABLE if COMMON_TABLE in names else next(iter(names), "")


def energy_hint(rows: Sequence[Row]) -> str:
    """The energy to quote; empty where there is none."""
    table = quoted_table(rows)
    if table == COMMON_TABLE:
        return f"Energy: of operations, by {table}, which prices spiking and float networks alike."
    return f"Energy: of operations, by {table}; say so where you quote it." if table else ""


def describe_run(document: Mapping[str, Any]) -> str:
    """The row of a run in one line: return, success, metrics asked for, operations, energy."""
    (row,) = document["rows"]
    table = quoted_table([row])
    energy = energy_cell(table)(row) if table else ABSENT
    operations = format_operations(row)
    done = "finished" if drives(row) else "succeeded"
    facts = [
        f"return {format_return(row)} in {describe_episodes(row)}",
        *([f"{sum(row['successes'])} {done}"] if row["successes"] else []),
        *(f"{name} {value:.4g}" for name, value in row.get("measured", {}).items()),
        *([f"{operations} a control step"] if operations != ABSENT else []),
        *([f"{energy} by {table}"] if energy != ABSENT else []),
    ]
    return f"{label(row)}: {', '.join(facts)}."


def format_operations(row: Row) -> str:
    """Synaptic operations, or all multiply-accumulates of a float network: `748,544 SOPs`."""
    if row.get("sops_per_inference") is not None:
        return f"{row['sops_per_inference']:,.0f} SOPs"
    macs = row.get("macs_dense")
    return f"{macs:,.0f} dense MACs" if macs else ABSENT
