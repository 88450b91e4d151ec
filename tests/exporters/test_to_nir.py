from itertools import pairwise

import nir
import numpy as np
import pytest
import torch

from spikedeploy.exporters.to_nir import artifact, to_nir
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies import MlpPolicy, PopsanPolicy, SpikingMlpPolicy

ORIGIN = Provenance("spikedeploy/Hexapod-v0", "hexapod-popsan", seed=3, steps=7)


@pytest.fixture
def policy():
    torch.manual_seed(0)
    policy = PopsanPolicy(6, 2, hidden=(16, 12), populations=4)
    policy.normalizer.mean.normal_()
    policy.normalizer.std.uniform_(0.1, 2.0)
    return policy


def test_the_graph_is_standard_nir_that_any_tool_can_open(policy, tmp_path):
    graph = nir.read(to_nir(policy, ORIGIN, tmp_path / "p.nir"))
    chain = ["input", "fc1", "lif1", "fc2", "lif2", "fc3", "lif3", "readout", "output"]
    assert sorted(graph.edges) == sorted(pairwise(chain))
    kinds = {name: type(node).__name__ for name, node in graph.nodes.items()}
    assert kinds["input"] == "Input"
    assert kinds["output"] == "Output"
    assert {kinds[f"fc{k}"] for k in (1, 2, 3)} | {kinds["readout"]} == {"Affine"}
    assert {kinds[f"lif{k}"] for k in (1, 2, 3)} == {"CubaLIF"}


def test_gains_are_one_so_that_dt_can_be_read_from_the_neurons(policy):
    for name, size in (("lif1", 16), ("lif2", 12), ("lif3", 8)):
        node = artifact(policy, ORIGIN, dt=2e-3).graph.nodes[name]
        fields = (node.tau_syn, node.tau_mem, node.r, node.w_in, node.v_threshold, node.v_reset)
        assert {field.shape for field in fields} == {(size,)}
        assert {field.dtype for field in fields} == {np.dtype(np.float64)}
        np.testing.assert_allclose(node.tau_mem / node.r, 2e-3, rtol=1e-15)
        np.testing.assert_allclose(1 - 2e-3 / node.tau_syn, policy.alpha, rtol=1e-15)
        np.testing.assert_allclose(1 - 2e-3 / node.tau_mem, policy.beta, rtol=1e-15)
        # (1 - alpha) w_in (1 - beta) r = 1
        np.testing.assert_allclose((1 - 0.9) * node.w_in * (1 - 0.8) * node.r, 1.0, rtol=1e-12)
        assert not node.v_leak.any()
        assert not node.v_reset.any()


def test_the_readout_lets_every_action_hear_its_own_population_only(policy):
    readout = artifact(policy, ORIGIN).graph.nodes["readout"]
    assert readout.weight.shape == (2, 8)
    np.testing.assert_array_equal(readout.weight[0, :4], policy.decoder_weight[0].detach())
    np.testing.assert_array_equal(readout.weight[1, 4:], policy.decoder_weight[1].detach())
    assert not readout.weight[0, 4:].any()
    assert not readout.weight[1, :4].any()


def test_the_file_holds_all_that_a_robot_needs(policy, tmp_path):
    found = load(to_nir(policy, ORIGIN, tmp_path / "p.nir"))
    assert found.codec.timesteps == policy.timesteps
    assert found.codec.squash == "tanh"
    assert found.codec.normaliser.clip == policy.normalizer.clip
    np.testing.assert_array_equal(found.codec.normaliser.std, policy.normalizer.std)
    np.testing.assert_allclose(found.codec.encoder.std, policy.encoder.std.detach(), rtol=1e-6)
    assert found.codec.encoder.threshold == policy.encoder.threshold
    assert (found.convention.reset, found.convention.delay) == ("zero", 0)
    assert (found.convention.integrator, found.convention.state) == ("euler", "reset")
    origin = found.provenance
    assert (origin.recipe, origin.seed, origin.steps) == ("hexapod-popsan", 3, 7)
    assert len(origin.sha256) == 64


def test_exporting_twice_gives_the_same_bytes_and_leaves_the_policy_alone(policy, tmp_path):
    first = to_nir(policy, ORIGIN, tmp_path / "a.nir").read_bytes()
    assert to_nir(policy, ORIGIN, tmp_path / "b.nir").read_bytes() == first
    assert policy.decoder_weight.dtype == torch.float32
    convention = load(to_nir(policy, ORIGIN, tmp_path / "p.nir", state="kept")).convention
    assert (convention.state, convention.source) == ("kept", "state given, otherwise as trained")


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (MlpPolicy(6, 2, hidden=(4,)), "--to onnx"),
        (PopsanPolicy(6, 2, hidden=(4,), alpha=1.0), r"alpha is 1\.0"),
    ],
)
def test_what_nir_cannot_express_is_refused(policy, message, tmp_path):
    with pytest.raises(ConfigError, match=message):
        to_nir(policy, ORIGIN, tmp_path / "p.nir")
    assert not list(tmp_path.iterdir())


def spiking_mlp(**settings):
    torch.manual_seed(0)
    return SpikingMlpPolicy(6, 4, **{"hidden": (16, 12), "head": "discrete", **settings})


def test_a_spiking_mlp_is_lif_neurons_between_affine_maps(tmp_path):
    policy = spiking_mlp()
    graph = nir.read(to_nir(policy, ORIGIN, tmp_path / "p.nir"))
    chain = ["input", "fc1", "lif1", "fc2", "lif2", "readout", "output"]
    assert sorted(graph.edges) == sorted(pairwise(chain))
    assert {type(graph.nodes[f"lif{k}"]).__name__ for k in (1, 2)} == {"LIF"}
    np.testing.assert_array_equal(graph.nodes["readout"].weight, policy.readout.weight.detach())
    node = graph.nodes["lif2"]
    np.testing.assert_allclose(1 - 1e-3 / node.tau, policy.beta, rtol=1e-15)
    np.testing.assert_allclose((1 - policy.beta) * node.r, 1.0, rtol=1e-12)
    np.testing.assert_array_equal(node.v_threshold, np.full(12, policy.threshold))


@pytest.mark.parametrize(
    ("settings", "kind", "squash"),
    [
        ({"coding": "regular"}, "rate", "argmax"),
        ({"coding": "bernoulli", "head": "continuous"}, "rate", "tanh"),
        ({"coding": "population"}, "population", "argmax"),
    ],
)
def test_code_and_head_are_those_of_the_policy(settings, kind, squash, tmp_path):
    found = load(to_nir(spiking_mlp(**settings), ORIGIN, tmp_path / "p.nir")).codec
    assert (found.encoder.kind, found.squash, found.timesteps) == (kind, squash, 16)
    assert found.encoder.random == (settings["coding"] == "bernoulli")
