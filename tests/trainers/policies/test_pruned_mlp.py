import json

import numpy as np
import pytest
import torch

from spikedeploy.trainers.config import PrunedMlpConfig
from spikedeploy.trainers.policies import PrunedMlpPolicy, build, from_config
from spikedeploy.trainers.policies.pruned_mlp import PrunedWeight, SynapseGroup
from tests.delta_policies import pruned_mlp, walk


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


def test_a_policy_is_built_from_its_spec_and_its_configuration():
    policy = pruned_mlp(head="discrete")
    again = build(json.loads(json.dumps(policy.spec())))
    again.load_state_dict(policy.state_dict())
    observation = torch.from_numpy(walk()).float()
    assert torch.equal(policy(observation), again(observation))
    made = from_config(PrunedMlpConfig(hidden=(7,), skip=False), 5, 3, 2.0)
    assert isinstance(made, PrunedMlpPolicy)
    assert (made.hidden, made.skip, made.normalizer.clip) == ((7,), False, 2.0)


def test_what_is_taken_out_counts_for_nothing_and_learns_nothing():
    weight = PrunedWeight(torch.ones(2, 3))
    weight.mask[0, 1] = 0.0
    assert weight().tolist() == [[1, 0, 1], [1, 1, 1]]
    assert weight.fan_out.tolist() == [2, 1, 2]
    weight().sum().backward()
    assert weight.weight.grad.tolist() == [[1, 0, 1], [1, 1, 1]]
    # rates 0.5, 2 and 1 a control step
    assert SynapseGroup(weight, torch.tensor([0.5, 2.0, 1.0])).operations == 0.5 * 2 + 2 + 2
