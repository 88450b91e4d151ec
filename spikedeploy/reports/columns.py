"""The tables of a comparison, for terminal, HTML report and cards alike."""

from collections.abc import Sequence

from spikedeploy.comparison.metrics import DRIVING, WALKING, drives
from spikedeploy.comparison.summary import few
from spikedeploy.reports.cells import ABSENT, Cell, Column, Row, bounded, number, price, scaled
from spikedeploy.reports.energy_columns import prices, spent
from spikedeploy.reports.markdown import markdown_name, markdown_table

__all__ = [
    "ABSENT",
    "COST",
    "Column",
    "Row",
    "asked_for",
    "bounded",
    "difference",
    "divergence",
    "finished",
    "interval",
    "label",
    "markdown",
    "price",
    "scaled",
    "score",
    "tables",
]

COST = "What does an inference cost?"
WHERE = "Where does the energy go, in nJ?"


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
        if few(row):
            return f"{row[field]:{form}}"
        return f"{row[field]:{form}} [{low:{form}}, {high:{form}}]"

    return cell


interval = _estimate("return_mean", "return_ci95")  # `3,413 [3,405, 3,420]`
difference = _estimate("difference_mean", "difference_ci95", "+")  # paired: `-20 [-41, +3]`


def _digits(row: Row) -> int:
    """Decimals of a return: hexapods earn thousands, karts tens, others anything."""
    if row.get("foreign"):
        size = abs(row["return_mean"])
        return 0 if size >= 1000 else 1 if size >= 10 else 3
    return 1 if drives(row) else 0


def finished(row: Row) -> str:
    """The success rate with its interval: `97% [92, 99]`; a dash where success is not known."""
    if row.get("success_ci95") is None:
        return ABSENT
    low, high = row["success_ci95"]
    if few(row):
        return f"{row['success_rate']:.0%}"
    return f"{row['success_rate']:.0%} [{100 * low:.0f}, {100 * high:.0f}]"


def _points(row: Row) -> str:
    """The paired difference of the success rate in percentage points: `+1.0 [-1.0, +3.0]`."""
    if row["success_difference_mean"] is None or not drives(row):
        return ABSENT
    low, high = row["success_difference_ci95"]
    if few(row):
        return f"{100 * row['success_difference_mean']:+.1f}"
    return f"{100 * row['success_difference_mean']:+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]"


def score(row: Row) -> str:
    """The normalised score in percent."""
    value = row["normalised_score"]
    return ABSENT if value is None else f"{100 * value:.0f}"


def divergence(row: Row) -> str:
    """The median first divergence; `never` where half of the episodes never diverge."""
    if row["reference"] is None:
        return ABSENT
    step = row["first_divergence"]
    return "never" if step is None else f"{step:,.0f}"


_NAME = Column("policy", "policy · chip; `float` is the float twin of a spiking policy", label)

_RETURNS = (
    Column("return", "mean return of an episode, with its 95% bootstrap interval", interval),
    Column(
        "IQM",
        "interquartile mean of the returns, without the lowest and the highest quarter, likewise",
        _estimate("return_iqm", "return_iqm_ci95"),
    ),
    Column(
        "risk",
        "mean return of the worst 5% of the episodes, likewise",
        _estimate("risk", "risk_ci95"),
    ),
)
_WALK = (
    *_RETURNS,
    Column("success", "episodes that succeed", number("success_rate", ".0%")),
    Column("of ANN", "mean return / that of the float ANN", number("ratio_to_float_ann", ".1%")),
    Column("score", "normalised return: the gait alone is 0, the float ANN 100", score),
    *(Column(m.title, m.meaning, number(m.name, m.form)) for m in WALKING),
)
_DRIVE = (
    Column("finished", "episodes that reach the last gate, with the 95% Wilson interval", finished),
    *(Column(m.title, m.meaning, number(m.name, m.form)) for m in DRIVING),
    *_RETURNS,
    Column("score", "normalised return: random actions are 0, the float ANN 100", score),
)
_EARN = (
    *_RETURNS,
    Column(
        "success",
        "episodes that succeed: by the key of --success, or return the registered threshold",
        number("success_rate", ".0%"),
    ),
    Column("of ANN", "mean return / that of the float ANN", number("ratio_to_float_ann", ".1%")),
    Column("score", "normalised return: random actions are 0, the float ANN 100", score),
)
_AGREEMENT = (
    Column(
        "reference",
        "whom the row is measured against: on a chip its float twin, else the float ANN",
        number("reference", ""),
    ),
    Column(
        "difference",
        "paired difference of return on the same seeds, with its 95% bootstrap interval",
        difference,
    ),
    Column("ratio", "mean return / that of the reference", number("ratio_to_reference", ".1%")),
    Column(
        "finished",
        "paired difference of the finish rate on the same seeds, in percentage points, with its "
        "95% bootstrap interval",
        _points,
    ),
    Column(
        "same action",
        "share of equal actions, both asked on the observations that the reference recorded",
        number("actions_equal", ".1%"),
    ),
    Column("as ANN", "the same, with the float ANN", number("actions_equal_to_ann", ".1%")),
    Column(
        "action RMSE",
        "RMSE over all actions, both asked on the observations that the reference recorded",
        number("action_rmse", ".4f"),
    ),
    Column("to ANN", "the same, with the float ANN", number("rmse_to_ann", ".4f")),
    Column(
        "diverges",
        "median first control step at which an action differs from the reference's by more than "
        "0.01 in the closed loop",
        divergence,
    ),
)
_CLOCK = Column(
    "clock",
    "how layers advance: gated, one after the other; pipelined, all at once, a timestep for each "
    "connection; free, all in every timestep until the last has seen the input",
    number("clock", ""),
)
_OPERATIONS = (
    _CLOCK,
    Column("sparsity", "1 - spikes / (neurons × T), spiking layers", number("sparsity", ".1%")),
    Column("spikes", "spikes of the spiking layers", number("spikes_per_inference", ",.0f")),
    Column("input", "spikes of the encoder", number("input_spikes_per_inference", ",.0f")),
    Column(
        "SOPs",
        "synaptic operations: spikes × non-zero fan-out, from the encoder on",
        number("sops_per_inference", ",.0f"),
    ),
    Column(
        "+ bias",
        "synaptic operations of the always-on axon that carries the biases",
        number("bias_sops_per_inference", ",.0f"),
    ),
    Column(
        "ACs",
        "NeuroBench Effective_ACs: non-zero inputs × non-zero weights where inputs are spikes, the "
        "readout included",
        number("effective_acs", ",.0f"),
    ),
    Column(
        "MACs",
        "NeuroBench Effective_MACs: the same where inputs are numbers",
        number("effective_macs", ",.0f"),
    ),
    Column(
        "dense",
        "NeuroBench Dense: all inputs × all weights, in all T timesteps",
        number("macs_dense", ",.0f"),
    ),
    Column(
        "sat.",
        "numbers that did not fit a register of the chip, in all episodes",
        number("saturations", ",.0f"),
    ),
)


_SIZE = (
    Column(
        "bytes",
        "NeuroBench Footprint: parameters in float32, and the constants of the neurons",
        number("footprint", ",.0f"),
    ),
    Column(
        "packed",
        "bytes of all weights and biases on the chip, in its widths",
        number("footprint_packed", ",.0f"),
    ),
    Column(
        "zero weights",
        "NeuroBench ConnectionSparsity: weights of the file that are 0",
        number("connection_sparsity", ".1%"),
    ),
)


def tables(rows: Sequence[Row]) -> dict[str, list[Column]]:
    """Title -> columns that some row fills."""
    title, columns = _task(rows)
    clocked = _filled((_CLOCK,), rows)
    found = {
        title: [*clocked, *_filled(columns, rows), *asked_for(rows)],
        "Does it act like its reference?": _filled(_AGREEMENT, rows),
        "How large is the network?": _filled(_SIZE, rows),
        "What does an inference take?": _filled(_OPERATIONS, rows),
        COST: _filled(prices(rows), rows),
        WHERE: spent(rows),
    }
    return {title: [_NAME, *columns] for title, columns in found.items() if columns}


def _task(rows: Sequence[Row]) -> tuple[str, Sequence[Column]]:
    """What is asked of policies in the kind of world that the rows are of, and its columns."""
    if any(row.get("foreign") for row in rows):
        return "What does it earn?", _EARN
    if any(map(drives, rows)):
        return "Does the kart still finish?", _DRIVE
    return "Does the robot still walk?", _WALK


def asked_for(rows: Sequence[Row]) -> list[Column]:
    """A column for each metric that was asked for."""
    names = dict.fromkeys(name for row in rows for name in row.get("measured", ()))
    return [_metric(name) for name in names]


def _metric(text: str) -> Column:
    name, _, reduction = text.rpartition(":")

    def cell(row: Row) -> str:
        value = row.get("measured", {}).get(text)
        return ABSENT if value is None else f"{value:.4g}"

    meaning = f"{reduction} of {name} in the step infos, mean over the episodes"
    return Column(f"{name} {reduction}", meaning, cell)


def _filled(columns: Sequence[Column], rows: Sequence[Row]) -> list[Column]:
    return [column for column in columns if any(column.cell(row) != ABSENT for row in rows)]


def markdown(rows: Sequence[Row]) -> list[str]:
    """The tables as lines of Markdown."""
    return [
        line
        for title, columns in tables(rows).items()
        for line in (f"### {title}", "", *_markdown(columns, rows), "")
    ]


def _markdown(columns: Sequence[Column], rows: Sequence[Row]) -> list[str]:
    heads = [markdown_name(column.title) for column in columns]
    cells = [[column.cell(row) for column in columns] for row in rows]
    return markdown_table([heads, *([markdown_name(name), *rest] for name, *rest in cells)])
