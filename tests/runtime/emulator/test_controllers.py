"""A policy file acts on a robot: in float, on the ideal chip, and on a real one."""

from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.emulator.controllers import Sampler, SpikingController
from spikedeploy.runtime.emulator.running_network import FloatMachine
from spikedeploy.runtime.errors import ArtifactError, ConfigError, ObservationError, RuleError
from tests.networks import chain, cuba, event_driven, popsan, spiking_mlp

LOIHI1 = chip("loihi1")
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


@pytest.mark.parametrize("name", [None, "ideal", "loihi1"])
def test_acting_alone_is_acting_in_a_batch(name):
    controller, actions = acted(popsan(), name)
    alone = np.stack([controller.act(observation) for observation in OBSERVATIONS[:9]])
    np.testing.assert_allclose(alone, actions[:9], rtol=0, atol=1e-12)
    assert controller.ledger.inferences == len(OBSERVATIONS) + 9


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
    leaky = nir.Threshold(np.full(6, 0.01))
    artifact = Artifact(chain(cuba(6), leaky, width=6, act=6), None, popsan().convention)
    machine = FloatMachine(artifact)
    output = machine.infer(np.ones((2, 4, 6), np.uint8))
    assert output.shape == (2, 4, 6)
    assert output.any()
    with pytest.raises(RuleError, match="events cannot be counted: rule primitive: node 'n2'"):
        machine.ledger  # noqa: B018


CHIPS = [None, "ideal", "loihi1"]


def kept(artifact):
    return replace(artifact, convention=replace(artifact.convention, state="kept"))


def random(artifact):
    low, high = artifact.codec.encoder.low, artifact.codec.encoder.high
    code = replace(artifact.codec, encoder=RateEncoder(low, high, "bernoulli"))
    return replace(artifact, codec=code)


def driven(artifact, name, seed=0, count=30, **options):
    """The actions of one robot that sees the observations one after another."""
    controller = SpikingController(artifact, name and chip(name), **options)
    controller.reset(seed)
    seen = np.random.default_rng(1).uniform(-1, 1, (count, artifact.codec.encoder.observed))
    return [controller.act(each).tolist() for each in seen]


def test_a_random_code_acts_alike_with_the_same_seed_and_otherwise_with_another():
    policy = random(spiking_mlp(squash="tanh"))
    assert driven(policy, "loihi1", seed=3) == driven(policy, "loihi1", seed=3)
    assert driven(policy, "loihi1", seed=3) != driven(policy, "loihi1", seed=4)


@pytest.mark.parametrize("name", CHIPS)
def test_sampled_actions_come_from_the_seed_of_the_episode(name):
    policy = spiking_mlp()
    drawn = driven(policy, name, 3, sampled=True)
    assert drawn == driven(policy, name, 3, sampled=True)
    assert drawn != driven(policy, name, 4, sampled=True)
    assert drawn != driven(policy, name, 3)


def test_actions_are_drawn_as_often_as_the_softmax_says():
    scores = np.array([0.0, 1.0, -np.inf, 2.0, 1000.0 - 999.0])
    expected = np.exp(scores) / np.exp(scores).sum()
    drawn = Sampler(True)(np.tile(scores, (20_000, 1)))
    found = np.bincount(drawn, minlength=5) / 20_000
    np.testing.assert_allclose(found, expected, atol=4 * 0.5 / 20_000**0.5)
    assert found[2] == 0


def test_numbers_cannot_be_sampled():
    with pytest.raises(ConfigError, match="only one of several actions can be sampled"):
        SpikingController(popsan(), sampled=True)


def test_what_remembers_says_so():
    policy = spiking_mlp()
    assert not SpikingController(policy).remembers
    assert SpikingController(policy, sampled=True).remembers
    assert SpikingController(random(policy)).remembers
    assert SpikingController(kept(policy)).remembers
    assert SpikingController(event_driven()).remembers


@pytest.mark.parametrize("name", CHIPS)
def test_a_delta_code_starts_anew_with_every_episode(name):
    controller = SpikingController(event_driven(), name and chip(name))
    seen = np.random.default_rng(1).normal(0, 2, (15, 3))
    first = [controller.act(each).tolist() for each in seen]
    assert controller.ledger.counts.sum(axis=0).any()
    controller.reset(7)
    assert [controller.act(each).tolist() for each in seen] == first
    assert [controller.act(each).tolist() for each in seen] != first


@pytest.mark.parametrize("state", ["kept", "reset"])
def test_another_number_of_robots_needs_a_reset(state):
    policy = event_driven()
    policy = replace(policy, convention=replace(policy.convention, state=state))
    controller = SpikingController(policy)
    controller.act_batch(np.zeros((2, 3)))
    with pytest.raises(ObservationError, match=r"levels of 2 robots, .* of 5\. Call reset"):
        controller.act_batch(np.zeros((5, 3)))
    controller.reset(0)
    assert controller.act_batch(np.zeros((5, 3))).shape == (5, 2)


def remembering():
    """Policies with dice, with kept membranes, and with levels of a delta code."""
    mlp = spiking_mlp(squash="tanh")
    return {"dice": random(mlp), "membranes": kept(mlp), "levels": event_driven(timesteps=2)}


@pytest.mark.parametrize("what", ["dice", "membranes", "levels"])
def test_what_is_remembered_is_alike_on_the_ideal_chip_and_in_float(what):
    policy = remembering()[what]
    np.testing.assert_allclose(driven(policy, "ideal", 3), driven(policy, None, 3), atol=1e-12)


@pytest.mark.parametrize("what", ["membranes", "levels"])
@pytest.mark.parametrize("name", CHIPS)
def test_robots_in_a_batch_remember_their_own(name, what):
    policy = remembering()[what]
    seen = np.random.default_rng(1).normal(0, 1, (8, 3, policy.codec.encoder.observed))
    together = SpikingController(policy, name and chip(name))
    actions = np.stack([together.act_batch(step) for step in seen])
    for robot in range(3):
        alone = SpikingController(policy, name and chip(name))
        expected = np.stack([alone.act(step[robot]) for step in seen])
        np.testing.assert_allclose(actions[:, robot], expected, rtol=0, atol=1e-12)
