"""What small faults of the arithmetic would change: overflows of each register, idle neurons."""

from dataclasses import replace

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import LayerState, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.families.cuba.neurons import update
from tests.programs import layer

NARROW = Register(8, "wrap")


def neuron(fixed, bias=0, threshold=1):
    """One neuron with one weight."""
    axons = (Synapses("input", np.ones((1, 1), np.int16), delay=0),)
    return layer(
        fixed, "n", np.ones((1, 1)), axons, decays=(0, 0), threshold=threshold, bias=bias
    )  # fmt: skip


def state():
    zero = np.zeros((1, 1), np.int64)
    return LayerState(zero, zero.copy(), zero.copy(), zero.copy())


@pytest.mark.parametrize("register", ["accumulator", "current", "push", "membrane"])
def test_an_overflow_of_each_register_is_counted_once_and_none_is_taken_away(register):
    fixed = replace(chip("loihi1").arithmetic, **{register: NARROW})
    found = update(
        fixed, Convention(1e-3), neuron(fixed, threshold=1 << 20), np.array([[3]]), state()
    )
    # 3 << 6 = 192 needs more than 8 bits; what wraps to -64 fits all registers behind it
    assert found.overflows.tolist() == [[1]]


def test_an_overflow_that_only_the_bias_brings_about_is_noticed_though_a_spike_hides_it():
    # t0: v = 240,000 + 20,000, below the threshold; t1: v = 260,000 + 260,000 + 20,000 = 540,000,
    # which 20 bits do not hold: it wraps, and what would be reset to 0 does not spike
    used = chip("loihi1", membrane=Register(20, "wrap"), delay=0)
    weight = np.array([[250]] * 15 + [[125], [187]], np.int16)
    one = layer(
        used.arithmetic,
        "n",
        weight.T,
        (Synapses("input", weight, delay=0),),
        decays=(4095, 0),
        threshold=262_144,
        bias=20_000,
    )
    program = Program(used, Convention(1e-3), "input", len(weight), (one,), "n", None)
    raster = np.ones((1, 2, len(weight)), np.uint8)
    raster[0, 0, -2:] = 0
    expected = trace(program, raster)["n"]
    assert expected.overflows.sum() == 1
    assert not expected.spikes.any()
    machine = Machine(program, trace=True)
    assert not machine.infer(raster).any()
    np.testing.assert_array_equal(machine.recordings["n"].membrane, expected.membrane)
    assert machine.ledger.total("saturation") == 1
