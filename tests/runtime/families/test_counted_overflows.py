"""What small faults of the arithmetic would change: overflows of each register, idle neurons."""

from dataclasses import replace

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import LayerState, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families.cuba.neurons import float_sigma_delta, sigma_delta, update
from tests.programs import layer

NARROW = Register(8, "wrap")


def neuron(fixed, bias=0, threshold=1):
    """One neuron that keeps nothing, with a weight that the test gives as a sum."""
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


def test_overflows_of_several_registers_in_a_timestep_add_up():
    # 192 wraps to -64, which needs more than 6 bits
    fixed = replace(chip("loihi1").arithmetic, push=NARROW, membrane=Register(6, "wrap"))
    found = update(
        fixed, Convention(1e-3), neuron(fixed, threshold=1 << 20), np.array([[3]]), state()
    )
    assert found.overflows.tolist() == [[2]]


@pytest.mark.parametrize(("bias", "active"), [(0, False), (-1, True), (1, True)])
def test_a_sigma_delta_neuron_without_input_is_idle_unless_it_has_a_bias(bias, active):
    fixed = chip("loihi2").arithmetic
    one = neuron(fixed, bias=bias, threshold=10)
    found = sigma_delta(fixed, 8, one, np.zeros((1, 1), np.int64), state())
    assert found.active.tolist() == [[active]]
    in_float = float_sigma_delta(53, one, np.zeros((1, 1)), state())
    assert in_float.active.tolist() == [[active]]


@pytest.mark.parametrize("register", ["accumulator", "membrane", "push"])
def test_overflows_of_sigma_delta_neurons_are_counted(register):
    fixed = replace(chip("loihi2").arithmetic, **{register: NARROW})
    one = neuron(fixed, threshold=1 << 20)
    found = sigma_delta(fixed, 8, one, np.array([[3]]), state())
    assert found.overflows.tolist() == [[1]]
