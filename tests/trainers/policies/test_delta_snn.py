import json

import numpy as np
import pytest
import torch

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.schema import validated
from spikedeploy.trainers.config import DeltaSnnConfig, RunConfig
from spikedeploy.trainers.policies import DeltaSnnPolicy, build, from_config
from spikedeploy.trainers.policies.delta import (
    channel_weights,
    delta_artifact,
    delta_codec,
    event_channels,
    live_neurons,
)
from tests.delta_policies import arriving, delta_policy, followed, thinned, walk

SHAPES = [
    {},
    {"code": "unary"},
    {"hidden": 0},
    {"skip": False},
    {"head": "discrete"},
    {"most": 1, "events_above": 128},
    {"integrated": True},
    {"clock": "gated"},
    {"clock": "gated", "integrated": True},
]


@pytest.mark.parametrize("shape", SHAPES)
def test_a_window_from_the_beginning_equals_single_steps(shape):
    policy = delta_policy(**shape).double()
    observation, burn_in = walk(), 4
    mean, events, spikes = followed(policy, observation)
    moved, seen = arriving(policy, events)
    # the burn-in of a window that starts the episode holds nothing
    before = torch.zeros(1, burn_in, 5, dtype=torch.float64)
    found, raster = policy.unrolled(
        torch.cat([before, seen[None]], 1),
        torch.cat([before, moved[None]], 1),
        policy.weights(),
        burn_in,
        torch.tensor([True]),
    )
    np.testing.assert_allclose(found[0, burn_in:].numpy(), mean, atol=1e-12)
    np.testing.assert_array_equal(raster[0, burn_in:].numpy(), spikes)
    assert not policy.hidden or spikes.any()


def test_a_window_from_the_middle_forgets_how_it_began():
    policy = delta_policy(hidden=8).double()
    _, events, spikes = followed(policy, walk(200))
    moved, seen = arriving(policy, events)
    window, runs_on = slice(100, 160), torch.tensor([False])
    _, raster = policy.unrolled(
        seen[None, window], moved[None, window], policy.weights(), 20, runs_on
    )
    agree = (raster[0, 20:].numpy() == spikes[120:160]).mean()
    assert agree > 0.95


def test_states_rest_behind_the_burn_in_of_a_beginning():
    policy = delta_policy().double()
    drive = torch.ones(2, 8, 5, dtype=torch.float64)
    begins = torch.tensor([True, False])
    mean, _ = policy.unrolled(drive, drive, policy.weights(), 5, begins)
    assert not torch.equal(mean[0, 5:], mean[1, 5:])
    alone, _ = policy.unrolled(drive[:1, 5:], drive[:1, 5:], policy.weights(), 0, begins[:1])
    torch.testing.assert_close(mean[0, 5:], alone[0])


@pytest.mark.parametrize("code", ["one-hot", "unary"])
@pytest.mark.parametrize("most", [1, 3])
def test_events_are_those_of_the_runtimes_encoder(code, most):
    policy = thinned(delta_policy(code=code, most=most), 1.0).double()
    observation = walk(300)
    _, events, _ = followed(policy, observation)
    assert np.abs(events).max() == most
    spikes = delta_codec(policy).encode_episode(observation)
    np.testing.assert_array_equal(spikes[:, 0], event_channels(policy, events))


def test_an_event_weighs_as_its_size_in_both_codes():
    for code in ("one-hot", "unary"):
        policy = thinned(delta_policy(code=code), 1.0).double()
        events = np.array([[-3, 2, 0, 1, -1]])
        weight = policy.into().numpy()
        channels = event_channels(policy, events) @ channel_weights(policy, weight).T
        expected = (events * policy.step.numpy()) @ weight.T
        np.testing.assert_allclose(channels, expected)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_policy_is_built_from_its_spec(shape):
    policy = delta_policy(**shape)
    again = build(json.loads(json.dumps(policy.spec())))
    again.load_state_dict(policy.state_dict())
    expected, found = (followed(each, walk()) for each in (policy, again))
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_configuration_makes_the_policy():
    policy = from_config(DeltaSnnConfig(hidden=4, code="unary"), 5, 3, 2.5, head="discrete")
    assert isinstance(policy, DeltaSnnPolicy)
    assert (policy.hidden, policy.code, policy.head, policy.normalizer.clip) == (
        4, "unary", "discrete", 2.5,
    )  # fmt: skip
    wrong = {"algorithm": "sparse", "recipe": "x", "policy": {"kind": "delta-snn", "hidden": -1}}
    with pytest.raises(ConfigError, match="hidden"):
        validated(RunConfig, wrong, "here")


def test_pipelined_events_act_one_control_step_late_and_hidden_spikes_two():
    """One event in control step 0; the numbers are worked out by hand."""
    policy = DeltaSnnPolicy(1, 1, 1, step=1.0, current_decay=1.0).double()
    policy.set_decays(torch.tensor([0.5]).double(), torch.tensor([0.5]).double())
    with torch.no_grad():
        policy.into.weight.fill_(2.0)
        policy.out.weight.fill_(4.0)
        policy.past.weight.fill_(8.0)
        policy.bias.fill_(0.0)
    mean, events, spikes = followed(policy, np.array([[1.0], [1.0], [1.0], [1.0]]))
    assert events[:, 0].tolist() == [1, 0, 0, 0]
    # I = 2 from control step 1 on, V = 2 > 1 in each
    assert spikes[:, 0].tolist() == [0, 1, 1, 1]
    # y[1] = 8 past ; y[2] = 4 + 4 of the first hidden spike ; y[3] = 4 + 4
    np.testing.assert_allclose(mean[:, 0], [0, 8, 8, 8])
    gated = build({**policy.spec(), "clock": "gated"}).double()
    gated.load_state_dict(policy.state_dict())
    mean, _, spikes = followed(gated, np.array([[1.0], [1.0]]))
    assert spikes[:, 0].tolist() == [1, 1]
    np.testing.assert_allclose(mean[:, 0], [12, 10])


def test_a_linear_policy_reads_the_observation_through_its_events():
    policy = thinned(delta_policy(hidden=0, clock="gated"), 1.0).double()
    observation = walk(40)
    mean, events, _ = followed(policy, observation)
    level = np.cumsum(events, axis=0) * policy.step.numpy()
    expected = level @ policy.past().numpy().T + policy.action_bias.numpy()
    # the readouts leak by 1/4096 a step
    np.testing.assert_allclose(mean, expected, atol=0.05)
    normalised = policy.normalizer(torch.from_numpy(observation)).numpy()
    assert (np.abs(level - normalised) <= 1.5 * policy.step.numpy() + 3 * 0.6).all()


def test_a_latent_is_the_first_step_of_an_episode():
    policy = delta_policy().double()
    observation = torch.from_numpy(walk(6))
    mean, _, spikes = policy.advance(observation, policy.rest(6))
    found = policy.latent(observation)
    assert torch.equal(found.mean, mean)
    assert torch.equal(found.hidden, spikes)


def test_dead_neurons_are_left_out_and_change_no_action():
    policy = delta_policy(hidden=8, left=1.0).double()
    policy.bias.fill_(-0.1)
    policy.into.mask[1] = 0.0  # without input it cannot spike
    policy.out.mask[:, 2] = 0.0  # no outgoing synapses
    policy.into.mask[3] = 0.0  # without input, but it spikes by its bias
    policy.bias[3] = 0.7
    assert live_neurons(policy).tolist() == [k not in (1, 2) for k in range(8)]
    nodes = delta_artifact(policy).graph.nodes
    assert nodes["lif1"].r.size == 6
    assert nodes["fc1"].weight.shape[0] == nodes["fc2"].weight.shape[1] == 6
    whole = followed(policy, walk())
    policy.into.weight[2], policy.bias[2], policy.out.weight[:, 1] = 9.0, 3.0, 5.0
    changed = followed(policy, walk())
    np.testing.assert_array_equal(whole[0], changed[0])


def test_an_observation_that_nothing_reads_sends_nothing():
    policy = delta_policy(left=1.0).double()
    policy.into.mask[:, 3] = policy.past.mask[:, 3] = 0.0
    policy.out.mask[:, 0] = 0.0
    policy.into.mask[1:, 4] = policy.past.mask[:, 4] = 0.0  # read by a dead neuron alone
    assert np.isinf(delta_codec(policy).encoder.step).tolist() == [False] * 3 + [True] * 2
    assert not event_channels(policy, np.ones((1, 5))).reshape(5, -1)[3:].any()


@pytest.mark.parametrize("hidden", [0, 4])
def test_a_policy_without_synapses_still_has_a_graph(hidden):
    policy = delta_policy(hidden=hidden, left=0.0).double()
    artifact = delta_artifact(policy)
    assert artifact.graph.nodes["output"].output_type["output"].tolist() == [2]
    assert {"fc1", "lif1", "fc2"}.isdisjoint(artifact.graph.nodes)
