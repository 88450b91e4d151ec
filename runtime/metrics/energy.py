"""Energy and time: what the events of a ledger cost, by tables of which each says its source.

None of the tables knows of getting observations in and actions out, and none but `truenorth` of
static power: they are for comparing networks, not for choosing batteries.
"""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metrics.energy_tables import (
    STATIC,
    TABLES,
    EnergyTable,
    StaticPower,
    Uncertainty,
)
from spikedeploy.runtime.metrics.traffic import Traffic

__all__ = ["STATIC", "TABLES", "EnergyEstimate", "EnergyTable", "StaticPower", "Uncertainty"]


@dataclass(frozen=True)
class EnergyEstimate:
    """A number, and the interval that it lies in.

    value: [J] or [s].
    low, high: likewise; 0 and infinity where nothing bounds it.
    """

    value: float
    low: float
    high: float


def energy_table(name: str) -> EnergyTable:
    """The table called `name`."""
    if name not in TABLES:
        close = difflib.get_close_matches(name, TABLES, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise ConfigError(f"there is no energy table {name!r}{hint}. Known: {', '.join(TABLES)}.")
    return TABLES[name]


def energy_tables(names: Iterable[str]) -> tuple[str, ...]:
    """The names, each of a table that exists, each once."""
    return tuple(dict.fromkeys(energy_table(name).name for name in names))


def described(table: EnergyTable) -> str:
    """A line that belongs to every number of the table: its source, and how sure it is."""
    why = table.uncertainty.why
    return f"{table.source}: {table.provenance}. Energies: {certainty(table)} ({why})"


def certainty(table: EnergyTable) -> str:
    """How far off the energies of the table may be, in a few words."""
    return "between two figures" if table.most else table.uncertainty.describe()


def energy(ledger: Ledger, table: EnergyTable, traffic: Traffic | None = None) -> float:
    """[J] per inference.

    traffic: of all inferences, instead of the ledger's messages: between cores that are placed.
    """
    return _priced(ledger, table.joules, traffic)


def energy_estimate(
    ledger: Ledger, table: EnergyTable, traffic: Traffic | None = None
) -> EnergyEstimate:
    """[J] per inference, and between what it lies."""
    joules = energy(ledger, table, traffic)
    most = _priced(ledger, {**table.joules, **table.most}, traffic)
    return EnergyEstimate(joules, joules * table.uncertainty.low, most * table.uncertainty.high)


def static_energy(seconds: float, power: StaticPower) -> float:
    """[J] that a chip draws besides, in so many seconds."""
    return seconds * power.watts


def _priced(ledger: Ledger, prices: Mapping[str, float], traffic: Traffic | None) -> float:
    # E = sum over events of count * price
    counts = {event: ledger.per_inference(event) for event in EVENTS}
    if traffic is not None:
        inferences = max(ledger.inferences, 1)
        counts |= {f.name: getattr(traffic, f.name) / inferences for f in fields(traffic)}
    return sum(count * prices.get(event, 0.0) for event, count in counts.items())


def mac_energy(macs: float, table: EnergyTable) -> float:
    """[J] of one inference of a network without spikes, with so many multiply-accumulates."""
    if "mac" not in table.joules:
        raise ConfigError(
            f"energy table {table.name!r} has no price for multiply-accumulates. "
            f"Choose one of {', '.join(n for n, t in TABLES.items() if 'mac' in t.joules)}."
        )
    return macs * table.joules["mac"]


def mac_estimate(macs: float, table: EnergyTable) -> EnergyEstimate:
    """[J] likewise, and between what it lies."""
    joules, off = mac_energy(macs, table), table.uncertainty
    return EnergyEstimate(joules, joules * off.low, joules * off.high)


def latency(ledger: Ledger, table: EnergyTable) -> float:
    """[s] per inference, as if one core did everything, one event after another.

    An upper bound for a network of one core: SANA-FE, which overlaps messages with synapses, comes
    out 8 % lower on its own example. Networks on many cores run as many times faster at best.
    """
    if not table.timed:
        timed = ", ".join(name for name, each in TABLES.items() if each.timed)
        raise ConfigError(f"energy table {table.name!r} has no times. Choose one of {timed}.")
    serial = sum(ledger.per_inference(e) * table.seconds.get(e, 0.0) for e in EVENTS)
    return serial + table.step * ledger.steps / max(ledger.inferences, 1)


def latency_estimate(ledger: Ledger, table: EnergyTable) -> EnergyEstimate:
    """[s] per inference, and between what it lies."""
    seconds, off = latency(ledger, table), table.time_uncertainty
    return EnergyEstimate(seconds, seconds * off.low, seconds * off.high)
