"""Energy and time of a ledger's events, by published tables of prices.

No table includes transferring observations and actions, and none but `truenorth` static power: use
them to compare networks, not to size batteries.
"""

import difflib
import math
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
    """An energy or time, and the interval in which it lies.

    value: [J] or [s].
    low, high: likewise; 0 and infinity where nothing bounds it.
    """

    value: float
    low: float
    high: float


def energy_table(name: str) -> EnergyTable:
    """The table called `name`; ConfigError where there is none."""
    if name not in TABLES:
        close = difflib.get_close_matches(name, TABLES, n=1)
        hint = f"; did you mean {close[0]!r}" if close else ""
        raise ConfigError(f"there is no energy table {name!r}{hint}. Known: {', '.join(TABLES)}.")
    return TABLES[name]


def checked_table_names(names: Iterable[str]) -> tuple[str, ...]:
    """The names without repetition; ConfigError where one is of no table."""
    return tuple(dict.fromkeys(energy_table(name).name for name in names))


def describe_table(table: EnergyTable) -> str:
    """One line to print with every number of the table: its source, and how certain it is."""
    why = table.uncertainty.why
    return f"{table.source}: {table.provenance}. Energies: {describe_certainty(table)} ({why})"


def describe_certainty(table: EnergyTable) -> str:
    """How far the energies of the table may be from the truth, in a few words."""
    if table.least:
        return f"{table.uncertainty.describe()}, of {' and '.join(_in_order(table.least))} alone"
    return "between two figures" if table.upper_joules else table.uncertainty.describe()


def _in_order(events: Iterable[str]) -> list[str]:
    """Without the biases' operations, which are priced like the others."""
    return sorted(set(events) - {"bias_sop"})


def energy(ledger: Ledger, table: EnergyTable, traffic: Traffic | None = None) -> float:
    """Energy of an inference [J].

    traffic: of all inferences, between placed cores; replaces the ledger's count of messages.
    """
    return _cost(ledger, table.joules, traffic)


def energy_estimate(
    ledger: Ledger, table: EnergyTable, traffic: Traffic | None = None
) -> EnergyEstimate:
    """Energy of an inference [J], with its interval; arguments as for `energy`."""
    joules = energy(ledger, table, traffic)
    upper = _cost(ledger, {**table.joules, **table.upper_joules}, traffic)
    low = joules * table.uncertainty.low if bounds(_counts(ledger, traffic), table) else 0.0
    return EnergyEstimate(joules, low, _most(upper, table))


def bounds(counts: Mapping[str, float], table: EnergyTable) -> bool:
    """Whether the lower end of the table's uncertainty holds for these counts of events.

    Where only some prices are the smallest of their process, nothing else may be added up.
    """
    priced = {event for event, count in counts.items() if count and event in table.joules}
    return not table.least or priced <= table.least


def static_energy(seconds: float, power: StaticPower) -> float:
    """Energy [J] of a network's share of a static power over a time [s]."""
    return seconds * power.watts * power.share


def event_counts(ledger: Ledger) -> dict[str, float]:
    """Mean counts of an inference by event; updates of neurons with one state are named apart too.

    `one_state_update` counts some of `neuron_update`.
    """
    counts = {event: ledger.per_inference(event) for event in EVENTS}
    updates = ledger.by_layer("neuron_update")
    alone = sum(updates[name] for name in ledger.one_state)
    return {**counts, "one_state_update": alone / max(ledger.inferences, 1)}


def _counts(ledger: Ledger, traffic: Traffic | None) -> dict[str, float]:
    counts = event_counts(ledger)
    if traffic is not None:
        inferences = max(ledger.inferences, 1)
        counts |= {f.name: getattr(traffic, f.name) / inferences for f in fields(traffic)}
    return counts


def _cost(ledger: Ledger, prices: Mapping[str, float], traffic: Traffic | None) -> float:
    # E = sum over events of count * price
    marginal = marginal_prices(prices)
    counts = _counts(ledger, traffic)
    return sum(count * marginal.get(event, 0.0) for event, count in counts.items())


def marginal_prices(prices: Mapping[str, float]) -> dict[str, float]:
    """Prices [J] that add up: of events that others count too, what they cost more or less."""
    found = {**prices, "graded_sop": multiplying(prices)}
    whole = prices.get("neuron_update", 0.0)
    return found | {"one_state_update": prices.get("one_state_update", whole) - whole}


def multiplying(prices: Mapping[str, float]) -> float:
    """What a synaptic operation costs more where it multiplies [J]: then it is a MAC, if priced."""
    whole = prices.get("graded_sop", prices.get("mac"))
    return 0.0 if whole is None else whole - prices.get("sop", 0.0)


def mac_energy(macs: float, table: EnergyTable) -> float:
    """Energy [J] of an inference without spikes, from its multiply-accumulates.

    Raises ConfigError where the table has no price for them.
    """
    if "mac" not in table.joules:
        raise ConfigError(
            f"energy table {table.name!r} has no price for multiply-accumulates. "
            f"Choose one of {', '.join(n for n, t in TABLES.items() if 'mac' in t.joules)}."
        )
    return macs * table.joules["mac"]


def mac_energy_estimate(macs: float, table: EnergyTable) -> EnergyEstimate:
    """The same [J], with its interval."""
    joules = mac_energy(macs, table)
    low = joules * table.uncertainty.low if bounds({"mac": macs}, table) else 0.0
    return EnergyEstimate(joules, low, _most(joules, table))


def _most(joules: float, table: EnergyTable) -> float:
    """Upper end of an estimate [J]: infinity where nothing bounds it, of nothing too."""
    factor = table.uncertainty.high
    return factor if math.isinf(factor) else joules * factor


def latency(ledger: Ledger, table: EnergyTable) -> float:
    """Time of an inference [s], as if one core processed every event one after another.

    An upper bound for a network on one core: SANA-FE, which overlaps messages with synaptic
    operations, is 8 % lower on its own example. On many cores a network runs at best as many times
    faster. Raises ConfigError where the table has no times.
    """
    if not table.timed:
        timed = ", ".join(name for name, each in TABLES.items() if each.timed)
        raise ConfigError(f"energy table {table.name!r} has no times. Choose one of {timed}.")
    serial = sum(ledger.per_inference(e) * table.seconds.get(e, 0.0) for e in EVENTS)
    return serial + table.step * ledger.steps / max(ledger.inferences, 1)


def latency_estimate(ledger: Ledger, table: EnergyTable) -> EnergyEstimate:
    """Time of an inference [s], with its interval."""
    seconds, factor = latency(ledger, table), table.time_uncertainty
    return EnergyEstimate(seconds, seconds * factor.low, seconds * factor.high)
