"""Xylo's clocks, worked out by hand from rockpool's formula."""

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.metrics.energy import xylo_clocks, xylo_time


def _layer(name, size, wires, aliases=()):
    synapses = tuple(Synapses(source, np.array(w, np.int64), 1) for source, w in wires)
    zero = np.zeros(size, np.int64)
    return Layer(name, synapses, zero, zero, zero + 10, zero[None], zero, 1.0, 0, aliases)


def _program(aliases=()):
    """Two inputs, four hidden neurons of which each reaches two others, and one output."""
    loop = np.array([[0, 1, 1, 0], [0, 0, 1, 1], [1, 0, 0, 1], [1, 1, 0, 0]])
    hidden = _layer("hidden", 4, [("input", np.ones((2, 4))), ("hidden", loop)], aliases)
    output = _layer("output", 1, [("hidden", np.ones((4, 1)))])
    convention = Convention(1e-3, reset="subtract", delay=1)
    return Program(chip("xylo-a2"), convention, "input", 2, (hidden, output), "output", None)


QUIET = {
    "input": np.zeros((1, 10, 2)),
    "hidden": np.zeros((1, 10, 4)),
    "output": np.zeros((1, 10, 1)),
}


def test_a_network_without_spikes_takes_its_fixed_clocks():
    # 2 inputs; 4 hidden neurons of 3 + 19; 1 output of 12
    assert xylo_clocks(_program(), QUIET) == 2 + 4 * 22 + 12


def test_a_spike_takes_clocks_for_each_postsynaptic_neuron():
    busy = {**QUIET, "input": QUIET["input"].copy(), "hidden": QUIET["hidden"].copy()}
    busy["input"][0, :5] = 3  # half of the timesteps; that they are three is all the same
    busy["hidden"][0, ::4] = 1  # of 10 timesteps 3
    inputs = 2 * (3.5 * 0.5 * 4 + 1)
    synapses = 4 * (2 * 7 * 0.3 + 3)
    outputs = 4 * 0.3 * (1 + 1 * 8)
    neurons = 4 * (19 + 2 * 0.3 + 0.3)
    wanted = inputs + synapses + outputs + neurons + 12
    assert xylo_clocks(_program(), busy) == pytest.approx(wanted)


def test_aliases_take_clocks_too():
    # every neuron has an alias and is one: 2 + 3 + 1 clocks a neuron more, spikes or not
    everyone = ((1,), (2,), (3,), (0,))
    assert xylo_clocks(_program(everyone), QUIET) == 2 + 4 * (22 + 2 + 3 + 1) + 12


def test_time_is_clocks_over_the_clock_and_at_most_a_fifth_more():
    found = xylo_time(_program(), QUIET, clock=1e6)
    assert (found.value, found.low, found.high) == pytest.approx((1020e-6, 1020e-6, 1224e-6))
