"""What a chip reads and writes, counted by hand."""

import numpy as np

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.metrics.traffic import MemoryTraffic, memory_counts, memory_traffic
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
        "n": MemoryTraffic(
            weight_reads=5,
            state_reads=18,
            state_writes=10,
            read_bits=5 * 8 + 18 * 24,
            write_bits=10 * 24,
            accumulator_accesses=2 * 5,
        )
    }


def test_accumulators_are_read_and_written_once_for_each_operation_of_a_random_network():
    rng = np.random.default_rng(3)
    used = chip("loihi1")
    weight = rng.integers(-9, 10, (7, 5)).astype(np.int16) * (rng.random((7, 5)) < 0.4)
    synapses = (Synapses("input", weight, delay=0),)
    leaky = {"decays": (2000, 300), "threshold": 20 << 6, "start": 0}
    neurons = layer(used.arithmetic, "n", weight.T, synapses, **leaky)
    network = Program(used, Convention(1e-3), "input", 7, (neurons,), "n", None)
    rows = (rng.random((40, 7)) < 0.3).astype(np.uint8)
    accesses = 0
    for row in rows:  # a list of targets for each spike; a sum is read, added to and written
        for axon in np.flatnonzero(row):
            for target in range(5):
                accesses += 2 if weight[axon, target] else 0
    ledger = run(network, rows)
    assert accesses == memory_traffic(ledger, network)["n"].accumulator_accesses > 0
    assert accesses == 2 * ledger.total("sop")


def test_there_is_a_row_for_each_timestep_of_a_stream():
    network = program()
    counts = memory_counts(run(network, [[1, 0], [0, 1], [0, 0]]), network)
    assert counts.shape == (3, 1, 6)
    assert counts[:, 0, 0].tolist() == [2, 3, 0]
    assert counts[:, 0, 2].tolist() == [0, 4, 6]


def test_fewer_bits_are_fewer_bits_to_read():
    network = program(weight_bits=4)
    found = memory_traffic(run(network, [[1, 1]]), network)["n"]
    assert (found.weight_reads, found.read_bits) == (5, 5 * 4 + 3 * 48)
