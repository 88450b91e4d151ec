"""What an inference costs: spikes, operations, energy; a mean over the inferences of an episode.

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
energy_j, latency_s  by each table that prices the events, with the interval that it lies in;
                     latency as if one core did everything
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from runtime.energy import Estimate


@dataclass(frozen=True)
class Costs:
    """Means per inference; None where a kind of policy has no such thing."""

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
    energy_j: Mapping[str, Estimate] = field(default_factory=dict)
    latency_s: Mapping[str, Estimate] = field(default_factory=dict)


NOTHING = Costs(effective_acs=0.0, effective_macs=0.0, dense=0.0)


def mean(costs: Sequence[Costs], weights: Sequence[int]) -> Costs:
    """The costs of several episodes, weighted by their inferences; saturations are summed."""

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
    prices: Sequence[Mapping[str, Estimate]], weights: Sequence[int]
) -> dict[str, Estimate]:
    """The weighted mean of each table's price, and of its bounds."""
    found = {}
    for table in prices[0]:
        of = [price[table] for price in prices]
        bounds = [[each.value, each.low, each.high] for each in of]
        found[table] = Estimate(*np.average(bounds, axis=0, weights=weights).tolist())
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
