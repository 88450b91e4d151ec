"""The ledger: what a chip did, counted, so that any table of energies can price it afterwards."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Program

Counts = NDArray[np.int64]

EVENTS = (
    "spike_in",  # spikes sent to a layer
    "sop",  # synaptic operations: the non-zero fan-out of those spikes
    "bias_sop",  # synaptic operations of the always-on bias axon
    "neuron_update",  # neuron-timesteps with a membrane, a current or a bias to add up
    "neuron_idle",  # neuron-timesteps without; a chip still looks at the neuron
    "spike_out",  # spikes that a layer emits
    "message",  # packets to a layer: spikes, the bias axon's; and from the last one to the host
    "saturation",  # numbers that did not fit the accumulator, a current or a membrane
)


@dataclass(frozen=True, eq=False)
class Ledger:
    """Counts of events.

    layers: names, L.
    neurons: of each layer.
    counts: (S, L, E) per control step; E as in EVENTS. One row when only totals are kept.
    inferences: how many the rows sum up.
    timesteps: network updates of each layer in all of them.
    steps: chip timesteps in all of them, those that only fill the pipeline included.
    several: whether a neuron can spike several times in a timestep.
    """

    layers: tuple[str, ...]
    neurons: tuple[int, ...]
    counts: Counts
    inferences: int
    timesteps: int
    steps: int
    several: bool = False

    def total(self, event: str) -> int:
        """All events of a kind, over steps and layers."""
        return int(self.counts[:, :, EVENTS.index(event)].sum())

    def per_inference(self, event: str) -> float:
        """Mean number of events of a kind in an inference."""
        return self.total(event) / max(self.inferences, 1)

    def by_layer(self, event: str) -> dict[str, int]:
        """All events of a kind, of each layer."""
        totals = self.counts[:, :, EVENTS.index(event)].sum(axis=0)
        return dict(zip(self.layers, totals.tolist(), strict=True))

    @property
    def sparsity(self) -> float | None:
        """Part of all neuron-timesteps without a spike (NeuroBench's ActivationSparsity).

        None where neurons spike several times in one, as counts of spikes do not tell in how many.
        """
        if self.several:
            return None
        every = max(sum(self.neurons) * self.timesteps, 1)
        return (every - self.total("spike_out")) / every


def count(
    program: Program,
    spikes: Mapping[str, NDArray[np.uint8]],
    busy: Mapping[str, NDArray[np.bool_]] | None = None,
    overflows: Mapping[str, Counts] | None = None,
) -> Counts:
    """Counts (B, L, E) of one inference, the slow way: the specification of a Machine's ledger.

    spikes: (B, T, N) of the input and of each layer.
    busy: (B, T, N) of each layer, as in Tick; None takes every neuron-timestep for an update.
    overflows: (B, T, N) of each layer, as in Tick; None takes none.
    """
    batch, timesteps, _ = spikes[program.input].shape
    counts = np.zeros((batch, len(program.layers), len(EVENTS)), np.int64)
    for index, layer in enumerate(program.layers):
        neuron_steps = layer.size * program.steps(timesteps)
        spike_in = sum(_each(spikes[s.source]) for s in layer.synapses)
        spike_out = _each(spikes[layer.name])
        update = _each(busy[layer.name]) if busy else timesteps * layer.size
        to_host = spike_out if layer.name in program.to_host else 0
        event = {
            "spike_in": spike_in,
            "sop": sum(_each(spikes[s.source] * s.fan_out) for s in layer.synapses),
            "bias_sop": timesteps * layer.bias_fan_out,
            "neuron_update": update,
            "neuron_idle": neuron_steps - update,
            "spike_out": spike_out,
            "message": spike_in + timesteps * (layer.bias_fan_out > 0) + to_host,
            "saturation": _each(overflows[layer.name]) if overflows else 0,
        }
        for kind, name in enumerate(EVENTS):
            counts[:, index, kind] = event[name]
    return counts


def _each(values: NDArray[Any]) -> Counts:
    """Sums (B,) over timesteps and neurons."""
    return np.asarray(values.sum(axis=(1, 2), dtype=np.int64))
