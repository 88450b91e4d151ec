"""What the host does for a spiking policy: encoder, readout, resets; priced where that is known.

A term is None where nothing prices it: Gaussians of a population encoder, random bytes of a rate
encoder, readouts that the host integrates, and resets of states on a chip.
"""

import numpy as np

from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import state_count
from spikedeploy.runtime.metrics.energy_tables import EnergyTable
from spikedeploy.runtime.metrics.energy_terms import (
    delta_encoder,
    host_readout,
    rate_encoder,
    resets,
)


def encoding(codec: Codec, spikes: float) -> float | None:
    """Energy [J] of the encoder in an inference in which it sends so many spikes."""
    encoder = codec.encoder
    if isinstance(encoder, DeltaEncoder):
        read = int(np.isfinite(encoder.step).sum())  # a step of infinity never sends
        return delta_encoder(read, spikes, codec.timesteps)
    if isinstance(encoder, RateEncoder) and not encoder.random:
        return rate_encoder(encoder.observed, codec.timesteps)
    return None


def reading_out(program: Program, additions: float, products: float) -> float | None:
    """Energy [J] of the host's readout: its weights added or multiplied, and its constants."""
    if program.host:
        return None
    if program.readout is not None:
        return host_readout(additions, products, program.readout.bias.size)
    constants = sum(outlet.bias.size for outlet in program.outlets)
    return host_readout(additions, products, constants)


def resetting(program: Program, table: EnergyTable) -> float | None:
    """Energy [J] of setting all states of the chip to 0 before an inference, if it is done."""
    if program.convention.state == "kept" or ("resets" in table.included):
        return 0.0
    return resets(sum(layer.size * state_count(layer, program) for layer in program.layers), table)
