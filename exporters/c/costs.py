"""What C of a program takes: memory, and operations in the worst case and as recorded."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.plan import Plan
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.emulator.machine import Machine


@dataclass(frozen=True)
class CCosts:
    """Memory, and operations of an inference.

    rom: constants [bytes]; the code comes on top, which the compiler decides, and which has the
        weights of projections with few synapses.
    ram: static variables [bytes]; the stack comes on top, less than 1 kB without the C library.
    sops, sops_max: synaptic operations, the mean of those recorded and the most there can be.
    events, events_max: input spikes, likewise.
    neuron_updates: each neuron in each timestep.
    """

    rom: int
    ram: int
    sops: float
    sops_max: int
    events: float
    events_max: int
    neuron_updates: int


def costs(plan: Plan, raster: NDArray[np.uint8], rom: int, ram: int) -> CCosts:
    """Costs of a plan; raster: (S, T, M) input spikes of an episode, for the typical operations."""
    layers, timesteps = plan.program.layers, raster.shape[1]
    each = sum(_most(plan, synapses) for layer in layers for synapses in layer.synapses)
    machine = Machine(plan.program, 1, "total")
    for rows in raster:
        machine.infer(rows[None])
    return CCosts(
        rom=rom,
        ram=ram,
        sops=machine.ledger.per_inference("sop"),
        sops_max=timesteps * each,
        events=float(raster.sum(axis=(1, 2), dtype=np.int64).mean()),
        events_max=timesteps * plan.events_max * plan.times_max[plan.program.input],
        neuron_updates=timesteps * sum(layer.size for layer in layers),
    )


def _most(plan: Plan, synapses: Synapses) -> int:
    """Synaptic operations of a projection in a timestep, where all that can spike does."""
    fan_out = synapses.fan_out
    encoder = plan.codec.encoder if plan.codec else None
    if synapses.source == plan.program.input and isinstance(encoder, DeltaEncoder):
        return _most_of_delta(fan_out, encoder)
    return int(fan_out.sum()) * plan.times_max[synapses.source]


def _most_of_delta(fan_out: NDArray[np.int64], encoder: DeltaEncoder) -> int:
    """The same of a delta code: an observation moves up or down, and not both."""
    signs = fan_out.reshape(encoder.observed, 2, encoder.most)
    of_sign = signs.sum(axis=2) if encoder.code == "unary" else signs.max(axis=2)
    return int(of_sign.max(axis=1).sum())
