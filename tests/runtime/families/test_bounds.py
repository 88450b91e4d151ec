"""Bounds hold for the worst spikes, and are no larger than they need to be."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import Interpreter
from spikedeploy.runtime.families.cuba.numpy_kernels import Raster, _OverflowCheck
from spikedeploy.runtime.families.cuba.quantise import (
    Bounds,
    bounds,
    exact_ticks,
    spikes_without_overflow,
)
from tests.programs import layer, random_programs, rasters

WIDE = chip("loihi1", current=Register(60, "none"), membrane=Register(60, "none"))


def one_neuron(weights, decays, threshold=131071 << 6):
    weight = np.array(weights, np.int16)[:, None]
    axons = (Synapses("input", weight, delay=1),)
    neuron = layer(
        WIDE.arithmetic, "n", weight.T, axons, decays=decays, threshold=threshold, start=1
    )
    return Program(WIDE, Convention(1e-3), "input", len(weight), (neuron,), "n", None)


@settings(max_examples=60, deadline=None)
@given(random_programs(), st.integers(0, 2**32 - 1), st.sampled_from([0.2, 1.0]))
def test_no_spikes_exceed_the_bounds(program, seed, rate):
    raster = rasters(program, 2, 6, rate, seed)[0]
    fixed = program.chip.arithmetic
    traces = Interpreter(program, 2).run(raster)
    for a in program.layers:
        limits, ran = bounds(program, a, fixed, 6), traces[a.name]
        if ran.overflows.any():
            assert (
                limits.drive > fixed.accumulator.limit
                or limits.current > fixed.current.limit
                or limits.current + np.abs(a.voltage_bias).max() > fixed.push.limit
                or max(limits.above, limits.below) > fixed.membrane.limit
            )
        else:
            assert np.abs(ran.current).max() <= limits.current
            assert -ran.membrane.min() <= limits.below
            assert ran.membrane.max() <= limits.above


@pytest.mark.parametrize("timesteps", [1, 5, 80])
def test_inhibition_in_every_timestep_reaches_the_bounds(timesteps):
    program = one_neuron([-200, -55, 30], decays=(2047, 0))
    raster = np.zeros((1, timesteps, 3), np.uint8)
    raster[:, :, :2] = 1
    ran = Interpreter(program, 1).run(raster)["n"]
    limits = bounds(program, program.layers[0], WIDE.arithmetic, timesteps)
    assert limits.partial == 255
    # rounding toward zero keeps the states a little nearer to zero
    assert -ran.current.min() == pytest.approx(limits.current, rel=1e-3)
    assert -ran.membrane.min() == pytest.approx(limits.below, rel=1e-3)


def test_a_membrane_cannot_be_far_above_its_threshold():
    program = one_neuron([200, -55], decays=(4095, 0), threshold=1000 << 6)
    limits = bounds(program, program.layers[0], WIDE.arithmetic, None)
    assert limits.above == (1000 + 200) * 64
    assert limits.below == np.inf


def test_an_unbounded_window_with_a_leak_has_a_limit():
    program = one_neuron([200, -55], decays=(2047, 1024))
    limits = bounds(program, program.layers[0], WIDE.arithmetic, None)
    assert limits.current == 2 * 200 * 64
    assert limits.below == 4 * 2 * 55 * 64


def the_layer(**fields):
    return replace(one_neuron([200, -55], decays=(2047, 1024)).layers[0], **fields)


def test_so_many_spikes_cannot_overflow_as_the_peak_of_one_allows():
    # a current of 1 halves, a membrane keeps 3/4: 1, 1.25, 1.1875, … is the membrane's answer
    a = the_layer()
    assert spikes_without_overflow(a, WIDE.arithmetic, 5, 10 * 200 * 64) == 8
    # an always-on axon of 3 and a voltage bias of 64 arrive in each of the 5 timesteps
    biased = the_layer(bias=np.array([-3]), voltage_bias=np.array([64]))
    assert spikes_without_overflow(biased, WIDE.arithmetic, 5, 10 * 200 * 64) == int(
        (8 * 12800 - 5 * 256) / 12800
    )
    assert spikes_without_overflow(biased, WIDE.arithmetic, 5, 100) == -1


@settings(max_examples=60, deadline=None)
@given(random_programs(), st.integers(1, 9), st.integers(0, 2**32 - 1), st.integers(8, 24))
def test_so_few_spikes_leave_every_state_within_the_limit(program, timesteps, seed, bits):
    wide = replace(program.chip, arithmetic=WIDE.arithmetic)
    program = replace(program, chip=wide, convention=replace(program.convention, state="reset"))
    raster = rasters(program, 1, timesteps, 0.1, seed)[0]
    traces = Interpreter(program, 1).run(raster)
    spikes = {program.input: raster, **{name: ran.spikes for name, ran in traces.items()}}
    for a in program.layers:
        presynaptic = sum(int(spikes[s.source].sum()) for s in a.synapses)
        if presynaptic <= spikes_without_overflow(a, WIDE.arithmetic, timesteps, 1 << bits):
            assert np.abs(traces[a.name].current).max() <= 1 << bits
            assert np.abs(traces[a.name].membrane).max() <= 1 << bits


@pytest.mark.parametrize(
    ("fields", "ticks"),
    [
        ({}, 3),  # 3/4 takes two of six bits in each
        ({"membrane_decay": np.array([2048])}, 6),
        ({"membrane_decay": np.array([3686])}, 0),
        ({"voltage_bias": np.array([16])}, 2),
        ({"threshold": np.array([65])}, 0),
        ({"current_decay": np.array([0]), "membrane_decay": np.array([4096])}, 100),
        ({"current_decay": np.array([0]), "membrane_decay": np.array([0])}, 100),
    ],
)
def test_decays_of_few_bits_round_nothing_for_some_timesteps(fields, ticks):
    assert exact_ticks(the_layer(**fields), WIDE.arithmetic) == ticks


def test_the_bound_of_what_arrives_is_that_of_the_neuron_that_receives_most():
    weight = np.array([[3, 200]], np.int16)
    axons = (Synapses("input", weight, delay=1),)
    both = layer(WIDE.arithmetic, "n", weight.T, axons, decays=(0, 0), threshold=64, start=1)
    program = Program(WIDE, Convention(1e-3), "input", 1, (both,), "n", None)
    assert bounds(program, both, WIDE.arithmetic, 4).partial == 200


@pytest.mark.parametrize(("bias", "below"), [(0, 0.0), (-1, np.inf)])
def test_a_membrane_without_a_leak_is_bounded_below_only_if_nothing_pulls_it_down(bias, below):
    program = one_neuron([200], decays=(0, 0))
    kept = {"membrane_decay": np.array([4096]), "voltage_bias": np.array([bias])}
    pushed = replace(program.layers[0], **kept)
    assert bounds(program, pushed, WIDE.arithmetic, None).below == below


@pytest.mark.parametrize(("bias", "above"), [(-640, 1200 * 64), (640, 1210 * 64)])
def test_only_a_bias_that_raises_a_membrane_lifts_it_further_above_its_threshold(bias, above):
    program = one_neuron([200, -55], decays=(4095, 0), threshold=1000 << 6)
    biased = replace(program.layers[0], voltage_bias=np.array([bias]))
    assert bounds(program, biased, WIDE.arithmetic, None).above == above


def test_windows_of_a_hundred_timesteps_are_bounded_without_a_leak():
    program = one_neuron([-200, 55], decays=(4095, 0))
    kept = replace(program.layers[0], membrane_decay=np.array([4096]))
    assert bounds(program, kept, WIDE.arithmetic, 100).below == 100 * 200 * 64
    assert bounds(program, kept, WIDE.arithmetic, 101).below == np.inf


def test_biases_of_each_sign_are_part_of_the_bounds():
    program = one_neuron([200, -55], decays=(4095, 4095))
    for bias, partial in ((-3, 200), (-155, 210), (7, 207)):
        biased = replace(program.layers[0], bias=np.array([bias]))
        limits = bounds(program, biased, WIDE.arithmetic, 4)
        assert (limits.partial, limits.drive) == (partial, 64.0 * partial)


def test_without_weights_no_number_of_spikes_is_known_to_be_few():
    silent = the_layer(synapses=(replace(the_layer().synapses[0], weight=np.zeros((2, 1), int)),))
    assert spikes_without_overflow(silent, WIDE.arithmetic, 5, 1 << 20) == -1


def check_of(timesteps=None, **fields):
    """What looks for overflows in a layer whose bounds prove nothing, and its limit."""
    narrow = replace(WIDE.arithmetic, current=Register(24, "clip"), membrane=Register(24, "clip"))
    program = one_neuron([200, -55], decays=(0, 0))
    a = replace(program.layers[0], **fields)
    limits = bounds(program, a, narrow, timesteps)
    return _OverflowCheck(a, narrow, limits, timesteps), (1 << 23) - 1


def seen(check, highest, lowest, spikes=9):
    states = np.array([[lowest, highest]], float)
    return check.fits(states, [Raster(np.ones((spikes, 1, 1), np.uint8))])


def test_states_within_the_registers_pass_and_one_unit_more_does_not():
    # a membrane that spiked was no higher than twice the highest state that is left, and the bias
    check, limit = check_of(voltage_bias=np.array([-7]))
    assert seen(check, limit // 2, -limit) is True
    assert not seen(check, limit // 2 + 1, 0)
    assert not seen(check, 0, -limit - 1)
    pushed, limit = check_of(voltage_bias=np.array([7]))
    assert seen(pushed, (limit - 7) // 2, 0)
    assert not seen(pushed, (limit - 7) // 2 + 1, 0)
    # below zero only the bias is left to push
    for bias, passes in ((limit, True), (limit + 1, False)):
        pushed, _ = check_of(voltage_bias=np.array([bias]))
        assert seen(pushed, -5, -9) == passes


def test_membranes_that_nothing_resets_are_looked_at_as_they_are():
    check, limit = check_of(spiking=False)
    assert seen(check, limit, 0)
    assert not seen(check, limit + 1, 0)


def test_so_few_spikes_pass_unseen():
    check, limit = check_of(timesteps=300)
    a = one_neuron([200, -55], decays=(0, 0)).layers[0]
    few = spikes_without_overflow(a, WIDE.arithmetic, 300, limit)
    assert few > 0
    assert seen(check, 3 * limit, 0, spikes=few) is True
    assert not seen(check, 3 * limit, 0, spikes=few + 1)


@pytest.mark.parametrize(
    ("registers", "never"),
    [
        ({}, False),
        ({"refractory": 2}, True),
        ({"accumulator": Register(15, "clip")}, False),  # 200 * 64 <= 16383
        ({"accumulator": Register(14, "clip")}, True),
        ({"push": Register(24, "clip"), "current": Register(24, "clip")}, False),
        ({"push": Register(23, "clip"), "current": Register(24, "clip")}, True),
    ],
)
def test_what_the_kernels_do_not_compute_never_passes(registers, never):
    used = replace(WIDE.arithmetic, **registers)
    program = one_neuron([200, -55], decays=(0, 0))
    a = program.layers[0]
    check = _OverflowCheck(a, used, bounds(program, a, used, None), None)
    assert seen(check, 0, 0) == (not never)


@pytest.mark.parametrize("name", ["current", "above", "below"])
def test_bounds_that_fill_a_register_to_the_last_unit_are_proven(name):
    narrow = replace(WIDE.arithmetic, current=Register(24, "clip"), membrane=Register(24, "clip"))
    nothing = Bounds(partial=0, drive=0.0, current=0.0, above=0.0, below=0.0)
    for most, is_proven in ((float((1 << 23) - 1), True), (float(1 << 23), False)):
        limits = replace(nothing, **{name: most})
        assert seen(_OverflowCheck(the_layer(), narrow, limits, None), 1e12, 0) == is_proven


def test_the_neuron_with_the_highest_peak_says_how_many_spikes_are_few():
    weight = np.full((1, 2), 200, np.int16)
    axons = (Synapses("input", weight, delay=1),)
    both = layer(WIDE.arithmetic, "n", weight.T, axons, decays=(2047, 1024), threshold=64)
    # 1 and 1.25 are their peaks, in either order
    for keeps in ([0, 3072], [3072, 0]):
        one = replace(both, membrane_decay=np.array(keeps))
        assert spikes_without_overflow(one, WIDE.arithmetic, 5, 10 * 200 * 64) == 8
    pulled = replace(both, bias=np.array([-3000, 0]))
    assert spikes_without_overflow(pulled, WIDE.arithmetic, 5, 100) == -1


def test_weights_in_state_units_bound_the_timesteps_without_rounding():
    coarse = the_layer(threshold=np.array([1 << 12]), membrane_decay=np.array([2048]))
    assert exact_ticks(coarse, WIDE.arithmetic) == 6
