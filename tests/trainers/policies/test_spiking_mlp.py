import pytest
import snntorch
import torch
from snntorch import surrogate as snn_surrogate

from spikedeploy.trainers.policies import build
from spikedeploy.trainers.policies.neurons import lif, surrogate
from spikedeploy.trainers.policies.spiking import TorchRateEncoder

BETA, THRESHOLD = 0.9, 0.7


def policy(**settings):
    torch.manual_seed(0)
    return build(
        {"kind": "spiking-mlp", "observations": 6, "actions": 4, "hidden": [32, 16], **settings}
    )


def snntorch_layer(drive):
    layer = snntorch.Leaky(
        beta=torch.tensor(BETA, dtype=drive.dtype),
        threshold=torch.tensor(THRESHOLD, dtype=drive.dtype),
        spike_grad=snn_surrogate.fast_sigmoid(slope=25),
        reset_mechanism="zero",
        reset_delay=False,
    )
    membrane, spikes = torch.zeros_like(drive[0]), []
    for x in drive:
        spike, membrane = layer(x, membrane)
        spikes.append(spike)
    return torch.stack(spikes)


def test_spikes_and_gradients_equal_those_of_snntorchs_leaky():
    generator = torch.manual_seed(0)
    drive = torch.randn(20, 4, 32, dtype=torch.float64, generator=generator) * 0.6
    weight = torch.randn(20, 4, 32, dtype=torch.float64, generator=generator)
    ours, theirs = drive.clone().requires_grad_(), drive.clone().requires_grad_()
    spikes = lif(ours, BETA, THRESHOLD, surrogate("fast-sigmoid"))
    expected = snntorch_layer(theirs)
    assert torch.equal(spikes, expected)
    assert spikes.sum() > 200
    (spikes * weight).sum().backward()
    (expected * weight).sum().backward()
    torch.testing.assert_close(ours.grad, theirs.grad)


def test_the_readout_takes_the_firing_rates_of_the_last_layer():
    network, observation = policy(head="discrete"), torch.rand(5, 6) * 2 - 1
    trace = network.trace(observation)
    rates = trace["lif2"].float().mean(1)
    scores = network.scores(observation)
    torch.testing.assert_close(network.readout(rates), scores)
    assert torch.equal(trace["action"], scores.argmax(-1))
    assert torch.equal(network(observation), trace["action"])


def test_a_raster_replaces_the_encoder():
    network, observation = policy(coding="bernoulli"), torch.rand(5, 6) * 2 - 1
    first = network.trace(observation)
    again = network.trace(observation, first["input"])
    assert all(torch.equal(first[name], again[name]) for name in first)


@pytest.mark.parametrize("mode", ["regular", "bernoulli"])
def test_a_rate_code_spikes_as_often_as_the_observation_is_large(mode):
    torch.manual_seed(0)
    observation = torch.tensor([[-1.0, -0.5, 0.0, 0.25, 1.0, 7.0]])
    spikes = TorchRateEncoder(6, mode)(observation, 4096)
    expected = torch.tensor([[0.0, 0.25, 0.5, 0.625, 1.0, 1.0]])
    torch.testing.assert_close(spikes.mean(0), expected, atol=0.02, rtol=0)
    assert spikes[:, 0, 0].sum() == 0
    assert spikes[:, 0, 4].min() == 1


def test_regular_spikes_are_evenly_spaced_and_begin_half_way():
    spikes = TorchRateEncoder(2, "regular")(torch.tensor([[-0.5, 0.0]]), 8)
    assert spikes[:, 0, 0].tolist() == [0, 1, 0, 0, 0, 1, 0, 0]
    assert spikes[:, 0, 1].tolist() == [1, 0, 1, 0, 1, 0, 1, 0]


@pytest.mark.parametrize("coding", ["regular", "bernoulli", "population"])
@pytest.mark.parametrize("head", ["discrete", "continuous"])
def test_a_policy_is_rebuilt_from_its_checkpoint(coding, head):
    network = policy(coding=coding, head=head)
    twin = build(network.spec())
    twin.load_state_dict(network.state_dict())
    observation = torch.rand(3, 6)
    raster = network.encode(observation).transpose(0, 1)
    one, other = network.trace(observation, raster), twin.trace(observation, raster)
    assert torch.equal(one["action"], other["action"])


def test_untrained_layers_spike():
    rates = policy().latent(torch.rand(200, 6) * 2 - 1).rates
    assert all(0.05 < rate < 0.5 for rate in rates)


@pytest.mark.parametrize("coding", ["regular", "population"])
def test_the_reach_of_a_code_is_built_anew_and_is_one_in_old_checkpoints(coding):
    spec = policy(coding=coding, reach=2.5).spec()
    again = build(spec)
    of = "high" if coding == "regular" else "mean"
    assert getattr(again.encoder, of).detach().max() == 2.5
    old = {key: value for key, value in spec.items() if key != "reach"}
    assert getattr(build(old).encoder, of).detach().max() == 1.0
