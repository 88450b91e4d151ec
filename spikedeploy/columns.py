"""The columns of a comparison's tables, the same ones on the terminal and in the HTML report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from spikedeploy.metrics import METRICS

Row = Mapping[str, Any]
ABSENT = "–"


@dataclass(frozen=True)
class Column:
    """One column: its head, what it means, and the text of a row's cell."""

    title: str
    meaning: str
    cell: Callable[[Row], str]


def label(row: Row) -> str:
    """The name of a row as people read it: `popsan · loihi1`."""
    return f"{row['policy']} · {row['chip']}" if row["chip"] else str(row["policy"])


def number(field: str, form: str) -> Callable[[Row], str]:
    """A cell that formats the field, or a dash where the row has none."""

    def cell(row: Row) -> str:
        value = row.get(field)
        return ABSENT if value is None else format(value, form)

    return cell


def joules(table: str) -> Callable[[Row], str]:
    """A cell with the energy that the table gives, in microjoules or nanojoules."""

    def cell(row: Row) -> str:
        value = row["energy_per_inference_j"].get(table)
        if value is None:
            return ABSENT
        return f"{value * 1e6:,.2f} µJ" if value >= 1e-8 else f"{value * 1e9:,.2f} nJ"

    return cell


def difference(row: Row) -> str:
    """The paired difference with its interval: `-20 [-41, +3]`."""
    if row["difference_mean"] is None:
        return ABSENT
    low, high = row["difference_ci95"]
    return f"{row['difference_mean']:+,.0f} [{low:+,.0f}, {high:+,.0f}]"


def score(row: Row) -> str:
    """The normalised score in percent."""
    value = row["normalised_score"]
    return ABSENT if value is None else f"{100 * value:.0f}"


def divergence(row: Row) -> str:
    """The first step at which the episodes part; `never` where half of them never do."""
    if row["reference"] is None:
        return ABSENT
    step = row["first_divergence"]
    return "never" if step is None else f"{step:,.0f}"


NAME = Column("policy", "policy · chip", label)
WALK = (
    NAME,
    Column("return", "mean return of an episode", number("return_mean", ",.0f")),
    Column("success", "episodes that succeed", number("success_rate", ".0%")),
    Column("of ANN", "mean return / that of the float ANN", number("ratio_to_float_ann", ".1%")),
    Column(
        "score",
        "normalised score: the gait alone is 0, the float ANN 100",
        score,
    ),
    Column(
        "Δ to reference",
        "paired difference of return to the row's reference, with its 95 % bootstrap interval",
        difference,
    ),
    Column(
        "act. RMSE",
        "action RMSE to the reference, both asked on the observations that the reference recorded",
        number("action_rmse", ".4f"),
    ),
    Column(
        "diverges",
        "median first control step whose action differs from the reference's by more than 0.01 "
        "in the closed loop",
        divergence,
    ),
)
COST = (
    NAME,
    Column("sparsity", "1 - spikes / (neurons × T), spiking layers", number("sparsity", ".1%")),
    Column(
        "spikes", "spikes per inference, input included", number("spikes_per_inference", ",.0f")
    ),
    Column(
        "SOPs", "spikes × non-zero fan-out, per inference", number("sops_per_inference", ",.0f")
    ),
    Column(
        "eff. ACs",
        "NeuroBench Effective_ACs: non-zero inputs × non-zero weights where inputs are spikes, "
        "readout included",
        number("effective_acs", ",.0f"),
    ),
    Column(
        "eff. MACs",
        "NeuroBench Effective_MACs: the same where inputs are numbers",
        number("effective_macs", ",.0f"),
    ),
    Column(
        "dense",
        "NeuroBench Dense: all inputs × all weights, of all T timesteps",
        number("macs_dense", ",.0f"),
    ),
)
SATURATIONS = Column(
    "sat.", "saturated or wrapped values, all episodes", number("saturations", ",.0f")
)


def walk_columns(rows: Sequence[Row]) -> list[Column]:
    """How the robot does: the columns above, and the metrics that some row has."""
    measured = [m for m in METRICS if any(row.get(m.name) is not None for row in rows)]
    return [*WALK, *(Column(m.title, m.meaning, number(m.name, m.form)) for m in measured)]


def cost_columns(rows: Sequence[Row]) -> list[Column]:
    """What the network costs: the columns above, an energy for each table, saturations."""
    tables = dict.fromkeys(name for row in rows for name in row["energy_per_inference_j"])
    energy = [Column(name, f"energy per inference, table {name}", joules(name)) for name in tables]
    return [*COST, *energy, SATURATIONS]
