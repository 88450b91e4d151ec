"""Energies of a row of the pareto experiment per control step, term by term.

operations  synaptic operations, which multiply where a spike is graded, or multiply-accumulates
            with an input that is not 0
updates     neurons that were updated, and looked at
traffic     messages and spikes, where a table prices them
encoder     the delta encoder, or of a float network the reading of its observations
constants   the constant of each readout, added by the host, or the biases of a float network

A delta encoder takes for each observation that some synapse reads, and control step, a subtraction,
a comparison and the read of its level, and for each event an addition and the write of the level;
both kinds of policies read each observation that they use. Horowitz 2014, ISSCC, 45 nm: 0.1 pJ a
32-bit integer addition, 10 pJ an access of 64 bits of an 8 KB SRAM, of which 16 bits are a quarter.
No table of a chip has prices for what the host does, so these are the same in all.

The normalisation of observations folds into thresholds of the encoder and into weights, and tanh or
argmax is the same for all: neither is counted.
"""

from collections.abc import Mapping
from typing import Any

from spikedeploy.runtime.metrics.energy import multiplying
from spikedeploy.runtime.metrics.energy_tables import TABLES

_PICO = 1e-12
_ADDITION = 0.1 * _PICO  # 32-bit integers; a comparison is a subtraction
_ACCESS = 10 / 4 * _PICO  # 16 of 64 bits

TERMS = ("operations", "updates", "traffic", "encoder", "constants")
TOTALS = {
    "operations": ("operations",),
    "updates": ("operations", "updates"),
    "all": TERMS,
}
INT8 = "horowitz45-int8"
TABLE_NAMES = (INT8, "davies2018", "sanafe")

# two decays by a shift and a subtraction each, and the three additions of horowitz45-int8; states
# of 16 bits, two read and written
LEAN_UPDATE = 5 * _ADDITION + 4 * _ACCESS


def spikes(row: Mapping[str, Any]) -> bool:
    """Whether a row is of a spiking policy."""
    return row.get("neuron_updates") is not None


def priced(row: Mapping[str, Any], table: str) -> bool:
    """Whether a table has prices for a row: a float network needs one for multiply-accumulates.

    What a host integrates is not counted, so a row with readouts there has no price.
    """
    if row.get("operations") is None or row.get("on_host"):
        return False
    return spikes(row) or "mac" in TABLES[table].joules


def terms(row: Mapping[str, Any], table: str, lean: bool = False) -> dict[str, float]:
    """Energy [J] of each term in a control step.

    lean: neuron updates with states of 16 bits and decays by powers of two, derived; in tables of
        chips they cannot be chosen
    """
    prices = TABLES[table].joules

    def price(name: str) -> float:
        return prices.get(name, 0.0)

    host = TABLES[INT8].joules["sop"]  # an addition of a number that is fetched
    constants = row["constants"] * host
    reads = row["observations"] * _ACCESS
    if not spikes(row):
        return _named(row["operations"] * price("mac"), 0.0, 0.0, reads, constants)
    update = LEAN_UPDATE if lean else price("neuron_update")
    observed = row["observations"] * (2 * _ADDITION + _ACCESS)
    return _named(
        row["operations"] * price("sop")
        + (row.get("graded_operations") or 0.0) * multiplying(prices)
        + row["bias_operations"] * price("bias_sop"),
        row["neuron_updates"] * update + row["neuron_idle"] * price("neuron_idle"),
        row["messages"] * price("message") + row["spikes_out"] * price("spike_out"),
        reads + observed + row["events"] * (_ADDITION + _ACCESS),
        constants,
    )


def _named(*values: float) -> dict[str, float]:
    return dict(zip(TERMS, values, strict=True))


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
        if priced(row, table):
            found |= {column(table, of): total(row, table, of) for of in TOTALS}
    if priced(row, INT8):
        found |= {f"term_{name}_j": joules for name, joules in terms(row, INT8).items()}
        found |= {column(INT8, of, True): total(row, INT8, of, True) for of in TOTALS}
    return found
