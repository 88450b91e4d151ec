"""Bounds hold for the worst spikes, and are no larger than they need to be."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.bounds import bounds
from runtime.chip import chip
from runtime.convention import Convention
from runtime.fixed import Register
from runtime.interpreter import Interpreter
from runtime.program import Program, Synapses
from tests.programs import layer, random_programs, rasters

WIDE = chip("loihi1", current=Register(60, "none"), membrane=Register(60, "none"))


def one_neuron(weights, decays, threshold=131071 << 6):
    weight = np.array(weights, np.int16)[:, None]
    axons = (Synapses("input", weight, delay=1),)
    neuron = layer(WIDE.fixed, "n", weight.T, axons, decays=decays, threshold=threshold, start=1)
    return Program(WIDE, Convention(1e-3), "input", len(weight), (neuron,), "n", None)


@settings(max_examples=60, deadline=None)
@given(random_programs(), st.integers(0, 2**32 - 1), st.sampled_from([0.2, 1.0]))
def test_no_spikes_exceed_the_bounds(program, seed, rate):
    raster = rasters(program, 2, 6, rate, seed)[0]
    fixed = program.chip.fixed
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
    limits = bounds(program, program.layers[0], WIDE.fixed, timesteps)
    assert limits.partial == 255
    # rounding toward zero keeps the states a little nearer to zero
    assert -ran.current.min() == pytest.approx(limits.current, rel=1e-3)
    assert -ran.membrane.min() == pytest.approx(limits.below, rel=1e-3)


def test_a_membrane_cannot_be_far_above_its_threshold():
    program = one_neuron([200, -55], decays=(4095, 0), threshold=1000 << 6)
    limits = bounds(program, program.layers[0], WIDE.fixed, None)
    assert limits.above == (1000 + 200) * 64
    assert limits.below == np.inf


def test_an_endless_leak_has_a_limit():
    program = one_neuron([200, -55], decays=(2047, 1024))
    limits = bounds(program, program.layers[0], WIDE.fixed, None)
    assert limits.current == 2 * 200 * 64
    assert limits.below == 4 * 2 * 55 * 64
