import json

import numpy as np
import pytest
import torch

from lab.bench.from_nir import from_nir
from spikedeploy.exporters.parity import check
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import DeltaMlpConfig
from spikedeploy.trainers.policies import DeltaMlpPolicy, build, from_config
from tests.delta_policies import arriving, delta_mlp, followed, walk

ORIGIN = Provenance("spikedeploy/Hexapod-v0", "hexapod-delta-mlp")
SHAPES = [{}, {"code": "unary"}, {"hidden": 0}, {"skip": False}, {"head": "discrete", "act": 4}]
SHAPES += [{"clock": "gated"}]


def failed(checks):
    return [check.name for check in checks if not check.passed]


def written(policy, tmp_path):
    return to_nir(policy, ORIGIN, tmp_path / "policy.nir")


def windows(policy, observation, burn_in):
    """Means, messages and what `advance` does, of the window that starts the episode."""
    mean, events, graded = followed(policy, observation)
    moved, seen = arriving(policy, events)
    before = torch.zeros(1, burn_in, policy.observations, dtype=torch.float64)
    seen = torch.cat([before, seen[None]], 1)
    found, messages = policy.unrolled(
        seen, torch.cat([before, moved[None]], 1), policy.weights(), burn_in, torch.tensor([True])
    )
    return found[0, burn_in:], messages[0, burn_in:], mean, graded


@pytest.mark.parametrize("shape", SHAPES)
def test_a_window_from_the_beginning_equals_single_steps(shape):
    policy = delta_mlp(**shape).double()
    found, messages, mean, graded = windows(policy, walk(), 4)
    np.testing.assert_allclose(found.numpy(), mean, atol=1e-12)
    np.testing.assert_array_equal(messages.numpy(), graded != 0)
    assert not policy.hidden or np.abs(graded).max() > 1


def test_the_output_is_that_of_a_network_on_rounded_numbers():
    policy = delta_mlp(left=1.0, clock="gated").double()
    mean, events, graded = followed(policy, walk(100))
    level = np.cumsum(events, 0) * policy.step.numpy()
    hidden = np.maximum(level @ policy.into().numpy().T + policy.bias.numpy(), 0)
    sent = np.cumsum(graded, 0) * policy.threshold.numpy()
    # what was sent is less than a threshold away from the activation
    assert (np.abs(sent - hidden) < policy.threshold.numpy() + 1e-12).all()
    expected = sent @ policy.out().numpy().T + level @ policy.past().numpy().T
    np.testing.assert_allclose(mean, expected + policy.action_bias.numpy(), atol=1e-12)


def test_gradients_pass_the_rounding_as_if_it_were_none():
    policy = delta_mlp(left=1.0, clock="gated").double()
    seen = torch.randn(4, 9, 5, dtype=torch.float64, requires_grad=True)
    begins = torch.zeros(4, dtype=torch.bool)
    mean, messages = policy.unrolled(seen, seen, policy.weights(), 2, begins)
    (found,) = torch.autograd.grad(mean.sum(), seen, retain_graph=True)
    hidden = torch.relu(seen @ policy.into().T + policy.bias)
    smooth = hidden @ policy.out().T + seen @ policy.past().T
    (expected,) = torch.autograd.grad(smooth.sum(), seen)
    torch.testing.assert_close(found, expected)
    (cost,) = torch.autograd.grad(messages.sum(), seen)
    assert cost.abs().sum() > 0


@pytest.mark.parametrize("shape", SHAPES)
def test_a_policy_is_built_from_its_spec(shape):
    policy = delta_mlp(**shape, threshold=0.7)
    again = build(json.loads(json.dumps(policy.spec())))
    assert isinstance(again, DeltaMlpPolicy)
    again.load_state_dict(policy.state_dict())
    for one, other in zip(followed(policy, walk()), followed(again, walk()), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_configuration_makes_the_policy():
    policy = from_config(DeltaMlpConfig(hidden=4, threshold=0.3), 5, 3, 2.5)
    assert isinstance(policy, DeltaMlpPolicy)
    assert (policy.hidden, policy.share, policy.threshold.tolist()[0]) == (
        4,
        0.3,
        pytest.approx(0.3),
    )


def test_a_changed_threshold_is_found(tmp_path):
    policy = delta_mlp()
    path = written(policy, tmp_path)
    policy.threshold *= 1.1
    assert "spikes: torch = NumPy, float64" in failed(check(policy, path, walk(100)))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("left", [1.0, 0.3])
def test_a_file_read_back_is_the_same_policy(shape, left, tmp_path):
    policy = delta_mlp(**shape, left=left)
    again = from_nir(written(policy, tmp_path))
    if left == 1.0:
        assert again.spec() == policy.spec()
        for name, tensor in policy.state_dict().items():
            torch.testing.assert_close(again.state_dict()[name], tensor, rtol=1e-6, atol=1e-7)
    one, other = (followed(each, walk(100))[0] for each in (policy.double(), again.double()))
    np.testing.assert_allclose(one, other, atol=1e-6)


@pytest.mark.parametrize("target", ["loihi2", "ideal"])
def test_a_batch_on_a_chip_equals_single_robots(target, tmp_path):
    artifact = load(written(delta_mlp(), tmp_path))
    observation = np.stack([walk(30, seed=seed) for seed in range(3)])
    together = SpikingController(artifact, chip(target))
    alone = SpikingController(artifact, chip(target))
    actions = np.stack([together.act_batch(row) for row in observation.swapaxes(0, 1)], axis=1)
    for robot, expected in zip(observation, actions, strict=True):
        alone.reset(0)
        np.testing.assert_allclose([alone.act(row) for row in robot], expected, atol=1e-12)


def test_loihi2_acts_nearly_as_torch_does(tmp_path):
    policy = delta_mlp(left=1.0)
    controller = SpikingController(load(written(policy, tmp_path)), chip("loihi2"))
    mean, _, _ = followed(policy.double(), walk(200))
    actions = np.stack([controller.act(row) for row in walk(200)])
    assert np.sqrt(np.mean((actions - np.tanh(mean)) ** 2)) < 0.05


def test_loihi1_refuses_it_and_states_are_always_kept(tmp_path):
    artifact = load(written(delta_mlp(), tmp_path))
    with pytest.raises(RuleError, match="rule graded"):
        SpikingController(artifact, chip("loihi1"))
    with pytest.raises(ConfigError, match=r"delta-mlp.*keeps its states"):
        to_nir(delta_mlp(), ORIGIN, tmp_path / "reset.nir", state="reset")
