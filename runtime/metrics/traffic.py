"""Traffic of a run: bits read and written, messages between cores, and the host's operations.

Memory follows from the ledger's events and the widths of the chip's registers; nothing is counted
while a network runs. It is a lower bound, what the arithmetic needs: indices, whole words and
routing tables, which differ between chips, are not included.

Messages: a ledger counts one for each spike and each postsynaptic layer, as if every layer were on
a core of its own; `placed_messages` counts them where layers take several.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger


def memory_traffic(ledger: Ledger, program: Program) -> dict[str, dict[str, int]]:
    """Reads and writes of each layer in all inferences of a ledger.

    weight_reads: one weight for each synaptic operation, those of biases included.
    state_reads: every state variable of every neuron in every timestep.
    state_writes: every state variable of every neuron that was updated.
    read_bits, write_bits: size of these reads and writes [bits].
    accumulator_accesses: reads and writes of the sums that synaptic operations add to, one of each,
        where those are in memory and not in registers; the bits do not include them.
    """
    arithmetic = program.chip.arithmetic
    states = arithmetic.state_bits
    totals = ledger.counts.sum(axis=0, dtype=np.int64)
    found = {}
    for name, row in zip(ledger.layers, totals.tolist(), strict=True):
        event = dict(zip(EVENTS, row, strict=True))
        weights = event["sop"] + event["bias_sop"]
        updates = event["neuron_update"]
        reads = updates + event["neuron_idle"]
        found[name] = {
            "weight_reads": weights,
            "state_reads": reads * len(states),
            "state_writes": updates * len(states),
            "read_bits": weights * arithmetic.weight_bits + reads * sum(states),
            "write_bits": updates * sum(states),
            "accumulator_accesses": 2 * weights,
        }
    return found


def packed_bytes(program: Program) -> float:
    """Size [bytes] of all weights, zeros included, and biases in the chip's widths; kernels once.

    The readout, which the host computes, is not included.
    """
    weights = 0
    for layer in program.layers:
        weights += sum(synapses.weight.size for synapses in layer.synapses)
        weights += layer.size * bool(layer.bias.any() or layer.voltage_bias.any())
    return weights * program.chip.arithmetic.weight_bits / 8


def placed_messages(ledger: Ledger, program: Program, cores: Mapping[str, int]) -> float:
    """Messages of an inference where layers take several cores, at most.

    Every message to a layer, those of the bias axon too, goes to each of its cores, as if each had
    synapses of every neuron; those to the host stay. Equal to the ledger's on one core a layer.

    cores: of each layer; 1 where it is not named.
    """
    sent, spikes = ledger.by_layer("message"), ledger.by_layer("spike_in")
    found = 0
    for layer in program.layers:
        inside = spikes[layer.name] + ledger.timesteps * (layer.bias_fan_out > 0)
        found += sent[layer.name] + inside * (cores.get(layer.name, 1) - 1)
    return found / max(ledger.inferences, 1)


def host_work(program: Program, spikes: Mapping[str, NDArray[Any]]) -> dict[str, int]:
    """Operations of the host for readout layers that a chip has no way out for; empty of none.

    In float64; no table of energies has a price for them.

    multiplications: a current or a membrane times its decay factor, where that is neither 0 nor 1,
        and a weight times a graded spike.
    additions: a weight for each spike and synapse, biases, and currents onto membranes.

    spikes: (B, T, N) of the input and of each layer that can spike.
    """
    if not program.host:
        return {}
    batch, timesteps, _ = spikes[program.input].shape
    multiplications = additions = 0
    for layer in program.host:
        # of all neurons in a timestep, whatever arrives
        steady = (layer.bias, layer.voltage_bias, layer.current_decay)
        additions += batch * timesteps * sum(int(np.count_nonzero(values)) for values in steady)
        multiplications += batch * timesteps * layer.multiplications
        for synapses in layer.synapses:
            graded = synapses.source in program.graded
            sent = spikes[synapses.source]
            sent = (sent != 0 if graded else sent).sum(axis=(0, 1), dtype=np.int64)
            arriving = int((sent * synapses.fan_out).sum())
            additions += arriving
            multiplications += arriving * graded
    return {"multiplications": multiplications, "additions": additions}
