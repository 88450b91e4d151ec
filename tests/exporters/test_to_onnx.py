import numpy as np
import onnxruntime
import pytest
import torch

from spikedeploy.exporters.parity import check as check_parity
from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies import (
    MlpPolicy,
    PopsanPolicy,
    SpikingMlpPolicy,
)
from tests.delta_policies import pruned_mlp, walk

ORIGIN = Provenance("spikedeploy/Hexapod-v0", "hexapod-sac", 3, 7, "2026-01-01T00:00:00Z", "0.1.0")


def mlp(hidden=(8, 4), head="continuous"):
    torch.manual_seed(0)
    policy = MlpPolicy(6, 2, hidden=hidden, head=head)
    policy.normalizer.mean.normal_()
    policy.normalizer.std.uniform_(0.1, 2.0)
    return policy


def act(path, observation):
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    return session.run(["action"], {"observation": observation.astype(np.float32)})[0]


@pytest.mark.parametrize("hidden", [(), (5,), (8, 4)])
def test_the_file_acts_like_the_policy(hidden, tmp_path):
    policy = mlp(hidden)
    observation = np.random.default_rng(1).normal(0, 3, (50, 6))
    found = act(to_onnx(policy, ORIGIN, tmp_path / "p.onnx"), observation)
    with torch.no_grad():
        expected = policy(torch.from_numpy(observation).float()).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert found.std(axis=0).min() > 0.01  # it does depend on what it sees


@pytest.mark.parametrize("hidden", [(), (8, 4)])
def test_a_policy_that_chooses_puts_out_its_logits(hidden, tmp_path):
    policy = mlp(hidden, head="discrete")
    path = to_onnx(policy, ORIGIN, tmp_path / "p.onnx")
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    observation = np.random.default_rng(1).normal(0, 3, (50, 6)).astype(np.float32)
    found = session.run(["logits"], {"observation": observation})[0]
    with torch.no_grad():
        expected = policy.scores(torch.from_numpy(observation)).numpy()
        chosen = policy(torch.from_numpy(observation)).numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(found.argmax(axis=1), chosen)
    assert session.get_modelmeta().custom_metadata_map["head"] == "discrete"
    assert session.get_outputs()[0].name == "logits"


def test_the_file_says_who_made_it_and_what_it_costs(tmp_path):
    path = to_onnx(mlp(), ORIGIN, tmp_path / "sac.onnx", kind="control")
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    found = session.get_modelmeta().custom_metadata_map
    assert len(found.pop("sha256")) == 64
    assert found == {
        "env": "spikedeploy/Hexapod-v0",
        "recipe": "hexapod-sac",
        "seed": "3",
        "steps": "7",
        "kind": "control",
        "head": "continuous",
        "name": "sac",
        "macs": str(6 * 8 + 8 * 4 + 4 * 2),
        "created": "2026-01-01T00:00:00Z",
        "version": "0.1.0",
    }


def test_what_each_weight_matrix_hears_can_be_asked_for(tmp_path):
    policy = mlp((8, 4))
    path = to_onnx(policy, ORIGIN, tmp_path / "p.onnx")
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    observation = np.random.default_rng(1).normal(0, 3, (50, 6)).astype(np.float32)
    _, *heard = session.run(None, {"observation": observation})
    with torch.no_grad():
        expected = [policy.normalizer(torch.from_numpy(observation))]
        for layer in policy.layers[:2]:
            expected.append(torch.relu(layer(expected[-1])))
    for found, wanted in zip(heard, expected, strict=True):
        np.testing.assert_allclose(found, wanted.numpy(), atol=1e-5)
    first = path.read_bytes()
    assert to_onnx(mlp((8, 4)), ORIGIN, path).read_bytes() == first
    assert [each.name for each in tmp_path.iterdir()] == ["p.onnx"]


@pytest.mark.parametrize("kind", [PopsanPolicy, SpikingMlpPolicy])
def test_a_spiking_policy_becomes_a_step_that_acts_as_its_float_twin(kind, tmp_path):
    torch.manual_seed(0)
    policy = kind(6, 2, hidden=(4,))
    observation = np.random.default_rng(1).normal(0, 1, (20, 6))
    path = to_onnx(policy, ORIGIN, tmp_path / "p.onnx")
    assert all(check.passed for check in check_parity(policy, path, observation))


def test_an_unknown_kind_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="ann, control"):
        to_onnx(mlp(), ORIGIN, tmp_path / "p.onnx", kind="snn")


@pytest.mark.parametrize("hidden", [(), (6,), (6, 4)])
@pytest.mark.parametrize("head", ["continuous", "discrete"])
@pytest.mark.parametrize("skip", [True, False])
def test_a_pruned_policy_acts_alike(hidden, head, skip, tmp_path):
    policy = pruned_mlp(hidden=hidden, head=head, skip=skip)
    path = to_onnx(policy, ORIGIN, tmp_path / "p.onnx")
    assert all(check.passed for check in check_parity(policy, path, walk()))


@pytest.mark.parametrize("skip", [True, False])
def test_effective_operations_of_a_pruned_policy_are_those_of_a_hand_count(skip, tmp_path):
    policy, observation = pruned_mlp(skip=skip), walk()
    player = OnnxController(to_onnx(policy, ORIGIN, tmp_path / "p.onnx"))
    _, inputs = policy.activations(torch.from_numpy(observation).float())
    matrices = [*zip(inputs, policy.layers, strict=True), (inputs[0], policy.past)]
    count = 0
    for x, matrix in matrices if skip else matrices[:-1]:
        for row in x.numpy():
            for value, weights in zip(row, matrix.mask.T.numpy(), strict=True):
                count += int(weights.sum()) * bool(value)
    assert player.effective_macs(observation) == pytest.approx(count / len(observation))
    everything = [int(layer.mask.sum()) for layer in policy.layers] + [int(policy.past.mask.sum())]
    assert player.metadata["macs"] == str(sum(everything))


def test_files_without_fan_outs_count_all_weights(tmp_path):
    path = to_onnx(mlp((8,)), ORIGIN, tmp_path / "p.onnx")
    player, observation = OnnxController(path), np.ones((1, 6))
    assert "fan_out" not in player.metadata
    active = np.count_nonzero(player._run(player._presynaptic, observation, {})[1])
    assert player.effective_macs(observation) == 6 * 8 + active * 2
