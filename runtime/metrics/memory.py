"""Memory traffic: the bits that a chip reads and writes for the events of a ledger.

It follows from the ledger's events and the widths of the chip's registers; nothing is counted while
a network runs. It is the least that the arithmetic needs: indices, whole words and routing tables,
which differ between chips, are not included.
"""

from dataclasses import dataclass, fields

import numpy as np

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import EVENTS, Counts, Ledger


@dataclass(frozen=True)
class Widths:
    """Widths of what a chip stores.

    weight: [bits] of a weight, without its sign where the sign belongs to a list of synapses.
    states: [bits] of each state variable of a neuron.
    """

    weight: int
    states: tuple[int, ...]


@dataclass(frozen=True)
class MemoryTraffic:
    """Reads and writes of a layer in all inferences of a ledger.

    weight_reads: one weight for each synaptic operation, those of biases included.
    state_reads: every state variable of every neuron in every timestep.
    state_writes: every state variable of every neuron that was updated.
    read_bits, write_bits: the same [bits].
    accumulator_accesses: reads and writes of the sums that synaptic operations add to, one of each,
        where those are in memory and not in registers; the bits do not include them.
    """

    weight_reads: int
    state_reads: int
    state_writes: int
    read_bits: int
    write_bits: int
    accumulator_accesses: int


def widths(chip: Chip) -> Widths:
    """The widths of a chip's weights and states; those of float32 where it rounds nothing."""
    return Widths(chip.arithmetic.weight_bits, chip.arithmetic.state_bits)


def memory_counts(ledger: Ledger, program: Program) -> Counts:
    """Counts (S, L, K) of each row and layer of the ledger; K are the fields of MemoryTraffic."""
    bits = widths(program.chip)
    event = {name: ledger.counts[:, :, kind] for kind, name in enumerate(EVENTS)}
    weights = event["sop"] + event["bias_sop"]
    reads = event["neuron_update"] + event["neuron_idle"]
    columns = {
        "weight_reads": weights,
        "state_reads": reads * len(bits.states),
        "state_writes": event["neuron_update"] * len(bits.states),
        "read_bits": weights * bits.weight + reads * sum(bits.states),
        "write_bits": event["neuron_update"] * sum(bits.states),
        "accumulator_accesses": 2 * weights,
    }
    return np.stack([columns[field.name] for field in fields(MemoryTraffic)], axis=2)


def memory_traffic(ledger: Ledger, program: Program) -> dict[str, MemoryTraffic]:
    """Reads and writes of each layer in all inferences."""
    totals = memory_counts(ledger, program).sum(axis=0)
    return {
        name: MemoryTraffic(*row.tolist()) for name, row in zip(ledger.layers, totals, strict=True)
    }


def packed_bytes(program: Program) -> float:
    """Size [bytes] of all weights, zeros included, and biases in the chip's widths.

    The readout, which the host computes, is not included.
    """
    weights = sum(_weights(layer) for layer in program.layers)
    return weights * widths(program.chip).weight / 8


def _weights(layer: Layer) -> int:
    biases = layer.size if layer.bias.any() or layer.voltage_bias.any() else 0
    return sum(synapses.weight.size for synapses in layer.synapses) + biases
