"""Bits that a chip reads and writes, and messages between cores, counted by hand."""

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.metrics.traffic import (
    memory_traffic,
    placed_messages,
)
from tests.programs import layer


def program(**options):
    """Two axons onto three neurons that keep their membranes; one of six weights is 0."""
    used = chip("loihi1", **options)
    weight = np.array([[5, 0, 7], [1, 2, 3]], np.int16)
    synapses = (Synapses("input", weight, delay=1),)
    kept = {"decays": (4095, 0), "threshold": 1000 << 6, "start": 0}
    neurons = layer(used.arithmetic, "n", weight.T, synapses, **kept)
    return Program(used, Convention(1e-3), "input", 2, (neurons,), "n", None)


def run(network, rows):
    machine = Machine(network)
    for row in rows:
        machine.step(np.array([row], np.uint8))
    return machine.ledger


def test_a_synaptic_operation_reads_a_weight_and_an_update_writes_both_states():
    network = program()
    found = memory_traffic(run(network, [[1, 0], [0, 1], [0, 0]]), network)
    # 2 and 3 weights of 8 bits; 9 neuron-timesteps look at a current and a membrane of 24 bits;
    # two neurons are updated in the second timestep and all three in the third
    assert found == {
        "n": dict(
            weight_reads=5,
            state_reads=18,
            state_writes=10,
            read_bits=5 * 8 + 18 * 24,
            write_bits=10 * 24,
            accumulator_accesses=2 * 5,
        )
    }


CHIP = chip("loihi1")


@pytest.fixture
def network():
    """Two inputs; layers of two and of one, which both receive them; the second is recurrent."""
    first = [[5, 5], [0, 7]]
    second, loop = [[0], [3]], [[1]]
    layers = (
        _layer("a", 2, [("input", first)]),
        _layer("b", 1, [("input", second), ("b", loop)]),
    )
    return Program(CHIP, Convention(1e-3), "input", 2, layers, "b", None)


def _layer(name, size, wires):
    synapses = tuple(Synapses(source, np.array(w, np.int16), delay=1) for source, w in wires)
    return layer(
        CHIP.arithmetic, name, np.zeros((size, 1)), synapses, decays=(4095, 0), threshold=1000 << 6
    )


def test_a_message_goes_to_every_core_of_a_layer_and_to_the_host_once(network):
    counts = np.zeros((1, 2, len(EVENTS)), np.int64)
    # layer b sends two spikes to the host besides
    for row, (spikes, sent) in enumerate([(11, 11), (13, 15)]):
        counts[0, row, EVENTS.index("spike_in")] = spikes
        counts[0, row, EVENTS.index("message")] = sent
    found = Ledger(("a", "b"), (2, 1), counts, inferences=2, timesteps=10, steps=10)
    assert placed_messages(found, network, {}) == (11 + 15) / 2 == found.per_inference("message")
    assert placed_messages(found, network, {"a": 1, "b": 3}) == (11 + 15 + 2 * 13) / 2
