from dataclasses import replace

import numpy as np
import pytest
import torch

from spikedeploy import zoo
from spikedeploy.exporters.from_nir import from_nir
from spikedeploy.exporters.parity import check
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies import PopsanPolicy, SpikingMlpPolicy
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
