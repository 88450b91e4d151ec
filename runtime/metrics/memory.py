"""Memory: what a chip reads and writes for the events of a ledger, in bits.

Nothing of this is counted while a network runs: it follows from the ledger's events and from the
widths of the chip's registers. It is what the arithmetic must touch at least; what a memory fetches
besides (indices, whole words, routing tables) differs from chip to chip and is not in it.
"""

from dataclasses import dataclass, fields

import numpy as np

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.compiler.program import Layer, Program
from spikedeploy.runtime.emulator.ledger import EVENTS, Counts, Ledger


@dataclass(frozen=True)
class Widths:
    """What a chip stores.

    weight: [bits] of a weight; the sign is none of them where a list says it.
    states: [bits] of each state of a neuron.
    """

    weight: int
    states: tuple[int, ...]


@dataclass(frozen=True)
class MemoryTraffic:
    """What a layer reads and writes, in all inferences of a ledger.

    weight_reads: weights fetched, one for each synaptic operation, those of biases included.
    state_reads: states looked at: every state of every neuron in every timestep.
    state_writes: states written: every state of every neuron that was updated.
    read_bits, write_bits: the same [bits].
    """

    weight_reads: int
    state_reads: int
    state_writes: int
    read_bits: int
    write_bits: int


def widths(chip: Chip) -> Widths:
    """The widths of a chip's weights and states; those of float32 where it rounds nothing."""
    return Widths(chip.arithmetic.weight_bits, chip.arithmetic.state_bits)


def memory_counts(ledger: Ledger, program: Program) -> Counts:
    """Counts (S, L, K) of each row and layer of the ledger; K as the fields of Memory."""
    wide = widths(program.chip)
    event = {name: ledger.counts[:, :, kind] for kind, name in enumerate(EVENTS)}
    weights = event["sop"] + event["bias_sop"]
    looks = event["neuron_update"] + event["neuron_idle"]
    columns = {
        "weight_reads": weights,
        "state_reads": looks * len(wide.states),
        "state_writes": event["neuron_update"] * len(wide.states),
        "read_bits": weights * wide.weight + looks * sum(wide.states),
        "write_bits": event["neuron_update"] * sum(wide.states),
    }
    return np.stack([columns[field.name] for field in fields(MemoryTraffic)], axis=2)


def memory(ledger: Ledger, program: Program) -> dict[str, MemoryTraffic]:
    """What each layer reads and writes, in all inferences."""
    totals = memory_counts(ledger, program).sum(axis=0)
    return {
        name: MemoryTraffic(*row.tolist()) for name, row in zip(ledger.layers, totals, strict=True)
    }


def packed_bytes(program: Program) -> float:
    """[bytes] of all weights on the chip, zeros included, and of the biases, in its widths.

    The readout is the host's and not among them.
    """
    weights = sum(_weights(layer) for layer in program.layers)
    return weights * widths(program.chip).weight / 8


def _weights(layer: Layer) -> int:
    biases = layer.size if layer.bias.any() or layer.voltage_bias.any() else 0
    return sum(synapses.weight.size for synapses in layer.synapses) + biases
