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
from spikedeploy.runtime.families.cuba.quantise import bounds, spikes_without_overflow
from tests.programs import layer, random_programs, rasters

WIDE = chip("loihi1", current=Register(60, "none"), membrane=Register(60, "none"))


def one_neuron(weights, decays, threshold=131071 << 6, **fields):
    weight = np.array(weights, np.int16)
    weight = weight if weight.ndim == 2 else weight[:, None]
    axons = (Synapses("input", weight, delay=1),)
    neuron = layer(
        WIDE.arithmetic, "n", weight.T, axons, decays=decays, threshold=threshold, start=1
    )
    neuron = replace(neuron, **{name: np.array(values) for name, values in fields.items()})
    return Program(WIDE, Convention(1e-3), "input", len(weight), (neuron,), "n", None)


@settings(max_examples=60)
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


KEEPS = {"membrane_decay": [4096]}
HIGH = {"threshold": [1000 << 6]}


@pytest.mark.parametrize(
    ("weights", "decays", "fields", "timesteps", "expected"),
    [
        # no membrane stays above its threshold, but for what arrives and a bias that raises it
        ([200, -55], (4095, 0), HIGH, None, {"above": 1200 * 64}),
        ([200, -55], (4095, 0), HIGH, None, {"below": np.inf}),
        ([200], (4095, 0), HIGH | {"voltage_bias": [640]}, None, {"above": 1210 * 64}),
        ([200], (4095, 0), HIGH | {"voltage_bias": [-640]}, None, {"above": 1200 * 64}),
        # leaks bound a window without an end
        ([200, -55], (2047, 1024), {}, None, {"current": 2 * 200 * 64, "below": 8 * 55 * 64}),
        ([200], (0, 0), KEEPS, None, {"below": 0.0}),
        ([200], (0, 0), KEEPS | {"voltage_bias": [-1]}, None, {"below": np.inf}),
        # and windows of up to a hundred timesteps are bounded without one
        ([-200, 55], (4095, 0), KEEPS, 100, {"below": 100 * 200 * 64}),
        ([-200, 55], (4095, 0), KEEPS, 101, {"below": np.inf}),
        # the neuron that receives most decides, and the bias axon counts
        ([[3, 200]], (0, 0), {}, 4, {"partial": 200}),
        ([200, -55], (4095, 4095), {"bias": [7]}, 4, {"partial": 207, "drive": 207 * 64.0}),
        ([200, -55], (4095, 4095), {"bias": [-150]}, 4, {"partial": 205}),
    ],
)  # fmt: skip
def test_the_bounds_are_these(weights, decays, fields, timesteps, expected):
    program = one_neuron(weights, decays, **fields)
    found = bounds(program, program.layers[0], WIDE.arithmetic, timesteps)
    assert {name: getattr(found, name) for name in expected} == expected


@pytest.mark.parametrize(
    ("weights", "fields", "most", "spikes"),
    [
        # a current of 1 halves, a membrane keeps 3/4: 1, 1.25, 1.1875, … is the membrane's answer
        ([200, -55], {}, 10 * 200 * 64, 8),
        # an always-on axon of 3 and a voltage bias of 64 arrive in each of the 5 timesteps
        ([200, -55], {"bias": [-3], "voltage_bias": [64]}, 10 * 200 * 64, (102400 - 1280) // 12800),
        ([200, -55], {"bias": [-3], "voltage_bias": [64]}, 100, -1),
        # the neuron with the highest peak counts
        ([[200, 200]], {"membrane_decay": [0, 3072]}, 10 * 200 * 64, 8),
        ([[200, 200]], {"membrane_decay": [3072, 0]}, 10 * 200 * 64, 8),
        ([[200, 200]], {"bias": [-3000, 0]}, 100, -1),
        ([0, 0], {}, 1 << 20, -1),
    ],
)
def test_so_many_spikes_cannot_overflow_as_the_peak_of_one_allows(weights, fields, most, spikes):
    neuron = one_neuron(weights, (2047, 1024), **fields).layers[0]
    assert spikes_without_overflow(neuron, WIDE.arithmetic, 5, most) == spikes


@settings(max_examples=60)
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
