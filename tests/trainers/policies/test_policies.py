import json

import numpy as np
import pytest
import torch

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import (
    DeltaSnnConfig,
    NetworkConfig,
    PopsanConfig,
    PrunedMlpConfig,
)
from spikedeploy.trainers.policies import (
    MlpPolicy,
    PopsanPolicy,
    SpikingMlpPolicy,
    build,
    from_config,
)
from spikedeploy.trainers.policies.policy import (
    Moments,
    PrunedWeight,
    SynapseGroup,
    TorchNormaliser,
)
from tests.delta_policies import delta_policy, pruned_mlp, walk

SMALL = {"hidden": (16, 12), "populations": 4, "timesteps": 5}


@pytest.fixture
def popsan():
    torch.manual_seed(0)
    return PopsanPolicy(6, 3, **SMALL).double().requires_grad_(False)


@pytest.fixture
def observations():
    return torch.randn(20, 6, generator=torch.manual_seed(1), dtype=torch.float64)


def numpy_spikes(policy, observation):
    """The whole network written out in NumPy, one timestep after the other."""
    normalizer, encoder = policy.normalizer, policy.encoder
    x = (observation.numpy() - normalizer.mean.numpy()) / normalizer.std.numpy()
    x = np.clip(x, -normalizer.clip, normalizer.clip)
    drive = np.exp(-0.5 * ((x[:, :, None] - encoder.mean.numpy()) / encoder.std.numpy()) ** 2)
    drive = drive.reshape(len(x), -1)
    volt = np.zeros_like(drive)
    states = [(np.zeros((len(x), layer.out_features)),) * 2 for layer in policy.layers]
    record = [[] for _ in range(1 + len(states))]
    for _ in range(policy.timesteps):
        volt = volt + drive
        spikes = (volt > encoder.threshold).astype(float)
        volt = volt - encoder.threshold * spikes
        record[0].append(spikes)
        for k, layer in enumerate(policy.layers):
            current, membrane = states[k]
            current = policy.alpha * current + spikes @ layer.weight.numpy().T + layer.bias.numpy()
            membrane = policy.beta * membrane + current
            spikes = (membrane > policy.threshold).astype(float)
            states[k] = current, membrane * (1 - spikes)
            record[k + 1].append(spikes)
    return [np.stack(raster, axis=1) for raster in record]


def test_every_spike_and_the_action_equal_numpy_in_float64(popsan, observations):
    trace = popsan.trace(observations)
    rasters = numpy_spikes(popsan, observations)
    for name, raster in zip(("input", "lif1", "lif2", "lif3"), rasters, strict=True):
        assert raster.sum() > 0
        assert np.array_equal(trace[name].numpy(), raster), name
    rates = rasters[-1].mean(1).reshape(len(observations), popsan.actions, -1)
    mean = (rates * popsan.decoder_weight.numpy()).sum(-1) + popsan.decoder_bias.numpy()
    np.testing.assert_allclose(trace["action"].numpy(), np.tanh(mean), atol=1e-12)


def test_encoder_starts_as_in_the_paper(popsan):
    assert popsan.encoder.mean[0].tolist() == [-3.0, -1.0, 1.0, 3.0]
    torch.testing.assert_close(popsan.encoder.std.square(), torch.full((6, 4), 0.15).double())


@pytest.mark.parametrize(
    "policy",
    [
        MlpPolicy(6, 3, (8, 8), clip=2.0),
        MlpPolicy(6, 3, ()),
        PopsanPolicy(6, 3, **SMALL, surrogate="rectangular", threshold=0.7),
        SpikingMlpPolicy(6, 3, (8,), "population", timesteps=4, reach=2.5),
        SpikingMlpPolicy(6, 3, (8,), "regular", timesteps=4, head="discrete"),
        from_config(NetworkConfig(chip="odin", hidden=(8,), timesteps=4), 6, 3),
        delta_policy(6, 3),
        delta_policy(6, 3, integrated=True, clock="gated", code="unary"),
        pruned_mlp(6, 3, skip=False),
    ],
    ids=lambda policy: policy.kind,
)
def test_a_policy_is_rebuilt_from_its_spec_and_weights(policy):
    policy.requires_grad_(False)
    copy = build(json.loads(json.dumps(policy.spec()))).requires_grad_(False)
    copy.load_state_dict(policy.state_dict())
    observation = torch.randn(5, 6)
    assert torch.equal(copy(observation), policy(observation))
    assert copy.spec() == policy.spec()


@pytest.mark.parametrize(
    ("config", "shape"),
    [
        (PopsanConfig(hidden=(8,), populations=2), {"hidden": (8,), "populations": 2}),
        (DeltaSnnConfig(hidden=4, code="unary"), {"hidden": 4, "code": "unary"}),
        (PrunedMlpConfig(hidden=(7,), skip=False), {"hidden": (7,), "skip": False}),
    ],
)
def test_a_configuration_makes_the_policy(config, shape):
    policy = from_config(config, 6, 3, clip=3.0)
    assert {name: getattr(policy, name) for name in shape} == shape
    assert (policy.kind, policy.clip) == (config.kind, 3.0)


def test_a_policy_without_hidden_layers_is_linear_before_tanh():
    policy = MlpPolicy(4, 2, ()).double()
    a, b = torch.rand(1, 4).double(), torch.rand(1, 4).double()
    middle = policy.latent((a + b) / 2).mean
    torch.testing.assert_close(middle, (policy.latent(a).mean + policy.latent(b).mean) / 2)


def test_an_unknown_kind_of_policy_is_refused():
    with pytest.raises(ConfigError, match="unknown kind of policy 'popsam': did you mean popsan"):
        build({"kind": "popsam"})


def test_a_policy_of_an_earlier_version_is_refused_by_what_it_has():
    with pytest.raises(ConfigError, match=r"has no bits, features: another version .* saved it"):
        build({**MlpPolicy(4, 2).spec(), "features": "phase", "bits": None})


def test_running_moments_equal_those_of_all_data():
    data = np.random.default_rng(0).normal(3.0, 2.0, (1000, 4))
    moments = Moments.empty(4)
    for part in np.array_split(data, 37):
        moments.add(part)
    np.testing.assert_allclose(moments.mean, data.mean(0))
    np.testing.assert_allclose(moments.std, data.std(0))


def test_a_constant_observation_is_not_amplified():
    moments = Moments.empty(1)
    moments.add(np.full((10, 1), 5.0))
    normalizer = TorchNormaliser(1)
    normalizer.adopt(moments)
    assert normalizer(torch.tensor([[5.001]])).abs() < 0.2
    assert normalizer(torch.tensor([[50.0]])) == 4.0


@pytest.mark.parametrize("hidden", [(), (6,), (6, 4)])
@pytest.mark.parametrize("skip", [True, False])
def test_the_network_equals_numpy(hidden, skip):
    policy = pruned_mlp(hidden=hidden, skip=skip).double()
    observation = walk()
    x = (observation - policy.normalizer.mean.numpy()) / policy.normalizer.std.numpy()
    x = seen = np.clip(x, -4, 4)
    for layer, bias in zip(policy.layers[:-1], policy.biases, strict=False):
        x = np.maximum(x @ (layer.weight * layer.mask).numpy().T + bias.numpy(), 0)
    mean = x @ (policy.layers[-1].weight * policy.layers[-1].mask).numpy().T
    mean += policy.biases[-1].numpy()
    if skip and hidden:
        mean += seen @ (policy.past.weight * policy.past.mask).numpy().T
    found = policy.scores(torch.from_numpy(observation)).numpy()
    np.testing.assert_allclose(found, mean, atol=1e-12)


def test_what_is_taken_out_counts_for_nothing_and_learns_nothing():
    weight = PrunedWeight(torch.ones(2, 3))
    weight.mask[0, 1] = 0.0
    assert weight().tolist() == [[1, 0, 1], [1, 1, 1]]
    assert weight.fan_out.tolist() == [2, 1, 2]
    weight().sum().backward()
    assert weight.weight.grad.tolist() == [[1, 0, 1], [1, 1, 1]]
    # rates 0.5, 2 and 1 a control step
    assert SynapseGroup(weight, torch.tensor([0.5, 2.0, 1.0])).operations == 0.5 * 2 + 2 + 2
