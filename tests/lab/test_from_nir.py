from dataclasses import replace

import numpy as np
import pytest
import torch

from lab.bench.from_nir import from_nir
from spikedeploy import zoo
from spikedeploy.exporters.parity import check
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies import PopsanPolicy, SpikingMlpPolicy
from tests.delta_policies import delta_policy, followed, walk
from tests.exporters.test_delta_files import SHAPES, failed, written
from tests.networks import popsan

ORIGIN = Provenance(
    "test/World-v0", "smoke", seed=0, steps=1, created="2026-01-01", version="0.1.0"
)


def test_what_is_written_and_read_back_is_the_same_policy_to_the_last_bit(tmp_path):
    torch.manual_seed(0)
    policy = PopsanPolicy(5, 3, hidden=(16, 12), populations=4, timesteps=6, alpha=0.7, beta=0.95)
    with torch.no_grad():
        policy.encoder.log_std += 0.1 * torch.randn_like(policy.encoder.log_std)
        policy.normalizer.mean += torch.randn(5)
    found = from_nir(to_nir(policy, ORIGIN, tmp_path / "policy.nir"))
    assert found.spec() == policy.spec()
    for name, tensor in policy.state_dict().items():
        assert torch.equal(found.state_dict()[name], tensor), name


@pytest.mark.parametrize("coding", ["regular", "bernoulli", "population"])
@pytest.mark.parametrize("head", ["discrete", "continuous"])
def test_a_spiking_mlp_comes_back_to_the_last_bit(coding, head, tmp_path):
    torch.manual_seed(0)
    policy = SpikingMlpPolicy(
        5, 3, hidden=(16, 12), coding=coding, timesteps=8, beta=0.8, threshold=0.6, head=head
    )
    with torch.no_grad():
        policy.normalizer.mean += torch.randn(5)
    found = from_nir(to_nir(policy, ORIGIN, tmp_path / "policy.nir"))
    assert found.spec() == policy.spec()
    for name, tensor in policy.state_dict().items():
        assert torch.equal(found.state_dict()[name], tensor), name


@pytest.mark.parametrize("env", ["hexapod", "hexapod-command"])
def test_the_shipped_policies_spike_alike_in_torch_in_numpy_and_compiled(env):
    file = zoo.path(f"{env}/popsan")
    observations = np.random.default_rng(0).normal(size=(50, 77))
    checks = check(from_nir(file), file, observations)
    assert len(checks) == 5
    assert all(each.passed for each in checks), checks


def test_a_network_of_another_tool_is_refused_in_one_line(tmp_path):
    foreign = replace(popsan(), codec=None, provenance=None)
    save(foreign, tmp_path / "foreign.nir")
    with pytest.raises(ArtifactError, match="only what spikedeploy exported"):
        from_nir(tmp_path / "foreign.nir")


@pytest.mark.parametrize("shape", SHAPES)
def test_a_file_read_back_is_the_same_policy(shape, tmp_path):
    policy = delta_policy(**shape, left=1.0)
    path = written(policy, tmp_path)
    again = from_nir(path)
    assert again.spec() == policy.spec()
    found, expected = again.state_dict(), policy.state_dict()
    if not policy.hidden:  # readouts decay as currents do
        del found["_gamma"], expected["_gamma"]
    for name, tensor in expected.items():
        torch.testing.assert_close(found[name], tensor, rtol=1e-6, atol=1e-7, msg=name)
    for name in ("into.weight", "out.weight", "past.weight", "step", "action_bias"):
        assert torch.equal(found[name], expected[name]), name


@pytest.mark.parametrize("shape", SHAPES)
def test_a_pruned_file_read_back_acts_alike(shape, tmp_path):
    policy = delta_policy(**shape, left=0.3)
    again = from_nir(written(policy, tmp_path))
    one, other = (followed(each, walk(100))[0] for each in (policy.double(), again.double()))
    np.testing.assert_allclose(one, other, atol=1e-6)
    assert not failed(check(again, tmp_path / "policy.nir", walk(100)))
