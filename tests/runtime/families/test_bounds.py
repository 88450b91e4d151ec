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
from spikedeploy.runtime.families.cuba.quantise import bounds
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


@settings(max_examples=24)
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
