"""Drift: a planted difference is found where it is, and none where there is none."""

from dataclasses import replace

import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.analysis.activity import Activity, chip_activity
from spikedeploy.runtime.analysis.drift import activity, drift, first_divergence
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ObservationError
from tests.networks import chain, cuba, popsan, spiking_mlp


def raster_of(artifact, batch=3, timesteps=5, seed=0, rate=0.3):
    width = artifact.graph.nodes["input"].input_type["input"][0]
    return (np.random.default_rng(seed).random((batch, timesteps, width)) < rate).astype(np.uint8)


def thresholds(*values):
    """Neurons without memory, one for each axon, whose weight is 1."""
    neurons = cuba(len(values), alpha=0.0, beta=0.5, threshold=0.5)
    neurons.v_threshold = np.array(values, float)
    graph = chain(nir.Linear(np.eye(len(values))), neurons, width=len(values), act=len(values))
    return Artifact(graph, None, Convention(1e-3))


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.sampled_from([popsan, spiking_mlp]))
def test_on_the_ideal_chip_nothing_drifts(seed, network):
    artifact = network(seed=seed % 100)
    found = drift(artifact, chip("ideal"), raster_of(artifact, seed=seed))
    assert found.first is None
    assert found.diverged == 0
    assert found.output.rms < 1e-14
    assert all(layer.distance == layer.differing == 0 for layer in found.layers)


def test_the_first_difference_is_found_by_inference_timestep_and_neuron():
    artifact = thresholds(0.9, 1.0 - 1e-6, 0.9)
    raster = np.zeros((2, 4, 3), np.uint8)
    raster[:, :, 0] = 1
    raster[1, 2:, 1] = 1
    found = drift(artifact, chip("loihi1"), raster)
    # 255 mantissas of 1 - 1e-6 round to 255, which a weight of 255 does not exceed
    assert found.first.describe() == (
        "inference 1, timestep 2, layer 'n2', neuron 1; spikes on the chip: 0 (membrane 1, "
        "threshold 1), in float: 1 (1, 0.999999)"
    )
    assert found.diverged == 1
    (layer,) = found.layers
    assert layer.first == (1, 2, 1)
    # the neuron keeps half of its membrane: the second of the two timesteps spikes on both
    assert layer.differing == pytest.approx(1 / 24)
    assert (layer.lost, layer.woken, layer.saturations) == (0, 0, 0)


def test_of_one_timestep_the_layer_that_hears_first_is_named():
    def ran(**layers):
        spikes = {name: np.array(rows)[None, :, None] for name, rows in layers.items()}
        zeros = {name: np.zeros(rows.shape) for name, rows in spikes.items()}
        one = dict.fromkeys(spikes, np.ones(1))
        return Activity(spikes, zeros, one, np.zeros((1, 3, 1)), dict.fromkeys(spikes, 0))

    twin = ran(a=[0, 0, 0], b=[0, 0, 0])
    reset = ran(a=[1, 0, 0])
    reset = replace(reset, reached={"a": np.full((1, 3, 1), np.nan)})
    assert (
        "(membrane not known before its reset, threshold 1)"
        in first_divergence(twin, reset, ["a"]).describe()
    )
    assert first_divergence(twin, ran(a=[0, 1, 0], b=[0, 1, 0]), ["b", "a"]).layer == "b"
    assert first_divergence(twin, ran(a=[0, 1, 0], b=[0, 0, 1]), ["b", "a"]).layer == "a"


def test_ablation_steps_add_one_rounding_after_another_and_end_on_the_chip():
    artifact = popsan()
    raster = raster_of(artifact)
    found = drift(artifact, chip("loihi1", weight_bits=3), raster)
    assert tuple(step.name for step in found.ablation) == (
        "weights",
        "thresholds",
        "decays",
        "states",
    )
    last = found.ablation[-1]
    assert last.output == found.output
    assert last.distance == {layer.name: layer.distance for layer in found.layers}
    assert found.ablation[0].distance["n2"] > 0


@pytest.mark.parametrize("granularity", ["layer", "channel"])
def test_membranes_are_compared_in_float_units(granularity):
    artifact = popsan()
    raster = raster_of(artifact, timesteps=1)
    twin = activity(artifact, None, raster)
    program = compile_program(artifact, chip("loihi1"), Quantisation(granularity))
    seen = chip_activity(program, raster)
    error = np.abs(seen.reached["n2"] - twin.reached["n2"])
    # at most 30 axons and the bias, each off by half a weight step
    assert (error <= 31 * 0.5 * 64 * program.layer("n2").scale).all()
    assert error.max() > 0


def test_kept_states_run_on_from_inference_to_inference():
    artifact = spiking_mlp()
    kept = replace(artifact, convention=replace(artifact.convention, state="kept"))
    raster = raster_of(artifact, timesteps=16)
    anew, on = (activity(each, None, raster) for each in (artifact, kept))
    np.testing.assert_array_equal(anew.spikes["n2"][0], on.spikes["n2"][0])
    assert (anew.spikes["n2"][1] != on.spikes["n2"][1]).any()
    found = drift(kept, chip("ideal"), raster)
    assert (found.inferences, found.timesteps, found.first) == (3, 16, None)


def test_choices_are_compared_as_choices_and_actions_as_actions():
    chooses, acts = spiking_mlp(seed=1), popsan()
    low = chip("loihi1", weight_bits=2)
    observations = np.random.default_rng(0).uniform(-1, 1, (200, 6))
    found = drift(chooses, low, chooses.codec.encode(observations))
    assert found.output.kind == "choice"
    assert 0 < found.output.rms <= found.output.largest == 1
    found = drift(acts, low, raster_of(acts))
    assert found.output.kind == "action"
    assert 0 < found.output.rms <= found.output.largest <= 2
    # of another length than the codec's: an open-loop raster
    assert drift(acts, low, raster_of(acts, timesteps=7)).output.kind == "output"


def test_a_raster_of_another_network_is_refused():
    with pytest.raises(ObservationError, match=r"takes 30 spike trains"):
        drift(popsan(), chip("loihi1"), np.zeros((2, 5, 7), np.uint8))
