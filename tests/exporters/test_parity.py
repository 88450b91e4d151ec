from copy import deepcopy

import nir
import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper

from spikedeploy.exporters.parity import check
from spikedeploy.exporters.to_nir import artifact, to_nir
from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.runtime.artifact.artifact import Artifact, save
from spikedeploy.runtime.errors import ConfigError, ObservationError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies import MlpPolicy, PopsanPolicy, SpikingMlpPolicy

ORIGIN = Provenance("spikedeploy/Hexapod-v0")


@pytest.fixture
def observations():
    return np.random.default_rng(0).normal(0, 2, (300, 6))


@pytest.fixture
def popsan():
    torch.manual_seed(0)
    policy = PopsanPolicy(6, 2, hidden=(32, 24), populations=5)
    policy.normalizer.std.uniform_(0.1, 2.0)
    return policy


@pytest.fixture
def mlp():
    torch.manual_seed(0)
    return MlpPolicy(6, 2, hidden=(16,))


def spiking_mlp(**settings):
    torch.manual_seed(0)
    policy = SpikingMlpPolicy(6, 4, hidden=(32, 24), **{"head": "discrete", **settings})
    policy.normalizer.std.uniform_(0.5, 2.0)
    return policy


def failed(checks):
    return [check.name for check in checks if not check.passed]


def test_torch_numpy_and_ideal_spike_alike(popsan, observations, tmp_path):
    checks = check(popsan, to_nir(popsan, ORIGIN, tmp_path / "p.nir"), observations)
    assert not failed(checks)
    # 300 observations, 5 timesteps, 30 + 32 + 24 + 10 neurons
    assert checks[0].detail == f"{300 * 5 * 96:,} compared, all equal"
    # the spikes that float32 moves are reported and not judged
    assert ("float32" in checks[-1].name, "compared" in checks[-1].detail) == (True, True)


def shift(path, step):
    """Add a step to a parameter, named as in "decoder_bias" or "layers.1.weight.3"."""

    @torch.no_grad()
    def change(policy):
        *names, last = path.split(".")
        for name in names:
            policy = policy[int(name)] if name.isdecimal() else getattr(policy, name)
        if last.isdecimal():
            policy[int(last)] += step
        else:
            getattr(policy, last).add_(step)

    return change


CHANGED = {
    "a weight": ("popsan", shift("layers.1.weight.3", 0.05), "spikes: torch = NumPy, float64"),
    "a decoder": ("popsan", shift("decoder_bias", 1e-6), ["actions: torch = NumPy, float64"]),
    "a range": ("regular", shift("encoder.low.2", -0.1), "spikes: torch = NumPy, float64"),
    "a drawn range": ("bernoulli", shift("encoder.low.2", -0.1), "spikes: torch = NumPy, float64"),
    "a score": ("regular", shift("readout.bias", 1e-6), ["scores: torch = NumPy, float64"]),
    "a choice": ("regular", shift("readout.bias.1", 1.0), "choices: torch = NumPy, float64"),
}


@pytest.mark.parametrize("case", CHANGED)
def test_what_was_changed_in_the_policy_is_found(case, popsan, observations, tmp_path):
    coding, change, expected = CHANGED[case]
    policy = popsan if coding == "popsan" else spiking_mlp(coding=coding)
    path = to_nir(policy, ORIGIN, tmp_path / "p.nir")
    change(policy)
    found = failed(check(policy, path, observations))
    assert found == expected if isinstance(expected, list) else expected in found


def test_a_file_that_is_stepped_differently_is_found(popsan, observations, tmp_path):
    written = artifact(popsan, ORIGIN)
    node = written.graph.nodes["lif2"]
    slower = deepcopy(node)
    slower.tau_mem, slower.r = 2 * node.tau_mem, 2 * node.r
    graph = nir.NIRGraph({**written.graph.nodes, "lif2": slower}, written.graph.edges)
    save(Artifact(graph, written.codec, written.convention, ORIGIN), tmp_path / "p.nir")
    assert failed(check(popsan, tmp_path / "p.nir", observations)) == [
        "spikes: torch = NumPy, float64",
        "actions: torch = NumPy, float64",
    ]


@pytest.mark.parametrize("coding", ["regular", "bernoulli", "population"])
@pytest.mark.parametrize("head", ["discrete", "continuous"])
@pytest.mark.parametrize("state", ["reset", "kept"])
def test_a_spiking_mlp_spikes_alike_everywhere(coding, head, state, observations, tmp_path):
    policy = spiking_mlp(coding=coding, head=head)
    path = to_nir(policy, ORIGIN, tmp_path / "p.nir", state=state)
    checks = check(policy, path, observations)
    assert not failed(checks)
    assert len(checks) == (7 if head == "discrete" else 5)
    # 300 observations, 16 timesteps
    width = 6 * 4 if coding == "population" else 6
    assert checks[0].detail == f"{300 * 16 * (width + 56):,} compared, all equal"


@pytest.mark.parametrize("hidden", [(), (16, 16)])
def test_onnx_runtime_scores_like_torch(hidden, observations, tmp_path):
    torch.manual_seed(0)
    policy = MlpPolicy(6, 4, hidden=hidden, head="discrete")
    with torch.no_grad():
        policy.layers[-1].weight *= 1000  # logits may be large
    path = to_onnx(policy, ORIGIN, tmp_path / "p.onnx")
    checks = check(policy, path, observations)
    assert not failed(checks)
    assert checks[0].name == "logits: torch = ONNX Runtime"
    with torch.no_grad():
        policy.layers[-1].weight[2] *= 1.001
    assert len(failed(check(policy, path, observations))) == 2


def test_a_changed_onnx_weight_and_nan_are_found(mlp, observations, tmp_path):
    path = to_onnx(mlp, ORIGIN, tmp_path / "p.onnx")
    model = onnx.load(path)
    weight = next(c for c in model.graph.initializer if c.name == "weight2")
    array = numpy_helper.to_array(weight) + np.float32(1e-3)
    weight.CopyFrom(numpy_helper.from_array(array, "weight2"))
    onnx.save(model, path)
    assert len(failed(check(mlp, path, observations))) == 2
    with torch.no_grad():
        mlp.layers[-1].bias[0] = float("nan")
    assert failed(check(mlp, to_onnx(mlp, ORIGIN, path), observations))


def test_observations_of_another_task_are_refused(mlp, tmp_path):
    path = to_onnx(mlp, ORIGIN, tmp_path / "p.onnx")
    for wrong in (np.zeros((3, 7)), np.zeros(6), np.zeros((0, 6))):
        with pytest.raises(ObservationError, match=r"shape \(n, 6\)"):
            check(mlp, path, wrong)


def test_a_file_of_another_format_is_refused(mlp, observations):
    with pytest.raises(ConfigError, match=r"\.nir or \.onnx"):
        check(mlp, "policy.pt", observations)
