"""Policies that choose one of several actions, from every format: the best one, or drawn."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from spikedeploy import envs
from spikedeploy.envs.rollout import rollout
from spikedeploy.evaluation_setup import Setup
from spikedeploy.exporters.onnx_graph import OUTPUTS
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.policies.registry import find, open_policy
from spikedeploy.runtime.errors import ArtifactError, ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import SpikingMlpConfig
from spikedeploy.trainers.policies import MlpPolicy, from_config
from spikedeploy.trainers.ppo import PpoConfig
from spikedeploy.trainers.run_folder import RunFolder
from tests import toy_stroll_env
from tests.toy_quadrant_env import QuadrantEnv

ORIGIN = Provenance("", created="2026-01-01T00:00:00Z", version="0.1.0")
OBSERVATIONS = np.random.default_rng(0).uniform(-1, 1, (40, 2))


def spiking(folder, coding):
    """A run folder of an untrained spiking policy, and its policy."""
    torch.manual_seed(1)  # a policy that takes several actions
    config = PpoConfig(
        algorithm="ppo",
        recipe="smoke",
        env={"name": ""},
        policy=SpikingMlpConfig(hidden=(16, 16), coding=coding),
    )
    policy = from_config(config.policy, observations=2, actions=4, head="discrete")
    with torch.no_grad():
        policy.readout.bias.zero_()
        policy.readout.weight *= 2
    run = RunFolder.create(folder, config)
    run.save("best", policy, {"env_steps": 5})
    return run.path, policy


def write(kind, folder, coding="regular"):
    if kind == ".onnx":
        torch.manual_seed(0)
        return to_onnx(MlpPolicy(2, 4, hidden=(8,), head="discrete"), ORIGIN, folder / "p.onnx")
    run, policy = spiking(folder, coding)
    return run if kind == "run" else to_nir(policy, ORIGIN, folder / "p.nir")


def opened(kind, folder, chip="float", sampled=False, coding="regular"):
    candidate = replace(find(str(write(kind, folder, coding))), env=None)
    return candidate, open_policy(
        candidate, chip if candidate.kind == "snn" else None, QuadrantEnv(), Setup(sampled=sampled)
    )


def acted(player, seed):
    player.reset(seed)
    return [int(player.act(observation)) for observation in OBSERVATIONS]


KINDS = [".onnx", ".nir", "run"]


@pytest.mark.parametrize("kind", KINDS)
def test_an_episode_is_a_list_of_choices(kind, tmp_path):
    candidate, player = opened(kind, tmp_path)
    assert candidate.actions == 4
    assert candidate.kind == ("ann" if kind == ".onnx" else "snn")
    played = rollout(QuadrantEnv(), player, 10_000)
    assert (played.action.shape, played.action.dtype) == ((10,), np.int64)
    player.costs(played)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("coding", ["regular", "bernoulli"])
def test_replaying_an_episode_repeats_it_dice_included(kind, sampled, coding, tmp_path):
    _, player = opened(kind, tmp_path, sampled=sampled, coding=coding)
    expected = acted(player, 10_003)
    player.reset(10_003)
    assert player.replay(OBSERVATIONS).tolist() == expected
    changed = acted(player, 10_004)
    assert (changed == expected) == (not sampled and (coding == "regular" or kind == ".onnx"))


@pytest.mark.parametrize("coding", ["regular", "bernoulli"])
def test_the_file_chooses_as_its_run_does_from_the_same_dice(coding, tmp_path):
    found = []
    for kind in ("run", ".nir"):
        (tmp_path / kind).mkdir()
        found.append(acted(opened(kind, tmp_path / kind, coding=coding)[1], 10_000))
    assert found[0] == found[1]
    assert len(set(found[0])) > 2


@pytest.mark.parametrize("kind", KINDS)
def test_sampling_takes_the_best_action_most_often_but_not_always(kind, tmp_path):
    _, best = opened(kind, tmp_path)
    (tmp_path / "again").mkdir()
    _, drawn = opened(kind, tmp_path / "again", sampled=True)
    observation = OBSERVATIONS[3]
    drawn.reset(0)
    counts = np.bincount(drawn.replay(np.tile(observation, (400, 1))), minlength=4)
    assert counts.argmax() == best.act(observation)
    assert counts.min() > 0


def test_numbers_are_not_sampled(monkeypatch, tmp_path):
    toy_stroll_env.install(monkeypatch)
    candidate = find(str(toy_stroll_env.ann(tmp_path / "p.onnx")))
    with pytest.raises(ConfigError, match="only one of several actions can be sampled"):
        open_policy(candidate, None, envs.make("stroll"), Setup(sampled=True))


def test_an_unknown_head_is_refused(monkeypatch, tmp_path):
    monkeypatch.setitem(OUTPUTS, "ordinal", "ranks")
    policy = MlpPolicy(2, 4, hidden=())
    policy.head = "ordinal"
    with pytest.raises(ArtifactError, match="head 'ordinal'; known are continuous, discrete"):
        find(str(to_onnx(policy, ORIGIN, tmp_path / "p.onnx")))
