import numpy as np
import pytest
import torch

from spikedeploy.trainers.config import DeltaSnnConfig
from spikedeploy.trainers.policies import DeltaSnnPolicy
from spikedeploy.trainers.policies.delta_policy import (
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
    {"most": 1},
    {"integrated": True},
    {"clock": "gated"},
    {"clock": "gated", "integrated": True},
    {"timesteps": 3},
    {"timesteps": 2, "hidden": 0},
    {"timesteps": 4, "integrated": True},
]


@pytest.mark.parametrize("shape", SHAPES)
def test_a_window_from_the_beginning_equals_single_steps(shape):
    policy, burn_in = delta_policy(**shape).double(), 4
    mean, events, spikes = followed(policy, walk())
    moved, seen = arriving(policy, events)
    # the burn-in of a window that starts the episode holds nothing
    before = torch.zeros(1, burn_in * policy.timesteps, policy.observations, dtype=torch.float64)
    moved, seen = (torch.cat([before, each[None]], 1) for each in (moved, seen))
    begins = torch.tensor([True])
    found, raster = policy.unrolled(seen, moved, policy.weights(), burn_in, begins)
    np.testing.assert_allclose(found[0, burn_in:].numpy(), mean, atol=1e-12)
    sent = (np.abs(spikes) > 0).reshape(len(mean), policy.timesteps, -1).sum(1)
    np.testing.assert_array_equal(raster[0, burn_in:].numpy(), sent)
    assert not policy.hidden or np.abs(spikes).max() > 0


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


def undecayed(config):
    """A policy of one neuron whose current does not decay."""
    policy = DeltaSnnPolicy(1, 1, config).double()
    policy.current_decay = 1.0
    return policy


def test_pipelined_events_act_one_control_step_late_and_hidden_spikes_two():
    """One event in control step 0; the numbers are worked out by hand."""
    config = DeltaSnnConfig(hidden=1)
    policy = undecayed(config)
    policy.step.fill_(1.0)
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
    # three timesteps: the action of control step 0 has 4 of the spike and 8 / 2 of the skip
    config = config.model_copy(update={"timesteps": 3})
    whole = undecayed(config)
    whole.load_state_dict(policy.state_dict())
    mean, events, spikes = followed(whole, np.array([[1.0]]))
    assert (events[:, 0].tolist(), spikes[:, 0].tolist()) == ([1, 0, 0], [0, 1, 1])
    np.testing.assert_allclose(mean[:, 0], [8])
    config = DeltaSnnConfig(hidden=1, clock="gated")
    gated = undecayed(config)
    gated.load_state_dict(policy.state_dict())
    mean, _, spikes = followed(gated, np.array([[1.0], [1.0]]))
    assert spikes[:, 0].tolist() == [1, 1]
    np.testing.assert_allclose(mean[:, 0], [12, 10])


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
