import numpy as np
import pytest

from spikedeploy.exporters.parity import check
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies.delta_policy import live_neurons
from tests.delta_policies import delta_policy, walk

ORIGIN = Provenance("spikedeploy/Hexapod-v0", "hexapod-sparse")
SHAPES = [
    {},
    {"code": "unary"},
    {"timesteps": 4, "most": 2},
    {"timesteps": 2, "clock": "gated", "integrated": True},
    {"timesteps": 3, "hidden": 0},
    {"hidden": 0},
    {"skip": False},
    {"head": "discrete", "act": 4},
]


def written(policy, tmp_path):
    return to_nir(policy, ORIGIN, tmp_path / "policy.nir")


def failed(checks):
    return [check.name for check in checks if not check.passed]


@pytest.mark.parametrize("shape", SHAPES)
def test_torch_numpy_and_ideal_agree_over_an_episode(shape, tmp_path):
    policy = delta_policy(**shape)
    checks = check(policy, written(policy, tmp_path), walk(200))
    assert not failed(checks)
    live = int(live_neurons(policy).sum())
    assert live > 4 or not policy.hidden
    # 200 control steps of the channels and the neurons
    rows, channels = 200 * policy.timesteps, 2 * policy.most * 5
    assert checks[0].detail == f"{rows * (channels + live):,} compared, all equal"


def test_a_changed_decay_is_found_in_the_actions_and_a_changed_step_in_the_spikes(tmp_path):
    policy = delta_policy()
    path, observation = written(policy, tmp_path), walk(100)
    policy._gamma += 1e-3
    assert failed(check(policy, path, observation)) == ["actions: torch = NumPy, float64"]
    policy.step *= 1.1
    assert "spikes: torch = NumPy, float64" in failed(check(policy, path, observation))


@pytest.mark.parametrize("code", ["one-hot", "unary"])
@pytest.mark.parametrize("target", ["loihi1", "loihi2", "ideal", "int"])
def test_a_batch_on_a_chip_equals_single_robots(code, target, tmp_path):
    artifact = load(written(delta_policy(code=code), tmp_path))
    observation = np.stack([walk(30, seed=seed) for seed in range(3)])
    together = SpikingController(artifact, chip(target))
    alone = SpikingController(artifact, chip(target))
    actions = np.stack([together.act_batch(row) for row in observation.swapaxes(0, 1)], axis=1)
    for robot, expected in zip(observation, actions, strict=True):
        alone.reset(0)
        np.testing.assert_array_equal([alone.act(row) for row in robot], expected)


def test_states_are_always_kept(tmp_path):
    assert load(written(delta_policy(), tmp_path)).convention.state == "kept"
    to_nir(delta_policy(), ORIGIN, tmp_path / "kept.nir", state="kept")
    with pytest.raises(ConfigError, match=r"delta-snn.*keeps its states"):
        to_nir(delta_policy(), ORIGIN, tmp_path / "reset.nir", state="reset")
