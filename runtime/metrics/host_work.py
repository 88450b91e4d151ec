"""What the host computes for readout layers that a chip has no way out for."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program


@dataclass(frozen=True)
class HostWork:
    """Operations of the host, in float64; no table of energies has a price for them.

    multiplications: a current or a membrane times its decay factor, where that is neither 0 nor 1,
        and a weight times a graded spike.
    additions: a weight for each spike and synapse, biases, and currents onto membranes.
    """

    multiplications: int
    additions: int


def host_work(program: Program, spikes: Mapping[str, NDArray[Any]]) -> HostWork | None:
    """Of inferences; None where the host integrates nothing.

    spikes: (B, T, N) of the input and of each layer that can spike.
    """
    if not program.host:
        return None
    batch, timesteps, _ = spikes[program.input].shape
    updates = batch * timesteps
    graded = {n: rows != 0 if n in program.graded else rows for n, rows in spikes.items()}
    sources = [synapses for layer in program.host for synapses in layer.synapses]
    arriving = {
        index: int((graded[s.source].sum(axis=(0, 1), dtype=np.int64) * s.fan_out).sum())
        for index, s in enumerate(sources)
    }
    weighed = sum(n for index, n in arriving.items() if sources[index].source in program.graded)
    return HostWork(
        multiplications=updates * sum(layer.multiplications for layer in program.host) + weighed,
        additions=sum(arriving.values()) + updates * sum(map(_steady_additions, program.host)),
    )


def _steady_additions(layer: Layer) -> int:
    """Of all neurons of a layer in a timestep, whatever arrives."""
    terms = (layer.bias, layer.voltage_bias, layer.current_decay)
    return sum(int(np.count_nonzero(values)) for values in terms)
