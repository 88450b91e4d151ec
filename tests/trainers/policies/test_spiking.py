import pytest
import snntorch
import torch
from snntorch import surrogate as snn_surrogate

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers import surrogate_neurons as neurons
from spikedeploy.trainers.policies import build
from spikedeploy.trainers.policies.spiking import TorchRateEncoder
from spikedeploy.trainers.surrogate_neurons import (
    cuba_lif,
    integrate_and_fire,
    surrogate,
)

ALPHA, BETA, THRESHOLD = 0.9, 0.8, 0.5


class Box(torch.autograd.Function):
    """The rectangular surrogate of the PopSAN paper, written for snnTorch."""

    @staticmethod
    def forward(ctx, excess):
        ctx.save_for_backward(excess)
        return (excess > 0).to(excess.dtype)

    @staticmethod
    def backward(ctx, upstream):
        (excess,) = ctx.saved_tensors
        return upstream * (excess.abs() < 0.5)


REFERENCES = {
    "atan": snn_surrogate.atan(alpha=2.0),
    "rectangular": Box.apply,
    "fast-sigmoid": snn_surrogate.fast_sigmoid(slope=25),
}


def snntorch_layer(drive, spike_grad, alpha=ALPHA):
    layer = snntorch.Synaptic(
        alpha=torch.tensor(alpha, dtype=drive.dtype),
        beta=torch.tensor(BETA, dtype=drive.dtype),
        threshold=torch.tensor(THRESHOLD, dtype=drive.dtype),
        spike_grad=spike_grad,
        reset_mechanism="zero",
        reset_delay=False,
    )
    current, membrane = torch.zeros_like(drive[0]), torch.zeros_like(drive[0])
    spikes = []
    for x in drive:
        spike, current, membrane = layer(x, current, membrane)
        spikes.append(spike)
    return torch.stack(spikes)


def test_fused_layer_spikes_as_snntorch_does():
    drive = torch.randn(50, 8, 64, generator=torch.manual_seed(0)) * 0.4
    ours = cuba_lif(drive, ALPHA, BETA, THRESHOLD, surrogate("atan"))
    theirs = snntorch_layer(drive, REFERENCES["atan"])
    assert ours.sum() > 1000
    assert torch.equal(ours, theirs)


@pytest.mark.parametrize("alpha", [0.0, ALPHA])
@pytest.mark.parametrize("name", REFERENCES)
@pytest.mark.parametrize("timesteps", [1, 20])
def test_fused_gradient_equals_snntorch(name, timesteps, alpha):
    generator = torch.manual_seed(timesteps)
    drive = torch.randn(timesteps, 4, 32, dtype=torch.float64, generator=generator) * 0.5
    weight = torch.randn(timesteps, 4, 32, dtype=torch.float64, generator=generator)
    ours, theirs = drive.clone().requires_grad_(), drive.clone().requires_grad_()
    (cuba_lif(ours, alpha, BETA, THRESHOLD, surrogate(name)) * weight).sum().backward()
    (snntorch_layer(theirs, REFERENCES[name], alpha) * weight).sum().backward()
    assert theirs.grad.abs().max() > 0.1
    # snnTorch casts spikes to float32, so its float64 gradients are exact to that and no better
    torch.testing.assert_close(ours.grad, theirs.grad, rtol=1e-5, atol=1e-6)


def test_state_is_float32_when_the_drive_is_bfloat16():
    drive = (torch.randn(5, 2, 16, generator=torch.manual_seed(1)) * 0.5).bfloat16()
    low = cuba_lif(drive, ALPHA, BETA, THRESHOLD, surrogate("atan"))
    full = cuba_lif(drive.float(), ALPHA, BETA, THRESHOLD, surrogate("atan"))
    assert low.dtype == torch.bfloat16
    assert torch.equal(low.float(), full)


def test_one_spike_worked_out_by_hand():
    # x = 0.3   0.3          0              0
    # I = 0.3   0.57         0.513          0.4617
    # V = 0.3   0.81 spikes  0.513 spikes   0.4617
    drive = torch.tensor([0.3, 0.3, 0.0, 0.0], dtype=torch.float64).reshape(4, 1, 1)
    spikes = cuba_lif(drive, 0.9, 0.8, 0.5, surrogate("atan"))
    assert spikes.flatten().tolist() == [0, 1, 1, 0]


def test_encoder_fires_in_proportion_to_its_drive():
    drive = torch.tensor([[0.0, 0.2, 0.5, 1.0]], dtype=torch.float64)
    spikes = integrate_and_fire(drive, 0.999, 5)
    assert spikes.sum(0).tolist() == [[0, 1, 2, 5]]


def test_encoder_gradient_goes_straight_to_the_drive():
    drive = torch.rand(2, 3, requires_grad=True)
    integrate_and_fire(drive, 0.999, 5).mul(2.0).sum().backward()
    assert torch.equal(drive.grad, torch.full((2, 3), 10.0))


def test_unknown_surrogate_is_refused():
    with pytest.raises(ConfigError, match="unknown surrogate 'sigmoid'"):
        surrogate("sigmoid")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("alpha", [0.0, ALPHA])
def test_compiled_loops_have_the_bits_of_the_plain_ones(alpha, dtype, monkeypatch):
    pytest.importorskip("numba")
    threshold = 0.7  # no number of float32, in which membranes of the first timestep are just there
    drive = torch.randn(40, 33, 6, dtype=dtype, generator=torch.manual_seed(2)).transpose(1, 2)
    drive[0, :, :5] = threshold
    weight = torch.randn(6, 33, dtype=dtype, generator=torch.manual_seed(3)).expand(40, 6, 33)

    def passes():
        leaf = drive.clone().requires_grad_()
        spikes = cuba_lif(leaf, alpha, BETA, threshold, surrogate("fast-sigmoid"))
        (spikes * weight).sum().backward()
        return spikes.detach(), leaf.grad

    compiled = passes()
    monkeypatch.setattr(neurons, "_COMPILED", False)
    monkeypatch.setattr(neurons, "membranes", None)
    monkeypatch.setattr(neurons, "gradients", None)
    plain = passes()
    assert plain[0].sum() > 1000
    assert torch.equal(compiled[0], plain[0])
    assert torch.equal(compiled[1], plain[1])


def policy(**settings):
    torch.manual_seed(0)
    return build(
        {"kind": "spiking-mlp", "observations": 6, "actions": 4, "hidden": [32, 16], **settings}
    )


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
