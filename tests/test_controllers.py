"""A policy file acts on a robot: in float, on the ideal chip, and on a real one."""

from dataclasses import replace

import nir
import numpy as np
import pytest

from runtime.artifact import Artifact
from runtime.chip import chip
from runtime.controllers import SpikingController
from runtime.errors import ArtifactError, ObservationError, RuleError
from runtime.float_machine import FloatMachine
from tests.networks import chain, cuba, popsan

OBSERVATIONS = np.random.default_rng(5).normal(size=(200, 3))


def acted(artifact, name, **options):
    controller = SpikingController(artifact, name and chip(name), **options)
    controller.reset(0)
    return controller, controller.act_batch(OBSERVATIONS)


def test_the_ideal_chip_acts_as_the_float_twin_spike_by_spike():
    twin, expected = acted(popsan(), None)
    ideal, actions = acted(popsan(), "ideal")
    np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-9)
    for event in ("spike_in", "sop", "bias_sop", "spike_out", "message"):
        assert ideal.ledger.by_layer(event) == twin.ledger.by_layer(event)
    assert ideal.ledger.sparsity == twin.ledger.sparsity


def test_eight_bits_act_almost_like_float():
    _, expected = acted(popsan(hidden=(64, 64)), None)
    _, actions = acted(popsan(hidden=(64, 64)), "loihi1")
    assert 0 < np.abs(actions - expected).mean() < 0.15


def test_fewer_bits_act_less_like_float():
    artifact = popsan(hidden=(64, 64))
    _, expected = acted(artifact, None)
    errors = []
    for bits in (8, 4, 2):
        controller = SpikingController(artifact, chip("loihi1", weight_bits=bits))
        errors.append(np.abs(controller.act_batch(OBSERVATIONS) - expected).mean())
    assert errors == sorted(errors)


@pytest.mark.parametrize("name", [None, "ideal", "loihi1"])
def test_acting_alone_is_acting_in_a_batch(name):
    controller, actions = acted(popsan(), name)
    alone = np.stack([controller.act(observation) for observation in OBSERVATIONS[:9]])
    np.testing.assert_allclose(alone, actions[:9], rtol=0, atol=1e-12)
    assert controller.ledger.inferences == len(OBSERVATIONS) + 9


@pytest.mark.parametrize("name", [None, "ideal", "loihi1"])
def test_kept_states_make_the_past_matter_until_reset(name):
    artifact = popsan()
    kept = replace(artifact, convention=replace(artifact.convention, state="kept"))
    controller = SpikingController(kept, name and chip(name))
    controller.reset(0)
    first = [controller.act(observation) for observation in OBSERVATIONS[:5]]
    assert controller.act(OBSERVATIONS[0]).tolist() != first[0].tolist()
    controller.reset(1)
    again = [controller.act(observation) for observation in OBSERVATIONS[:5]]
    np.testing.assert_array_equal(again, first)


def test_options_reach_the_compiler():
    _, nearest = acted(popsan(), "loihi1")
    _, truncated = acted(popsan(), "loihi1", rounding="truncate")
    assert (nearest != truncated).any()


@pytest.mark.parametrize("name", [None, "loihi1"])
def test_an_observation_with_nan_is_refused(name):
    controller = SpikingController(popsan(), name and chip(name))
    with pytest.raises(ObservationError, match="nan at index 1"):
        controller.act(np.array([0.0, np.nan, 0.0]))


def test_a_file_without_codec_cannot_act():
    artifact = Artifact(chain(cuba(6), width=6, act=6), None, popsan().convention)
    with pytest.raises(ArtifactError, match="no codec"):
        SpikingController(artifact)


def test_a_graph_that_no_chip_can_hold_still_runs_in_float():
    leaky = nir.LI(*(np.full(6, value) for value in (0.01, 1.0, 0.0)))
    artifact = Artifact(chain(cuba(6), leaky, width=6, act=6), None, popsan().convention)
    machine = FloatMachine(artifact)
    output = machine.infer(np.ones((2, 4, 6), np.uint8))
    assert output.shape == (2, 4, 6)
    assert output.any()
    with pytest.raises(RuleError, match="events cannot be counted: node 'n2'"):
        machine.ledger  # noqa: B018


def test_the_float_twin_keeps_no_rows_when_told_so():
    controller = SpikingController(popsan(), ledger="none")
    controller.act_batch(OBSERVATIONS)
    assert controller.ledger.inferences == 0
