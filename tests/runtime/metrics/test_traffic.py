"""Messages between cores and their ways, counted by hand."""

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.metrics.traffic import Layout, MessageTraffic, placed_messages, traffic
from tests.programs import layer

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


APART = {"input": np.array([0, 0]), "a": np.array([1, 1]), "b": np.array([2])}
SPIKES = {"input": np.array([10, 1]), "a": np.array([4, 4]), "b": np.array([2])}


def test_a_spike_takes_a_message_to_each_core_that_it_reaches(network):
    found = traffic(network, SPIKES, Layout(APART, np.zeros((3, 2), np.int64)))
    # axon 0 reaches layer a, axon 1 both layers, the second layer itself; a's spikes nothing
    assert found == MessageTraffic(message=10 * 1 + 1 * 2 + 2 * 1, hop_x=0, hop_y=0)


def test_layers_that_share_a_core_share_a_message(network):
    ones = {"input": np.array([0, 0]), "a": np.array([1, 1]), "b": np.array([1])}
    found = traffic(network, SPIKES, Layout(ones, np.zeros((2, 2), np.int64)))
    assert found.message == 10 + 1 + 2


def test_a_layer_on_two_cores_takes_two_messages_and_their_hops(network):
    spread = {"input": np.array([0, 0]), "a": np.array([1, 2]), "b": np.array([0])}
    # the second core is two tiles along the row, the third one tile along the column
    tiles = np.array([[0, 0], [2, 0], [0, 1]])
    found = traffic(network, SPIKES, Layout(spread, tiles))
    # axon 0 to cores 1 and 2; axon 1 to core 2 and its own
    assert found == MessageTraffic(message=10 * 2 + 1 * 2 + 2, hop_x=10 * 2, hop_y=10 + 1)


def test_a_message_goes_to_every_core_of_a_layer_and_to_the_host_once(network):
    counts = np.zeros((1, 2, len(EVENTS)), np.int64)
    # layer b sends two spikes to the host besides
    for row, (spikes, sent) in enumerate([(11, 11), (13, 15)]):
        counts[0, row, EVENTS.index("spike_in")] = spikes
        counts[0, row, EVENTS.index("message")] = sent
    found = Ledger(("a", "b"), (2, 1), counts, inferences=2, timesteps=10, steps=10)
    assert placed_messages(found, network, {}) == (11 + 15) / 2 == found.per_inference("message")
    assert placed_messages(found, network, {"a": 1, "b": 3}) == (11 + 15 + 2 * 13) / 2
