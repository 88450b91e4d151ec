"""Costs of an inference: spikes, operations, energy; means over the inferences of an episode.

sparsity             1 - spikes / (neurons x T), over the spiking layers; NeuroBench's activation
                     sparsity with one inference as the sample; none where a chip's neurons
                     spike several times in a timestep
spikes               of the spiking layers; input_spikes are those of the encoder
sops                 input spikes x non-zero fan-out, encoder into layer 1 included; bias_sops are
                     those of the always-on axon that carries the biases
effective_acs, effective_macs, dense
                     NeuroBench's synaptic operations: non-zero inputs x non-zero weights of every
                     weight matrix, counted as accumulates where all inputs are spikes and as
                     multiply-accumulates elsewhere; dense counts all inputs x all weights of the
                     file. The readout counts here, though it runs on the host; biases do not, and
                     an identity into the output, which connects and does not compute, neither
footprint, footprint_packed
                     NeuroBench's Footprint [bytes] of the file; the weights in the chip's bits
connection_sparsity  NeuroBench's, of the file
energy_j, latency_s  by each energy table, with an interval; latency as if one core did
                     everything
clock                how layers advance (runtime.convention.Clock), and whether that is assumed
control_steps_late   from an observation to the first and the last action that it reaches; None
                     where states are reset, and it reaches its own
energy_terms_j       by each table, then by term (runtime.metrics.energy_terms): those of the chip
                     add up to energy_j, or of a float network `operations` alone
energy_unknown       by each table, terms that happen and that nothing prices
energy_zero_skipping_j
                     of a float network that skips inputs of 0: effective_macs alone
messages_placed      messages on the cores that `check` gives to each layer
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.metrics.energy import (
    TABLES,
    EnergyEstimate,
    energy_estimate,
    event_counts,
    latency_estimate,
)
from spikedeploy.runtime.metrics.energy_terms import (
    priced_terms,
    unpriced,
)
from spikedeploy.runtime.metrics.neurobench import is_identity

# of networks without spikes
FLOAT_TABLES = tuple(name for name, table in TABLES.items() if "mac" in table.joules)


@dataclass(frozen=True)
class Costs:
    """Means per inference, as listed above; None where a kind of policy has no such cost."""

    sparsity: float | None = None
    spikes: float | None = None
    input_spikes: float | None = None
    sops: float | None = None
    bias_sops: float | None = None
    effective_acs: float | None = None
    effective_macs: float | None = None
    dense: float | None = None
    footprint: float | None = None
    footprint_packed: float | None = None
    connection_sparsity: float | None = None
    neuron_updates: float | None = None
    neuron_idle: float | None = None
    messages: float | None = None
    messages_placed: float | None = None
    saturations: int | None = None
    clock: str | None = None
    control_steps_late: tuple[int, int] | None = None
    energy_j: Mapping[str, EnergyEstimate] = field(default_factory=dict)
    latency_s: Mapping[str, EnergyEstimate] = field(default_factory=dict)
    energy_terms_j: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    energy_unknown: Mapping[str, Sequence[str]] = field(default_factory=dict)
    energy_zero_skipping_j: Mapping[str, float] = field(default_factory=dict)
    messages_placed_j: Mapping[str, float] = field(default_factory=dict)

    def total_j(self, table: str) -> float | None:
        """All known terms by a table [J]; None where it has none."""
        return sum(self.energy_terms_j[table].values()) if table in self.energy_terms_j else None


NOTHING = Costs(effective_acs=0.0, effective_macs=0.0, dense=0.0)
# what is no network that we can count, such as a script: its operations are the unknown
UNCOUNTED = Costs(energy_unknown={name: ("operations",) for name in TABLES})


def mean(costs: Sequence[Costs], weights: Sequence[int]) -> Costs:
    """Mean costs of several episodes, weighted by their inferences; saturations are summed."""

    def average(values: Sequence[float | None]) -> float | None:
        known = [value for value in values if value is not None]
        return float(np.average(known, weights=weights)) if len(known) == len(values) else None

    def each(name: str) -> list[Any]:
        return [getattr(c, name) for c in costs]

    saturations = [c.saturations for c in costs if c.saturations is not None]
    means: dict[str, Any] = {
        **{name: average(each(name)) for name in _MEANS},
        **{name: _by_table(each(name), weights, _estimate) for name in ("energy_j", "latency_s")},
        **{name: _by_table(each(name), weights, _number) for name in _NUMBERS},
    }
    terms, unknown = (
        _by_table(each("energy_terms_j"), weights, _by_term),
        _union(each("energy_unknown")),
    )
    return Costs(
        **means,
        saturations=sum(saturations) if saturations else None,
        clock=costs[0].clock,
        control_steps_late=costs[0].control_steps_late,
        energy_terms_j={
            table: {term: j for term, j in found.items() if term not in unknown[table]}
            for table, found in terms.items()
        },
        energy_unknown=unknown,
    )


def _by_table(
    prices: Sequence[Mapping[str, Any]],
    weights: Sequence[int],
    combine: Callable[[Sequence[Any], Sequence[int]], Any],
) -> dict[str, Any]:
    """Table -> what its entries combine to."""
    return {table: combine([price[table] for price in prices], weights) for table in prices[0]}


def _estimate(found: Sequence[EnergyEstimate], weights: Sequence[int]) -> EnergyEstimate:
    """Weighted mean of estimates and of their bounds."""
    bounds = [[each.value, each.low, each.high] for each in found]
    return EnergyEstimate(*np.average(bounds, axis=0, weights=weights).tolist())


def _number(found: Sequence[float], weights: Sequence[int]) -> float:
    return float(np.average(found, weights=weights))


def _by_term(found: Sequence[Mapping[str, float]], weights: Sequence[int]) -> dict[str, float]:
    """Term -> weighted mean; an episode in which a term is missing had none of it."""
    terms = dict.fromkeys(term for each in found for term in each)
    return {term: _number([each.get(term, 0.0) for each in found], weights) for term in terms}


def _union(named: Sequence[Mapping[str, Sequence[str]]]) -> dict[str, tuple[str, ...]]:
    """Table -> terms that some episode names."""
    return {
        table: tuple(dict.fromkeys(term for each in named for term in each[table]))
        for table in named[0]
    }


_NUMBERS = ("energy_zero_skipping_j", "messages_placed_j")
_MEANS = (
    "sparsity",
    "spikes",
    "input_spikes",
    "sops",
    "bias_sops",
    "effective_acs",
    "effective_macs",
    "dense",
    "footprint",
    "footprint_packed",
    "connection_sparsity",
    "neuron_updates",
    "neuron_idle",
    "messages",
    "messages_placed",
)


def spiking_costs(ledger: Ledger, program: Program, chip: Chip | None) -> Costs:
    """Costs of a spiking network from its ledger; `chip` None is the float twin."""
    counts = event_counts(ledger)
    return Costs(
        sparsity=ledger.sparsity,
        spikes=counts["spike_out"],
        input_spikes=_input_spikes(ledger, program) / ledger.inferences,
        sops=counts["sop"],
        bias_sops=counts["bias_sop"],
        effective_acs=counts["sop"] - counts["graded_sop"] + readout_acs(ledger, program),
        effective_macs=counts["graded_sop"] + readout_macs(ledger, program),
        neuron_updates=counts["neuron_update"],
        neuron_idle=counts["neuron_idle"],
        messages=counts["message"],
        saturations=ledger.total("saturation") if chip else None,
        clock=f"{ledger.clock}, assumed" if ledger.assumed_clock else ledger.clock,
        # by every table, so that a report can choose
        energy_j={name: energy_estimate(ledger, table) for name, table in TABLES.items()},
        latency_s={
            n: latency_estimate(ledger, table) for n, table in TABLES.items() if table.timed
        },
        energy_terms_j={name: priced_terms(counts, table) for name, table in TABLES.items()},
        energy_unknown={name: unpriced(counts, table) for name, table in TABLES.items()},
    )


def beside(found: Costs, terms: Mapping[str, Mapping[str, float | None]]) -> Costs:
    """The costs with further terms of each table, of which None is unknown."""
    known = {t: {n: j for n, j in each.items() if j is not None} for t, each in terms.items()}
    unknown = {t: [n for n, j in each.items() if j is None] for t, each in terms.items()}
    return replace(
        found,
        energy_terms_j={t: {**each, **known[t]} for t, each in found.energy_terms_j.items()},
        energy_unknown={t: (*each, *unknown[t]) for t, each in found.energy_unknown.items()},
    )


def message_energies(messages: float) -> dict[str, float]:
    """Table -> energy [J] of so many messages; tables without a price have none."""
    prices = {name: table.joules.get("message") for name, table in TABLES.items()}
    return {name: messages * price for name, price in prices.items() if price is not None}


def priced_by(chip: Chip | None) -> tuple[str, ...]:
    """The chip's own energy tables, and the one that a float network of its precision has too."""
    if chip is None or not chip.arithmetic.rounds:
        return ("horowitz45",)
    return (*chip.energy_tables, "horowitz45-int8")


def _input_spikes(ledger: Ledger, program: Program) -> int:
    """Spikes of the input, as the first layer received them."""
    first, sent = program.layers[0], ledger.by_layer("spike_out")
    others = sum(sent[s.source] for s in first.synapses if s.source != program.input)
    return ledger.by_layer("spike_in")[first.name] - others


def _readouts(program: Program) -> list[tuple[str, NDArray[np.float64]]]:
    """The layers that the host applies weights to, and those weights (N, act)."""
    return [(of, weight) for of, weight in program.readouts if not is_identity(weight)]


def readout_acs(ledger: Ledger, program: Program) -> float:
    """Accumulates of the host's readout; exact where all neurons have the same fan-out."""
    spikes = {**ledger.by_layer("spike_out"), program.input: _input_spikes(ledger, program)}
    taken = [(s.source, s.weight) for layer in program.host for s in layer.synapses]
    fan_outs = [
        (np.count_nonzero(weight, axis=1).mean(), of)
        for of, weight in (*_readouts(program), *taken)
        if of in spikes
    ]
    return float(sum(fan_out * spikes[of] for fan_out, of in fan_outs) / ledger.inferences)


def readout_macs(ledger: Ledger, program: Program) -> float:
    """Multiply-accumulates of the host with membranes; all other matrices take spikes."""
    graded = {layer.name for layer in (*program.layers, *program.host) if not layer.spiking}
    products = [np.count_nonzero(weight) for of, weight in _readouts(program) if of in graded]
    return float(sum(products) * ledger.timesteps / ledger.inferences)
