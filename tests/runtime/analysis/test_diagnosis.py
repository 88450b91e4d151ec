"""Layers that are dead or saturated: each cause is found in a network that was built to have it."""

from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.runtime.analysis.drift import activity, diagnose, drift
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from tests.networks import chain, crowd, cuba


def layers(*weights, threshold=0.5, alpha=0.0, beta=0.5):
    """Layers with these weights (N, M)."""
    nodes = []
    for weight in weights:
        weight = np.atleast_2d(np.array(weight, float))
        nodes += [nir.Linear(weight), cuba(len(weight), alpha, beta, threshold=threshold)]
    width = nodes[0].weight.shape[1]
    graph = chain(*nodes, width=width, act=nodes[-2].weight.shape[0])
    return Artifact(graph, None, Convention(1e-3))


def diagnosed(artifact, raster=None, name="loihi1", quantisation=None, timesteps=20, **options):
    if raster is None:
        width = artifact.graph.nodes["input"].input_type["input"][0]
        raster = np.ones((1, timesteps, width), np.uint8)
    found = drift(artifact, chip(name, **options), raster, quantisation or Quantisation())
    return {finding.layer: finding for finding in found.findings}


def silent_first_axon(width, timesteps=20):
    raster = np.ones((1, timesteps, width), np.uint8)
    raster[:, :, 0] = 0
    return raster


@pytest.mark.parametrize(
    ("weight", "axon", "found"),
    [
        (0.3, 1, None),
        (0.1, 1, ("dead", "policy")),
        (1.0, 1, ("saturated", "policy")),
        (1.0, 0, ("dead", "input")),
    ],
)
def test_what_is_so_in_float_too_is_the_policys_or_the_inputs(weight, axon, found):
    seen = diagnosed(layers([[weight]]), np.full((1, 20, 1), axon, np.uint8)).get("n2")
    assert (seen and (seen.health, seen.cause)) == found


def test_weights_that_round_to_zero_are_counted_and_what_hears_them_is_not_blamed():
    # one weight of 1000 that never receives a spike takes the whole range, and 1.9 of it are 0.48
    artifact = layers([[1000.0, 1.9, 1.9]], [[4.0]], threshold=2.5)
    found = diagnosed(artifact, silent_first_axon(3))
    assert (found["n2"].health, found["n2"].cause) == ("dead", "weights")
    assert (found["n4"].health, found["n4"].cause) == ("dead", "input")
    assert "'n2' is silent" in found["n4"].detail
    assert "in float too" not in found["n4"].detail


def test_a_threshold_that_rounds_up_beside_a_large_weight_is_named():
    # the scale is 1: a weight of 1.9 and a threshold of 1.6 both become 2, and 2 is not above 2
    artifact = layers([[255.0, 1.9]], threshold=1.6)
    raster = np.zeros((1, 20, 2), np.uint8)
    raster[0, 5, 1] = 1
    found = diagnosed(artifact, raster)["n2"]
    assert (found.health, found.cause) == ("dead", "thresholds")


def test_a_leak_that_rounds_up_is_named():
    # a leak of 1.5 / 4096 becomes 2 / 4096: the membrane settles at 2,048 pushes and not at 2,731
    beta = 1 - 1.5 / 4096
    artifact = layers([[1.0]], threshold=2300.0, beta=beta)
    found = diagnosed(artifact, timesteps=7000)["n2"]
    assert (found.health, found.cause) == ("dead", "decays")


def test_an_overflow_that_silences_is_named():
    found = diagnosed(crowd())["n2"]
    assert (found.health, found.cause) == ("dead", "states")
    assert "39 numbers overflow" in found.detail


def test_fractions_that_a_small_current_loses_in_every_timestep_are_named():
    # of 128 state units a leak of 1/4096 takes 1 in each timestep: after 100 only 28 are left
    artifact = layers([[255.0, 2.0]], threshold=3.0, beta=1 - 1 / 4096)
    raster = np.zeros((1, 120, 2), np.uint8)
    raster[0, [0, 100], 1] = 1
    found = diagnosed(artifact, raster)["n2"]
    assert (found.health, found.cause) == ("dead", "states")
    assert "lose their fractions" in found.detail


@pytest.mark.parametrize(("lost", "detail"), [(0, "numbers are rounded"), (7, "7 numbers overf")])
def test_a_chip_without_ablation_is_said_to_round_or_to_overflow(lost, detail):
    artifact = layers([[1.0]])
    raster = np.ones((1, 20, 1), np.uint8)
    program = compile_program(artifact, chip("ideal"))
    twin = activity(artifact, None, raster)
    dead = replace(twin, spikes={"n2": 0 * twin.spikes["n2"]}, saturations={"n2": lost})
    (found,) = diagnose(program, raster, twin, {"chip": dead})
    assert (found.health, found.cause) == ("dead", "rounding")
    assert detail in found.detail


def test_a_chip_that_sends_several_spikes_where_float_sends_one_is_told_by_its_counts():
    artifact = layers([[0.4]])
    raster = np.ones((1, 20, 1), np.uint8)
    program = compile_program(artifact, chip("ideal"))
    twin = activity(artifact, None, raster)
    several = replace(twin, spikes={"n2": 3 * twin.spikes["n2"]})
    (found,) = diagnose(program, raster, twin, {"chip": several})
    assert (found.health, found.cause) == ("saturated", "counts")
    assert found.detail == "neurons send up to 3 spikes in a timestep, in float 1"
