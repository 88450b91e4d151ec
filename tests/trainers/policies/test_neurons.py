import pytest
import snntorch
import torch
from snntorch import surrogate as snn_surrogate

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.policies import neurons
from spikedeploy.trainers.policies.neurons import (
    cuba_lif,
    gradients,
    integrate_and_fire,
    membranes,
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


REFERENCES = {"atan": snn_surrogate.atan(alpha=2.0), "rectangular": Box.apply}


def snntorch_layer(drive, spike_grad):
    layer = snntorch.Synaptic(
        alpha=torch.tensor(ALPHA, dtype=drive.dtype),
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


@pytest.mark.parametrize("name", ["atan", "rectangular"])
@pytest.mark.parametrize("timesteps", [1, 5, 20])
def test_fused_gradient_equals_snntorch(name, timesteps):
    generator = torch.manual_seed(timesteps)
    drive = torch.randn(timesteps, 4, 32, dtype=torch.float64, generator=generator) * 0.5
    weight = torch.randn(timesteps, 4, 32, dtype=torch.float64, generator=generator)
    ours, theirs = drive.clone().requires_grad_(), drive.clone().requires_grad_()
    (cuba_lif(ours, ALPHA, BETA, THRESHOLD, surrogate(name)) * weight).sum().backward()
    (snntorch_layer(theirs, REFERENCES[name]) * weight).sum().backward()
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


def test_gradients_do_not_depend_on_how_tensors_lie_in_memory():
    membrane, slope, upstream = torch.rand(3, 7, 4, 5, generator=torch.manual_seed(4))
    apart = [each.transpose(1, 2).contiguous().transpose(1, 2) for each in (membrane, slope)]
    expected = neurons._gradients(membrane, slope.clone(), upstream, ALPHA, BETA, THRESHOLD)
    found = gradients(*apart, upstream, ALPHA, BETA, THRESHOLD)
    assert torch.equal(found, expected)


def test_a_gradient_of_a_gradient_is_refused():
    drive = torch.rand(4, 2, 3, generator=torch.manual_seed(5)).requires_grad_()
    spikes = cuba_lif(drive, ALPHA, BETA, THRESHOLD, surrogate("atan"))
    (gradient,) = torch.autograd.grad(spikes.square().sum(), drive, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


@pytest.mark.parametrize("alpha", [0.0, ALPHA])
def test_infinite_gradients_are_the_same_in_both_forms(alpha):
    membrane, slope, upstream = torch.rand(3, 9, 4, 5, generator=torch.manual_seed(6))
    upstream[2:, 0, 0] = torch.inf
    arguments = upstream, alpha, BETA, THRESHOLD
    plain = neurons._gradients(membrane, slope.clone(), *arguments)
    found = gradients(membrane, slope, *arguments)
    assert torch.equal(found.nan_to_num(), plain.nan_to_num())
    assert not plain.isfinite().all()


def test_nan_stays_nan_in_both_forms():
    drive = torch.randn(40, 6, 33, generator=torch.manual_seed(2))
    drive[3, 0, 0] = torch.nan
    compiled, plain = (
        each(drive, ALPHA, BETA, THRESHOLD) for each in (membranes, neurons._membranes)
    )
    assert torch.equal(compiled.nan_to_num(), plain.nan_to_num())
    assert torch.equal(compiled.isnan(), plain.isnan())
    assert plain[3:, 0, 0].isnan().all()
