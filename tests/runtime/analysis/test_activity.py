"""The float twin and every chip are recorded alike."""

from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.runtime.analysis.activity import chip_activity, float_activity
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.network import FloatMachine
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


def test_the_ideal_chip_reaches_what_the_float_twin_reaches():
    artifact = popsan()
    raster = raster_of(artifact)
    ideal = chip_activity(compile_program(artifact, chip("ideal")), raster)
    for name, reached in float_activity(artifact, raster).reached.items():
        np.testing.assert_allclose(ideal.reached[name], reached, rtol=0, atol=1e-12)


def test_what_only_the_interpreter_computes_is_recorded_alike():
    program = compile_program(popsan(), chip("loihi1"))
    layers = [
        replace(a, synapses=tuple(replace(s, shift=1) for s in a.synapses)) for a in program.layers
    ]
    shifted = replace(program, layers=tuple(layers))
    raster = raster_of(popsan())
    seen, wanted = chip_activity(shifted, raster), trace(shifted, raster)
    for name, ran in wanted.items():
        np.testing.assert_array_equal(seen.spikes[name], ran.spikes)
        assert seen.saturations[name] == 0
    spikes = wanted[program.output].spikes
    np.testing.assert_array_equal(seen.output, program.readout(spikes))
    assert spikes.any()
