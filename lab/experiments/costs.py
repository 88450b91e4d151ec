"""Energies of a row of the pareto experiment per control step, term by term.

operations  synaptic operations, which multiply where a spike is graded, or multiply-accumulates
            with an input that is not 0
updates     neurons that were updated, and looked at; of a delta network units that were reached
traffic     messages and spikes, where a table prices them
encoder     the delta encoder, or of a float network the reading of its observations, which a delta
            network compares as well
constants   the constant of each readout, added by the host, or the biases of a float network

What the host does is priced by runtime/metrics/energy.py, alike beside all tables.
"""

from collections.abc import Mapping
from typing import Any

from spikedeploy.runtime.metrics.energy import (
    ACCESS,
    ADDITION,
    addition_energy,
    chip_terms,
    delta_encoder,
    reading_energy,
)
from spikedeploy.runtime.metrics.energy_tables import TABLES

TERMS = ("operations", "updates", "traffic", "encoder", "constants")
TOTALS = {
    "operations": ("operations",),
    "updates": ("operations", "updates"),
    "all": TERMS,
}
INT8 = "horowitz45-int8"
ACC16, ACC32 = (f"{INT8}-acc{bits}" for bits in (16, 32))  # sums in memory, found by an index
TABLE_NAMES = (INT8, "davies2018", "sanafe", ACC16, ACC32)

# event of the ledger -> column of a row
_COLUMNS = {
    "sop": "operations",
    "graded_sop": "graded_operations",
    "bias_sop": "bias_operations",
    "neuron_update": "neuron_updates",
    "one_state_update": "readout_updates",  # integrating readouts hold a membrane and no current
    "neuron_idle": "neuron_idle",
    "message": "messages",
    "spike_out": "spikes_out",
}

# two decays by a shift and a subtraction each, and the three additions of horowitz45-int8; states
# of 16 bits, two read and written
LEAN_UPDATE = 5 * ADDITION + 4 * ACCESS


def is_spiking(row: Mapping[str, Any]) -> bool:
    """Return whether a row is of a spiking policy."""
    return row.get("neuron_updates") is not None


def _has_price(row: Mapping[str, Any], table: str) -> bool:
    """Return whether a table prices a row: a float network needs multiply-accumulates.

    What a host integrates is not counted, so a row with readouts there has no price.
    """
    if row.get("operations") is None or row.get("on_host"):
        return False
    return is_spiking(row) or "mac" in TABLES[table].joules


def terms(row: Mapping[str, Any], table: str, lean: bool = False) -> dict[str, float]:
    """Energy [J] of each term in a control step.

    lean: neuron updates with states of 16 bits and decays by powers of two, derived; in tables of
        chips they cannot be chosen
    """
    if is_spiking(row):
        counts = {event: row.get(name) or 0.0 for event, name in _COLUMNS.items()}
        chip = chip_terms(counts, TABLES[table])
        updates = row["neuron_updates"] * LEAN_UPDATE if lean else chip["updates"]
        values = (
            chip["operations"] + chip["bias"],
            updates + chip["idle"],
            chip["messages"] + chip["spikes"],
            delta_encoder(row["observations"], row["events"]),
        )
    else:
        event, updates, read = "mac", 0.0, reading_energy(row["observations"])
        if reached := row.get("compared"):
            updates, read = comparisons(reached, row["sent"]), delta_encoder(row["observations"], 0)
            if table in (ACC16, ACC32):  # changes are scattered into sums, as graded spikes are
                event = "graded_sop"
        operations = row["operations"] * TABLES[table].joules.get(event, 0.0)
        values = (operations, updates, 0.0, read)
    return dict(zip(TERMS, (*values, addition_energy(row["constants"])), strict=True))


def comparisons(units: float, sent: float) -> float:
    """Energy [J] of a delta network's units some of whose inputs changed.

    The kept sum of each (16 bits) is read and written, and compared with what it sent; what is sent
    is stored.
    """
    return delta_encoder(units, sent) - reading_energy(units) + units * 2 * ACCESS


def total(row: Mapping[str, Any], table: str, of: str, lean: bool = False) -> float:
    """Energy [J] of a total (TOTALS) in a control step."""
    each = terms(row, table, lean)
    return sum(each[name] for name in TOTALS[of])


def column(table: str, of: str, lean: bool = False) -> str:
    """Name of the column of a total [J]."""
    return f"{table}{'_lean' if lean else ''}_{of}_j"


def energies(row: Mapping[str, Any]) -> dict[str, float]:
    """All totals of a row [J], and the terms by horowitz45-int8."""
    found: dict[str, float] = {}
    for table in TABLE_NAMES:
        if _has_price(row, table):
            found |= {column(table, of): total(row, table, of) for of in TOTALS}
    if found:
        found |= {f"term_{name}_j": joules for name, joules in terms(row, INT8).items()}
        found |= {column(INT8, of, True): total(row, INT8, of, True) for of in TOTALS}
    return found
