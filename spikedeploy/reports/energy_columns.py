"""The columns of a comparison that are about energy: by every table, and term by term by one."""

from collections.abc import Sequence

from spikedeploy.reports.cells import ABSENT, Cell, Column, Row, price, scaled
from spikedeploy.runtime.chips.chip import CHIPS
from spikedeploy.runtime.metrics.energy_tables import STATIC

COMMON_TABLE = "horowitz45-int8"  # the one that prices a chip and a float network alike


def prices(rows: Sequence[Row]) -> list[Column]:
    """Energies and latencies by every table that some row has."""
    energy, latency = "energy_per_inference_j", "latency_per_inference_s"
    energies = [
        Column(name, f"energy by table {name}", price(energy, name, "J", "energy_interval_j"))
        for name in dict.fromkeys(name for row in rows for name in row[energy])
    ]
    latencies = [
        Column(
            f"{name} time",
            f"time by table {name}, as if one core did everything",
            price(latency, name, "s", "latency_interval_s"),
        )
        for name in dict.fromkeys(name for row in rows for name in row[latency])
    ]
    return [*energies, *latencies]


def _term(name: str) -> Cell:
    """A cell with a term by the one table, `?` where it is unknown."""

    def cell(row: Row) -> str:
        if name in row.get("energy_unknown", {}).get(COMMON_TABLE, ()):
            return "?"
        value = row.get("energy_terms_j", {}).get(COMMON_TABLE, {}).get(name)
        return ABSENT if value is None else _joules(value)

    return cell


def _joules(value: float) -> str:
    """In nJ, three digits or all before the point."""
    nano = 1e9 * value
    return f"{nano:,.0f}" if nano >= 100 else f"{nano:.3g}"


def _of_table(field: str) -> Cell:
    """A cell with the joules of the field by the one table."""

    def cell(row: Row) -> str:
        value = row.get(field, {}).get(COMMON_TABLE)
        return ABSENT if value is None else _joules(value)

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
    """The unknown terms."""
    return ", ".join(row.get("energy_unknown", {}).get(COMMON_TABLE, ())) or ABSENT


def _static(row: Row) -> str:
    """Each measurement by name; whether a chip has none that is published."""
    found = row.get("static_energy_j", {})
    if found:
        return ", ".join(f"{scaled(joules)}J ({name})" for name, joules in found.items())
    name = (row.get("chip") or "float").partition(":")[0]
    sold = name in CHIPS and name not in ("ideal", "int")
    return "not published" if sold and name not in STATIC else ABSENT


def _level(row: Row) -> str:
    """Synaptic operations: against the dense float ANN, and against the one that skips zeros."""
    fields = ("break_even_sops", "break_even_sops_zero_skipping")
    found = [row.get(field, {}).get(COMMON_TABLE) for field in fields]
    said = [
        f"{max(value, 0):,.0f}" if value > 0 else "none" for value in found if value is not None
    ]
    return " / ".join(said) or ABSENT


_WHERE = (
    Column(
        "operations",
        f"by table {COMMON_TABLE}, in all columns: synaptic operations; of float networks all "
        "multiply-accumulates",
        _term("operations"),
    ),
    Column(
        "skipping zeros",
        "of float networks: multiply-accumulates with an input that is not 0, instead of all",
        _of_table("energy_zero_skipping_j"),
    ),
    Column("bias", "the axon of the biases; of float networks their addition", _term("bias")),
    Column("updates", "neurons with something to add up", _term("updates")),
    Column(
        "encoder",
        "numbers to spikes; of float networks the reading of observations",
        _term("encoder"),
    ),
    Column("readout", "weights and constants on the host", _term("readout")),
    Column("resets", "states set to 0 between inferences", _term("resets")),
    Column(
        "all known",
        "sum of the known terms; ≥ where every price is the least of its process, + ? where some "
        "terms have no price",
        _total,
    ),
    Column(
        "level at",
        "SOPs at which the spiking policy would cost as much as the float ANN, dense / skipping "
        "zeros; none where its other terms alone cost more",
        _level,
    ),
    Column("no price", "terms that happen and that the table has no price for", _unpriced),
    Column(
        "static",
        "a published static power of the chip over a control step, by its measurement; never added",
        _static,
    ),
)


def spent(rows: Sequence[Row]) -> list[Column]:
    """The terms that some row pays, or does not know."""
    said = {column.title: {column.cell(row) for row in rows} for column in _WHERE}
    return [column for column in _WHERE if said[column.title] - {ABSENT, "0"}]
