"""The verdict on energy: counts of a comparison beside published borders and static power.

The published borders weigh synapses: Davidson and Furber 2021 (Frontiers in Neuroscience 15:651141)
find that a rate code costs less below 1.72 spikes a synapse and inference, Dampfhoffer et al. 2023
(IEEE TETCI 7(3):731) below 0.15 to 1.38, for neurons without leak. Where hidden layers are narrow
and events rare, updates of neurons decide instead, and a third rule has them: a network of M
synapses, SOPs and updates U costs less than a float network of its shape, of whose inputs a share
d is not 0, where

    SOPs e_sop + U e_update < d M e_mac
"""

from collections.abc import Sequence

from spikedeploy.reports.summary import main_row, smallest_baseline
from spikedeploy.reports.table import COMMON_TABLE, Row, format_si
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.metrics.energy_tables import STATIC, TABLES

_IN_MEMORY = "horowitz45-int8-acc32"
DAVIDSON, DAMPFHOFFER = 1.72, (0.15, 1.38)  # spikes of a synapse in an inference


def energy_verdict(rows: Sequence[Row]) -> str:
    """Sentences on the row that a page is about; empty where it does not spike on a chip."""
    row = main_row(rows)
    if row["kind"] != "snn" or row["chip"] in (None, "float"):
        return ""
    return " ".join(filter(None, (_borders(row), _beside(row, rows), static_power(row))))


def _borders(row: Row) -> str:
    """Spikes of a synapse, beside the borders of others and the rule with updates."""
    synapses, sops = row.get("synapses"), row["sops_per_inference"]
    updates = row["neuron_updates_per_inference"]
    if not synapses or sops is None or updates is None:
        return ""
    registers, memory = (_share_of_dense(row, name) for name in (COMMON_TABLE, _IN_MEMORY))
    density = sops / synapses
    low, high = DAMPFHOFFER
    if density < low:
        place = f"below published borders of {low} to {DAVIDSON}"
    elif density > DAVIDSON:
        place = f"above published borders of {low} to {DAVIDSON}"
    else:
        place = f"within published borders, {low} to {high} and {DAVIDSON}"
    return (
        f"A synapse of {row['policy']} receives {density:.2g} spikes a control step, {place} "
        "(Dampfhoffer et al. 2023, Davidson and Furber 2021), which leave out updates of neurons. "
        f"With updates, {row['policy']} takes {registers:.0%} of the energy of a dense float "
        f"network of its shape by {COMMON_TABLE}, which has sums in registers, and {memory:.0%} "
        f"with sums in memory ({_IN_MEMORY}). A float network that skips inputs of 0 takes less "
        "where fewer of its inputs than that are not 0."
    )


def _share_of_dense(row: Row, table: str) -> float:
    """Energy of synapses and updates over that of all multiply-accumulates of the same shape."""
    prices = TABLES[table].joules
    updates = row["neuron_updates_per_inference"] * prices["neuron_update"]
    spent = row["sops_per_inference"] * prices["sop"] + updates
    return float(spent / (row["synapses"] * prices["mac"]))


def _beside(row: Row, rows: Sequence[Row]) -> str:
    """All known terms, beside those of the smallest float policy that is as good."""
    spent = row["energy_total_j"].get(COMMON_TABLE)
    other = smallest_baseline(row, rows) if "returns" in row else None
    dense = other["energy_total_j"].get(COMMON_TABLE) if other else None
    if not spent or not other or not dense:
        return ""
    computed = other["energy_per_inference_j"][COMMON_TABLE]
    beside = dense - computed + other["energy_zero_skipping_j"].get(COMMON_TABLE, computed)
    ratio = spent / beside
    times = f"{ratio:.1f} times" if ratio >= 1 else f"{ratio:.0%} of"
    skips = ", which skips inputs of 0" if beside < dense else ""
    return (
        f"By {COMMON_TABLE} all its known terms are {format_si(spent)}J, {times} the "
        f"{format_si(beside)}J of {other['policy']}{skips}."
    )


def static_power(row: Row) -> str:
    """Idle energy of the chip in a control step, over all that is known of a policy.

    By the chip's own prices, each of its tables; by the common one where it has none.
    """
    if not row["static_energy_j"]:
        return ""
    on, totals = chip(row["chip"]), row["energy_total_j"]
    tables = [table for table in on.energy_tables if totals.get(table)]
    if not tables and totals.get(COMMON_TABLE):
        tables = [COMMON_TABLE]
    if not tables:
        return ""
    first, joules = min(row["static_energy_j"].items(), key=lambda each: each[1])
    power = next(p for p in STATIC[on.name] if p.name == first)
    times = [_magnitude(joules / totals[table]) for table in tables]
    times[0] += f" all known terms of {row['policy']}"
    beside = " and ".join(f"{n} by {table}" for n, table in zip(times, tables, strict=True))
    why = "" if on.energy_tables else f", as no prices of {on.name} are published"
    return (
        f"Static power comes on top: {on.name} idles at "
        f"{format_si(power.watts * power.share)}W ({power.source}), {format_si(joules)}J in a "
        f"control step, {beside}{why}."
    )


def _magnitude(ratio: float) -> str:
    if ratio >= 1e5:
        return f"{ratio / 1e6:,.2g} million times"
    return f"{ratio:,.0f} times" if ratio >= 2 else f"{ratio:.2g} times"
