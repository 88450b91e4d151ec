"""The columns of a comparison: its tables, its table of 80 columns, one row in one line.

Columns of costs are fields of `policies.costs.Costs`; `comparison.episode_metrics` has those of
episodes.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from spikedeploy.comparison.episode_metrics import drives, metrics_of
from spikedeploy.comparison.summary import describe_episodes, has_few_episodes
from spikedeploy.policies.costs import COLUMNS as COST_COLUMNS
from spikedeploy.reports.table import (
    ABSENT,
    COMMON_TABLE,
    Cell,
    Column,
    Row,
    Table,
    escape_markdown,
    field_cell,
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


def _estimate(field: str, between: str, sign: str = "") -> Cell:
    """A cell with a return and its interval, alone where episodes are few; a dash where unknown."""

    def cell(row: Row) -> str:
        if row.get(between) is None:
            return ABSENT
        low, high = row[between]
        form = f"{sign},.{_digits(row)}f"
        return _around(row, f"{row[field]:{form}}", f"{low:{form}}", f"{high:{form}}")

    return cell


def _around(row: Row, mean: str, low: str, high: str) -> str:
    return mean if has_few_episodes(row) else f"{mean} [{low}, {high}]"


format_return = _estimate("return_mean", "return_ci95")  # `3,413 [3,405, 3,420]`
format_difference = _estimate("difference_mean", "difference_ci95", "+")  # paired: `-20 [-41, +3]`


def _digits(row: Row) -> int:
    """Decimals of a return: hexapods earn thousands, karts tens, others anything."""
    if row.get("foreign"):
        size = abs(row["return_mean"])
        return 0 if size >= 1000 else 1 if size >= 10 else 3
    return 1 if drives(row) else 0


def format_success(row: Row) -> str:
    """The success rate with its interval: `97% [92, 99]`; a dash where success is not known."""
    if row.get("success_ci95") is None:
        return ABSENT
    low, high = row["success_ci95"]
    return _around(row, f"{row['success_rate']:.0%}", f"{100 * low:.0f}", f"{100 * high:.0f}")


def _success_difference(row: Row) -> str:
    """The paired difference of the success rate in percentage points: `+1.0 [-1.0, +3.0]`."""
    if row["success_difference_mean"] is None or not drives(row):
        return ABSENT
    found = (row["success_difference_mean"], *row["success_difference_ci95"])
    return _around(row, *(f"{100 * each:+.1f}" for each in found))


def _score(row: Row) -> str:
    value = row["normalised_score"]
    return ABSENT if value is None else f"{100 * value:.0f}"


def _divergence(row: Row) -> str:
    """The median first divergence; `never` where half of the episodes never diverge."""
    if row["reference"] is None:
        return ABSENT
    step = row["first_divergence"]
    return "never" if step is None else f"{step:,.0f}"


def tables(rows: Sequence[Row]) -> dict[str, list[Column]]:
    """Title -> columns that some row fills."""
    title, columns = _earnings(rows)
    clocked = _drop_empty([_CLOCK], rows)
    found = {
        title: [*clocked, *_drop_empty(columns, rows), *measured_columns(rows)],
        "Does it act like its reference?": _drop_empty(_AGREEMENT, rows),
        "How large is the network?": _drop_empty(_cost_columns("size"), rows),
        "What does an inference take?": _drop_empty([_CLOCK, *_cost_columns("operations")], rows),
        COST: _drop_empty(_price_columns(rows), rows),
        "Where does the energy go, in nJ?": _term_columns(rows),
    }
    return {title: [_NAME, *columns] for title, columns in found.items() if columns}


def markdown_tables(rows: Sequence[Row]) -> str:
    """The tables in Markdown, each under its title."""
    return "\n".join(
        f"### {title}\n\n{_escaped(Table.from_records(columns, rows)).markdown()}\n"
        for title, columns in tables(rows).items()
    )


def _escaped(table: Table) -> Table:
    heads = [escape_markdown(head) for head in table.columns]
    return Table(heads, [[escape_markdown(name), *rest] for name, *rest in table.rows])


def _cost_columns(table: str) -> list[Column]:
    """Return the columns of a table that are fields of Costs."""
    return [
        Column(each.title, each.meaning, field_cell(each.key, each.form))
        for each in COST_COLUMNS.values()
        if each.title and each.table == table
    ]


def _earnings(rows: Sequence[Row]) -> tuple[str, Sequence[Column]]:
    """Return the title and columns of the first table, by the world that the rows are of."""
    of_world = [
        Column(m.title, m.meaning, field_cell(m.name, m.form))
        for m in metrics_of(name for row in rows for name in row)
    ]
    if any(row.get("foreign") for row in rows):
        meaning = (
            "episodes that succeed: by the key of --success, or return the registered threshold"
        )
        earned = [_succeeded(meaning), _ENDED_EARLY, _OF_ANN, _scored("random actions are")]
        return "What does it earn?", [*_RETURNS, *earned]
    if any(map(drives, rows)):
        driven = [_finished("the last gate is reached"), _ENDED_EARLY, *of_world, *_RETURNS]
        return "Does the kart still finish?", [*driven, _scored("random actions are")]
    walked = [_succeeded("episodes that succeed"), _ENDED_EARLY, _OF_ANN]
    return "Does the robot still walk?", [
        *_RETURNS,
        *walked,
        _scored("the gait alone is"),
        *of_world,
    ]


def _succeeded(meaning: str) -> Column:
    return Column("success", meaning, field_cell("success_rate", ".0%"))


def _finished(event: str) -> Column:
    meaning = f"episodes in which {event}, with the 95% Wilson interval"
    return Column("finished", meaning, format_success)


def _scored(zero: str) -> Column:
    return Column("score", f"normalised return: {zero} 0, the float ANN 100", _score)


def measured_columns(rows: Sequence[Row]) -> list[Column]:
    """A column for each metric of --metric."""
    names = dict.fromkeys(name for row in rows for name in row.get("measured", ()))
    return [_metric(name) for name in names]


def _metric(text: str) -> Column:
    name, _, reduction = text.rpartition(":")

    def cell(row: Row) -> str:
        value = row.get("measured", {}).get(text)
        return ABSENT if value is None else f"{value:.4g}"

    meaning = f"{reduction} of {name} in the step infos, mean over the episodes"
    return Column(f"{name} {reduction}", meaning, cell)


def _drop_empty(columns: Iterable[Column], rows: Sequence[Row]) -> list[Column]:
    return [column for column in columns if any(column.cell(row) != ABSENT for row in rows)]


# energy: by every table, then term by term by COMMON_TABLE


def energy_cell(table: str) -> Cell:
    """A cell with the energy of a control step by a table."""
    return price_cell("energy_per_inference_j", table, "J", "energy_interval_j")


def _price_columns(rows: Sequence[Row]) -> list[Column]:
    """Energies and latencies by every table that some row has."""
    energies = [
        Column(name, f"energy by table {name}", energy_cell(name))
        for name in dict.fromkeys(name for row in rows for name in row["energy_per_inference_j"])
    ]
    latency = "latency_per_inference_s"
    latencies = [
        Column(
            f"{name} time",
            f"time by table {name}, as if one core did everything",
            price_cell(latency, name, "s", "latency_interval_s"),
        )
        for name in dict.fromkeys(name for row in rows for name in row[latency])
    ]
    return [*energies, *latencies]


def _term(name: str) -> Cell:

    def cell(row: Row) -> str:
        if name in row.get("energy_unknown", {}).get(COMMON_TABLE, ()):
            return "?"
        value = row.get("energy_terms_j", {}).get(COMMON_TABLE, {}).get(name)
        return ABSENT if value is None else _format_nj(value)

    return cell


def _format_nj(value: float) -> str:
    nano = 1e9 * value
    return f"{nano:,.0f}" if nano >= 100 else f"{nano:.3g}"


def _of_table(field: str) -> Cell:

    def cell(row: Row) -> str:
        value = row.get(field, {}).get(COMMON_TABLE)
        return ABSENT if value is None else _format_nj(value)

    return cell


def _total(row: Row) -> str:
    """All known terms: a lower bound where each price is, and what is missing marked elsewhere."""
    value = _of_table("energy_total_j")(row)
    if value == ABSENT:
        return ABSENT
    low, _ = row.get("energy_interval_j", {}).get(COMMON_TABLE, (0, None))
    if low and low == row["energy_per_inference_j"].get(COMMON_TABLE):
        return f"≥ {value}"
    return f"{value} + ?" if row.get("energy_unknown", {}).get(COMMON_TABLE) else value


def _unpriced(row: Row) -> str:
    return ", ".join(row.get("energy_unknown", {}).get(COMMON_TABLE, ())) or ABSENT


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


def _field(title: str, name: str, form: str, meaning: str) -> Column:
    return Column(title, meaning, field_cell(name, form))


_RETURNS = (
    Column("return", "mean return of an episode, with its 95% bootstrap interval", format_return),
    Column(
        "IQM", "mean of the middle half of the returns", _estimate("return_iqm", "return_iqm_ci95")
    ),
    Column("risk", "mean return of the worst 5% of the episodes", _estimate("risk", "risk_ci95")),
)
_ENDED_EARLY = _field(
    "ended early",
    "failure_rate",
    ".0%",
    "episodes that a terminal state other than success ended: a fall, a crash, a stall",
)
_OF_ANN = _field("of ANN", "ratio_to_float_ann", ".1%", "mean return / that of the float ANN")
_AGREEMENT = (
    _field(
        "reference",
        "reference",
        "",
        "policy of comparison: on a chip its float twin, else the float ANN",
    ),
    Column(
        "difference",
        "of return on the same seeds, paired, with its 95% interval",
        format_difference,
    ),
    _field("ratio", "ratio_to_reference", ".1%", "mean return / that of the reference"),
    Column(
        "finished",
        "paired difference of the finish rate, in percentage points",
        _success_difference,
    ),
    _field(
        "same action", "actions_equal", ".1%", "equal actions, on observations of the reference"
    ),
    _field("as ANN", "actions_equal_to_ann", ".1%", "the same, with the float ANN"),
    _field("action RMSE", "action_rmse", ".4f", "of all actions, on observations of the reference"),
    _field("to ANN", "rmse_to_ann", ".4f", "the same, with the float ANN"),
    Column("diverges", "median first control step at which actions differ by 0.01", _divergence),
)
_CLOCK = _field(
    "clock",
    "clock",
    "",
    "gated: layers advance one after the other; pipelined: all at once; free: in every timestep",
)
_TERMS = (
    Column(
        "operations", f"by {COMMON_TABLE}: synaptic operations, or dense MACs", _term("operations")
    ),
    Column(
        "skipping zeros", "MACs with an input that is not 0", _of_table("energy_zero_skipping_j")
    ),
    Column("bias", "the axon of the biases; of float networks their addition", _term("bias")),
    Column("updates", "neurons with something to add up", _term("updates")),
    Column("encoder", "numbers to spikes; of float networks their reading", _term("encoder")),
    Column("readout", "weights and constants on the host", _term("readout")),
    Column("resets", "states set to 0 between inferences", _term("resets")),
    Column("all known", "≥: prices are lower bounds; + ?: some terms have no price", _total),
    Column(
        "level at", "SOPs that would cost what the float ANN does, dense / skipping zeros", _level
    ),
    Column("no price", "terms that happen and that the table has no price for", _unpriced),
    Column("static", "a published idle power over a control step; never added", _static),
)
_NAME = Column("policy", "policy · chip; `float` is the float twin of a spiking policy", label)


def _term_columns(rows: Sequence[Row]) -> list[Column]:
    """The terms that some row pays, or does not know."""
    return [c for c in _TERMS if {c.cell(row) for row in rows} - {ABSENT, "0"}]


# one table of 80 columns, and one line


def short_columns(rows: Sequence[Row], env: str = "") -> list[Column]:
    """Policy, return, share of the float ANN, success, operations, and energy by one table.

    env: id of the environment, which names of runs need not repeat
    """
    table = quoted_table(rows)
    earned = Column("return", "mean return, with its 95% interval", format_return)
    success = Column("success", "episodes that succeed", field_cell("success_rate", ".0%"))
    if any(map(drives, rows)):  # what counts there is how many finish
        earned = Column("return", "mean return", field_cell("return_mean", ".1f"))
        words = "episodes that reach the end, with the 95% interval"
        success = Column("finished", words, format_success)
    columns = [
        earned,
        _OF_ANN,
        success,
        Column(
            "operations",
            "a control step, of synapses; dense MACs: zeros are not skipped",
            format_operations,
        ),
        Column("energy", f"a control step, by table {table}", energy_cell(table)),
    ]
    return [Column("policy", "policy · chip", short_label(rows, env)), *_drop_empty(columns, rows)]


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
    done = "finished" if drives(row) else "succeeded"
    facts = [
        f"return {format_return(row)} in {describe_episodes(row)}",
        *([f"{sum(row['successes'])} {done}"] if row["successes"] else []),
        *(f"{name} {value:.4g}" for name, value in row.get("measured", {}).items()),
        *(f"{each} a control step" for each in [format_operations(row)] if each != ABSENT),
    ]
    table = quoted_table([row])
    cell = energy_cell(table)(row) if table else ABSENT
    if cell != ABSENT:
        facts.append(f"{cell} by {table}")
    return f"{label(row)}: {', '.join(facts)}."


def format_operations(row: Row) -> str:
    """Synaptic operations, or all multiply-accumulates of a float network.

    Such as `748,544 SOPs`.
    """
    if row.get("sops_per_inference") is not None:
        return f"{row['sops_per_inference']:,.0f} SOPs"
    macs = row.get("macs_dense")
    return f"{macs:,.0f} dense MACs" if macs else ABSENT
