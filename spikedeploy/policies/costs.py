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
                     multiply-accumulates elsewhere; dense counts all inputs x all weights. The
                     readout counts here, though it runs on the host; biases do not
footprint, footprint_packed
                     NeuroBench's Footprint [bytes] of the file; the weights in the chip's bits
connection_sparsity  NeuroBench's, of the file
energy_j, latency_s  by each energy table, with an interval; latency as if one core did
                     everything
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.metrics.energy import (
    TABLES,
    EnergyEstimate,
    energy_estimate,
    latency_estimate,
)


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
    saturations: int | None = None
    energy_j: Mapping[str, EnergyEstimate] = field(default_factory=dict)
    latency_s: Mapping[str, EnergyEstimate] = field(default_factory=dict)


NOTHING = Costs(effective_acs=0.0, effective_macs=0.0, dense=0.0)


def mean(costs: Sequence[Costs], weights: Sequence[int]) -> Costs:
    """Mean costs of several episodes, weighted by their inferences; saturations are summed."""

    def average(values: Sequence[float | None]) -> float | None:
        known = [value for value in values if value is not None]
        return float(np.average(known, weights=weights)) if len(known) == len(values) else None

    saturations = [c.saturations for c in costs if c.saturations is not None]
    return Costs(
        **{name: average([getattr(c, name) for c in costs]) for name in _MEANS},
        saturations=sum(saturations) if saturations else None,
        energy_j=_by_table([c.energy_j for c in costs], weights),
        latency_s=_by_table([c.latency_s for c in costs], weights),
    )


def _by_table(
    prices: Sequence[Mapping[str, EnergyEstimate]], weights: Sequence[int]
) -> dict[str, EnergyEstimate]:
    """Table -> weighted mean of its estimates and of their bounds."""
    found = {}
    for table in prices[0]:
        of = [price[table] for price in prices]
        bounds = [[each.value, each.low, each.high] for each in of]
        found[table] = EnergyEstimate(*np.average(bounds, axis=0, weights=weights).tolist())
    return found


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
)


def spiking_costs(ledger: Ledger, program: Program, chip: Chip | None) -> Costs:
    """Costs of a spiking network from its ledger; `chip` None is the float twin."""
    sops, graded = ledger.per_inference("sop"), ledger.per_inference("graded_sop")
    return Costs(
        sparsity=ledger.sparsity,
        spikes=ledger.per_inference("spike_out"),
        input_spikes=_input_spikes(ledger, program) / ledger.inferences,
        sops=sops,
        bias_sops=ledger.per_inference("bias_sop"),
        effective_acs=sops - graded + _readout_acs(ledger, program),
        effective_macs=graded + _readout_macs(ledger, program),
        dense=_weights(program) * ledger.timesteps / ledger.inferences,
        saturations=ledger.total("saturation") if chip else None,
        # by every table, so that a report can choose
        energy_j={name: energy_estimate(ledger, table) for name, table in TABLES.items()},
        latency_s={
            n: latency_estimate(ledger, table) for n, table in TABLES.items() if table.timed
        },
    )


def priced_by(chip: Chip | None) -> tuple[str, ...]:
    """The chip's own energy tables, and the one that a float network of its precision has too."""
    if chip is None or not chip.arithmetic.rounds:
        return ("horowitz45",)
    return (*chip.energy_tables, "horowitz45-int8")


def _input_spikes(ledger: Ledger, program: Program) -> int:
    """Spikes of the input, as the first layer received them."""
    return ledger.by_layer("spike_in")[program.layers[0].name]


def _weights(program: Program) -> int:
    """All weights of all matrices, zeros and the readout included."""
    layers = (*program.layers, *program.host)
    weights = [s.weight.size for layer in layers for s in layer.synapses]
    return sum(weights) + sum(weight.size for _, weight in program.readouts)


def _readout_acs(ledger: Ledger, program: Program) -> float:
    """Accumulates of the host's readout; exact where all neurons have the same fan-out."""
    spikes = {**ledger.by_layer("spike_out"), program.input: _input_spikes(ledger, program)}
    taken = [(s.source, s.weight) for layer in program.host for s in layer.synapses]
    fan_outs = [
        (np.count_nonzero(weight, axis=1).mean(), of)
        for of, weight in (*program.readouts, *taken)
        if of in spikes
    ]
    return float(sum(fan_out * spikes[of] for fan_out, of in fan_outs) / ledger.inferences)


def _readout_macs(ledger: Ledger, program: Program) -> float:
    """Multiply-accumulates of the host with membranes; all other matrices take spikes."""
    graded = {layer.name for layer in (*program.layers, *program.host) if not layer.spiking}
    products = [np.count_nonzero(weight) for of, weight in program.readouts if of in graded]
    return float(sum(products) * ledger.timesteps / ledger.inferences)
