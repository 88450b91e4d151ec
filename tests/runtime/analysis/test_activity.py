"""The recorded activity of networks, in float and on chips, and distances of spike trains."""

import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.analysis.activity import (
    chip_activity,
    float_activity,
    mean_distance,
    van_rossum,
)
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.running_network import FloatMachine
from tests.networks import graph, lif, popsan, spiking_mlp


def raster_of(artifact, batch=3, timesteps=8, seed=0):
    width = artifact.graph.nodes["input"].input_type["input"][0]
    return (np.random.default_rng(seed).random((batch, timesteps, width)) < 0.3).astype(np.uint8)


def looped():
    rng = np.random.default_rng(0)
    return Artifact(
        graph(
            "input->w, w->n, n->back, back->n, n->output",
            input=nir.Input(np.array([4])),
            w=nir.Linear(rng.normal(size=(5, 4))),
            n=lif(5),
            back=nir.Linear(rng.normal(size=(5, 5))),
            output=nir.Output(np.array([5])),
        ),
        None,
        Convention(1e-3),
    )


@pytest.mark.parametrize("artifact", [popsan(), spiking_mlp(), looped()])
def test_the_float_twin_recorded_step_by_step_is_the_float_twin(artifact):
    raster = raster_of(artifact)
    machine = FloatMachine(artifact)
    output = machine.infer(raster)
    seen = float_activity(artifact, raster)
    np.testing.assert_allclose(seen.output, output, rtol=0, atol=1e-12)
    for name, spikes in machine.spikes.items():
        np.testing.assert_array_equal(seen.spikes[name], spikes)


@pytest.mark.parametrize("name", ["ideal", "loihi1", "loihi1-nengo"])
@pytest.mark.parametrize("artifact", [popsan(), spiking_mlp(), looped()])
def test_a_spike_is_where_the_membrane_before_the_reset_is_above_the_threshold(name, artifact):
    program = compile_program(artifact, chip(name))
    seen = chip_activity(program, raster_of(artifact))
    for layer in program.layers:
        above = seen.reached[layer.name] > layer.threshold * layer.scale * (1 + 1e-12)
        np.testing.assert_array_equal(above, seen.spikes[layer.name])
    assert any(spikes.any() for spikes in seen.spikes.values())


def train(*times, length=8):
    spikes = np.zeros((1, length, 1), np.uint8)
    spikes[0, list(times)] = 1
    return spikes


@pytest.mark.parametrize("time", [0, 3, 7])
@pytest.mark.parametrize("tau", [0.5, 5.0, 1e4])
def test_a_spike_more_is_half_wherever_it_is(time, tau):
    assert van_rossum(train(time), train(), tau).item() == pytest.approx(0.5)


def test_a_short_kernel_counts_what_differs_and_a_long_one_the_difference_of_counts():
    one, other = train(0, 2, 5), train(1, 2)
    assert van_rossum(one, other, 1e-3).item() == pytest.approx(3 / 2)
    # (3 - 2)**2 / 2
    assert van_rossum(one, other, 1e6).item() == pytest.approx(1 / 2, abs=1e-4)


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 5.0]))
def test_it_is_the_integral_of_the_definition(seed, tau):
    rng = np.random.default_rng(seed)
    one, other = rng.integers(0, 2, (2, 1, 8, 1), dtype=np.uint8)
    fine = 1000
    time = (np.arange((8 + 20 * int(tau)) * fine) + 0.5) / fine
    traces = [
        sum(np.where(time >= t, np.exp(-(time - t) / tau), 0.0) for t in np.flatnonzero(spikes))
        for spikes in (one, other)
    ]
    integral = ((traces[0] - traces[1]) ** 2).sum() / fine / tau
    assert van_rossum(one, other, tau).item() == pytest.approx(integral, abs=1e-3)


def test_inferences_that_go_on_are_one_train():
    # four inferences of one timestep: the spike moves by one timestep, over the border of two
    one, other = (train(time, length=4).reshape(4, 1, 1) for time in (1, 2))
    assert mean_distance(one, other) == pytest.approx((0.5 + 0.5) / 4)
    assert mean_distance(one, other, trains=(4,)) == pytest.approx((1 - np.exp(-1 / 5)) / 4)
    assert mean_distance(one, other, trains=(2, 2)) == pytest.approx((0.5 + 0.5) / 4)
