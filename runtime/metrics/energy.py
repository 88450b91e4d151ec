"""Energy and time of a ledger's events by published tables of prices, term by term.

No table includes transferring observations and actions, and none but `truenorth` static power: use
them to compare networks, not to size batteries.

The terms of an inference, on the chip and on its host:

operations: synaptic operations, which multiply where a spike is graded; in a float network
    multiply-accumulates.
bias: the always-on axon that carries the biases; in a float network the addition of each.
updates: neurons with something to add up.
idle: neurons that a chip only checks.
messages: packets between layers, and to the host.
spikes: cost of sending a spike, where a table prices it separately.
encoder: numbers to spikes; in a float network reading its observations.
readout: weights and constants that the host applies to the output of the chip.
resets: states that are set to 0 between inferences.
activations: units of a float network that are written and read between its layers.

The host's work (`encoder`, `readout`) has the same prices beside every table, as no table of a chip
has any: those of Horowitz 2014 in `energy_tables`. The counts of these operations are derived lower
bounds. The normalisation of observations folds into thresholds and
weights, and tanh or argmax is the same for all policies: neither is counted.
"""

import difflib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metrics.energy_tables import TABLES, EnergyTable, StaticPower


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


def _check_price(table: EnergyTable, event: str) -> None:
    """Raise ConfigError where a table has no price of an event."""
    if event not in table.joules:
        known = [name for name, each in TABLES.items() if event in each.joules]
        raise ConfigError(
            f"energy table {table.name!r} has no price for {event!r}. "
            f"Choose one of {', '.join(known)}."
        )


# the energy and time of a ledger


def event_counts(ledger: Ledger) -> dict[str, float]:
    """Mean counts of an inference by event; updates of neurons with one state are named apart too.

    `one_state_update` counts some of `neuron_update`.
    """
    counts = {event: ledger.per_inference(event) for event in EVENTS}
    updates = ledger.by_layer("neuron_update")
    alone = sum(updates[name] for name in ledger.one_state)
    return {**counts, "one_state_update": alone / max(ledger.inferences, 1)}


def energy(ledger: Ledger, table: EnergyTable) -> float:
    """Energy of an inference [J]."""
    return cost(event_counts(ledger), table.joules)


def energy_estimate(ledger: Ledger, table: EnergyTable) -> EnergyEstimate:
    """Energy of an inference [J], with its interval."""
    return _estimate(event_counts(ledger), table)


def mac_energy(macs: float, table: EnergyTable) -> float:
    """Energy [J] of an inference without spikes, from its multiply-accumulates.

    Raises ConfigError where the table has no price for them.
    """
    _check_price(table, "mac")
    return macs * table.joules["mac"]


def mac_energy_estimate(macs: float, table: EnergyTable) -> EnergyEstimate:
    """Return `mac_energy` [J] with its interval."""
    _check_price(table, "mac")
    return _estimate({"mac": macs}, table)


def static_energy(seconds: float, power: StaticPower) -> float:
    """Energy [J] of a network's share of a static power over a time [s]."""
    return seconds * power.watts * power.share


def latency_estimate(ledger: Ledger, table: EnergyTable) -> EnergyEstimate:
    """Time of an inference [s], as if one core processed every event one after another.

    An upper bound for a network on one core: SANA-FE, which overlaps messages with synaptic
    operations, is 8 % lower on its own example. On many cores a network runs at best as many times
    faster. Raises ConfigError where the table has no times.
    """
    if not table.timed:
        timed = ", ".join(name for name, each in TABLES.items() if each.timed)
        raise ConfigError(f"energy table {table.name!r} has no times. Choose one of {timed}.")
    serial = sum(ledger.per_inference(e) * table.seconds.get(e, 0.0) for e in EVENTS)
    seconds = serial + table.step * ledger.steps / max(ledger.inferences, 1)
    factor = table.time_uncertainty
    return EnergyEstimate(seconds, seconds * factor.low, seconds * factor.high)


def cost(counts: Mapping[str, float], prices: Mapping[str, float]) -> float:
    """Return the energy [J] of counted events at these prices [J]."""
    # E = sum over events of count * price
    marginal = _marginal_prices(prices)
    return sum(count * marginal.get(event, 0.0) for event, count in counts.items())


def _marginal_prices(prices: Mapping[str, float]) -> dict[str, float]:
    """Prices [J] that add up: of events that others count too, what they cost more or less."""
    # a synaptic operation that multiplies is a MAC, where that is priced
    graded = prices.get("graded_sop", prices.get("mac"))
    update = prices.get("neuron_update", 0.0)
    return {
        **prices,
        "graded_sop": 0.0 if graded is None else graded - prices.get("sop", 0.0),
        "one_state_update": prices.get("one_state_update", update) - update,
    }


def _estimate(counts: Mapping[str, float], table: EnergyTable) -> EnergyEstimate:
    joules, bounds = cost(counts, table.joules), table.uncertainty
    # where only some prices are the least of their process, nothing else may be added up
    priced = {event for event, count in counts.items() if count and event in table.joules}
    low = joules * bounds.low if not table.least or priced <= table.least else 0.0
    if math.isinf(bounds.high):
        return EnergyEstimate(joules, low, math.inf)
    upper = cost(counts, {**table.joules, **table.upper_joules})
    return EnergyEstimate(joules, low, upper * bounds.high)


# terms of the chip

_EVENTS = {
    "operations": ("sop", "graded_sop"),
    "bias": ("bias_sop",),
    "updates": ("neuron_update", "one_state_update"),
    "idle": ("neuron_idle",),
    "messages": ("message",),
    "spikes": ("spike_out",),
}
ON_CHIP = tuple(_EVENTS)


def priced_terms(counts: Mapping[str, float], table: EnergyTable) -> dict[str, float]:
    """Energy [J] of each term of the chip, without those that are unknown or in another price.

    counts: of events in an inference, as from `event_counts`.
    """
    prices = _marginal_prices(table.joules)
    left_out = (*unpriced_terms(counts, table), *table.included)
    return {
        term: sum(counts.get(event, 0.0) * prices.get(event, 0.0) for event in events)
        for term, events in _EVENTS.items()
        if term not in left_out
    }


def unpriced_terms(counts: Mapping[str, float], table: EnergyTable) -> tuple[str, ...]:
    """Terms of the chip that happened and have no price, neither their own nor within another."""
    return tuple(
        term
        for term, (event, *_) in _EVENTS.items()
        if counts.get(event, 0.0) > 0 and event not in table.joules and term not in table.included
    )


# terms of the host, by Horowitz 2014 (energy_tables.toml) [J]

ADDITION, MULTIPLICATION = 0.1e-12, 3.1e-12  # of 32-bit integers; a comparison subtracts
INSTRUCTION = 70e-12  # of a simple processor, its cache and registers included


def sram(bits: int) -> float:
    """Energy [J] of reading or writing a word in an SRAM of 8 KB: 10 pJ for 64 bits."""
    return 10e-12 * bits / 64


_ACCESS = sram(16)
_FETCHED_ADDITION = TABLES["horowitz45-int8"].joules["sop"]
_FETCHED_MAC = TABLES["horowitz45-int8"].joules["mac"]


def reading_energy(observations: float) -> float:
    """Return the energy [J] of reading some observations once."""
    return observations * _ACCESS


def delta_encoder(observations: float, events: float, timesteps: int = 1) -> float:
    """Energy [J] of a delta encoder in an inference.

    For each observation its reading; in each timestep a subtraction, a comparison and the read of
    its level; for each event an addition and the write of the level.

    observations: that some synapse reads.
    """
    observed = observations * timesteps * (2 * ADDITION + _ACCESS)
    return reading_energy(observations) + observed + events * (ADDITION + _ACCESS)


def rate_encoder(observations: float, timesteps: int) -> float:
    """Energy [J] of a regular rate encoder in an inference.

    For each observation its reading, a multiplication and an addition that scale it to a rate; in
    each timestep an addition, and the accumulator read and written.
    """
    scaled = observations * (MULTIPLICATION + ADDITION)
    counted = observations * timesteps * (ADDITION + 2 * _ACCESS)
    return reading_energy(observations) + scaled + counted


def addition_energy(constants: float) -> float:
    """Energy [J] of adding so many constants, each of them fetched."""
    return constants * _FETCHED_ADDITION


def host_readout(additions: float, products: float, constants: float) -> float:
    """Energy [J] of a readout that the host applies: weights added or multiplied, and constants."""
    return addition_energy(additions) + products * _FETCHED_MAC + addition_energy(constants)


def reset_energy(states: float, table: EnergyTable) -> float | None:
    """Energy [J] of setting so many states to 0: a write each; None where nothing prices it.

    Derived where a table prices memory; what it takes on a chip is not published.
    """
    if not states:
        return 0.0
    return states * table.joules["state_write"] if "state_write" in table.joules else None


# break-even with a float network. Both by the same table, which has prices for synaptic operations
# and multiply-accumulates

BREAK_EVEN_TABLES = tuple(n for n, t in TABLES.items() if {"sop", "mac"} <= t.joules.keys())


def break_even_sops(
    terms: Mapping[str, float], sops: float, total: float, table: EnergyTable
) -> float:
    """Synaptic operations of an inference at which a spiking policy would cost `total` [J].

    Everything else of it stays as it is; below 0 where that alone costs more.

    terms: of the policy [J].
    sops: of it; where some multiply, the mean price stays.
    """
    operations = terms["operations"]
    price = operations / sops if sops and operations else table.joules["sop"]
    return (total - (sum(terms.values()) - operations)) / price


# time of an inference on Xylo: clock cycles of its core, by rockpool's model. There is no energy:
# for Xylo only the power of whole tasks is published, none of an operation

# [clock cycles] rockpool 3.1, devices/xylo/syns61201 cycles_model; the same for all Xylos
_INPUT_LOOP = 3.5
_HIDDEN_UPDATE = 7
_OUTPUT_UPDATE = 8
_HIDDEN_FIXED = 19
_OUTPUT_FIXED = 12
_CLOCK = 50e6  # [Hz] rockpool's default for the core
_MARGIN = 0.2  # safety margin of rockpool


def xylo_time(
    program: Program, spikes: Mapping[str, NDArray[Any]], clock: float = _CLOCK
) -> EnergyEstimate:
    """Time of an inference [s], up to that with rockpool's margin.

    spikes: (B, T, N) of the input and of each layer.
    clock: [Hz] frequency of the core.
    """
    timesteps = spikes[program.input].shape[1]
    seconds = timesteps * xylo_clocks(program, spikes) / clock
    return EnergyEstimate(seconds, seconds, seconds * (1 + _MARGIN))


def xylo_clocks(program: Program, spikes: Mapping[str, NDArray[Any]]) -> float:
    """Mean clock cycles of a timestep; several events of a neuron cost as much as one.

    spikes: (B, T, N) of the input and of each layer.
    """
    outputs = program.layer(program.output).size
    rates = {name: float(np.count_nonzero(rows) / rows.size) for name, rows in spikes.items()}
    clocks = float(_OUTPUT_FIXED * outputs)
    for layer in program.layers:
        if layer.name == program.output:
            continue
        rate = rates[layer.name]
        # in = Nin (3.5 p_in N + 1)      out = N p (1 + 8 Nout)
        clocks += program.width * (_INPUT_LOOP * rates[program.input] * layer.size + 1)
        clocks += layer.size * rate * (1 + _OUTPUT_UPDATE * outputs)
        clocks += layer.size * _hidden_clocks(layer, rate)
    return clocks


def _hidden_clocks(layer: Layer, rate: float) -> float:
    loops = [s for s in layer.synapses if s.source == layer.name and s.current == 0]
    fan_out = sum(float(synapses.fan_out.mean()) for synapses in loops)
    # aliases of a neuron, and neurons that have it as an alias: the same on average
    alias = sum(map(len, layer.aliases)) / layer.size
    both = alias * alias
    spiking = 2 * max(rate, both) + 3 * max(rate * alias, both) + rate + max(rate, alias) * alias
    return _HIDDEN_UPDATE * fan_out * rate + 3 + _HIDDEN_FIXED + spiking


# name, as arithmetics give it -> [s] of an inference
TIME_MODELS: dict[str, Callable[[Program, Mapping[str, NDArray[Any]]], EnergyEstimate]] = {
    "xylo-clocks": xylo_time
}
