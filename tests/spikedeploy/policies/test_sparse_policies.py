"""Event-driven policies as run folders and files: states through an episode, and what they cost."""

import json
import re

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.rollout import rollout
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.policies.registry import find, open_policy
from spikedeploy.policies.run_record import TorchController
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.settings import SparseConfig
from tests import toy_race_env, toy_stroll_env
from tests.delta_policies import delta_policy

SHAPES = [{}, {"hidden": 0}, {"skip": False}, {"code": "unary"}]


@pytest.fixture
def world(monkeypatch):
    toy_stroll_env.install(monkeypatch)
    return envs.make("stroll")


def shipped(tmp_path, env="stroll", **shape):
    """A run folder and its file."""
    policy = delta_policy(**{"obs": 3, "left": 1.0, **shape})
    config = SparseConfig(algorithm="sparse", recipe="smoke-sparse", env={"name": env})
    run = RunFolder.create(tmp_path, config)
    run.save("best", policy, {"updates": 1})
    origin = Provenance({"stroll": toy_stroll_env.ID, "race": toy_race_env.ID}[env])
    return run.path, to_nir(policy, origin, tmp_path / "policy.nir")


@pytest.mark.parametrize("shape", SHAPES)
def test_a_run_folder_acts_like_its_file_and_begins_every_episode_at_rest(shape, world, tmp_path):
    run, file = shipped(tmp_path, **shape)
    players = [open_policy(find(str(path)), "float", world) for path in (run, file)]
    for seed in (10_000, 10_001, 10_000):
        one, other = (rollout(world, player, seed) for player in players)
        np.testing.assert_allclose(one.action, other.action, atol=1e-5)
    player = TorchController(str(run))
    first = rollout(world, player, 10_000).action
    np.testing.assert_array_equal(first, rollout(world, player, 10_000).action)
    player.reset(10_000)
    replayed = player.replay(rollout(world, player, 10_000).observation[:-1])
    assert not np.array_equal(replayed, first)  # it goes on where it stood
    player.reset(10_000)
    seen = rollout(world, player, 10_000).observation[:-1]
    player.reset(10_000)
    np.testing.assert_array_equal(player.replay(seen), first)


def test_a_run_folder_that_chooses_acts_like_its_file(monkeypatch, tmp_path):
    toy_race_env.install(monkeypatch)
    race = envs.make("race")
    run, file = shipped(tmp_path, "race", obs=2, act=4, head="discrete")
    one, other = (
        rollout(race, open_policy(find(str(path)), "float", race), 10_000).action
        for path in (run, file)
    )
    np.testing.assert_array_equal(one, other)
    assert find(str(run)).kind == find(str(file)).kind == "snn"


def test_a_readout_on_the_host_is_counted_there(world, tmp_path):
    file = shipped(tmp_path)[1]
    costs = {}
    for way in ("probe", "none"):
        player = open_policy(find(str(file)), f"loihi1:membrane_output={way}", world)
        played = rollout(world, player, 10_000)
        costs[way] = player.costs(played)
    on_chip, on_host = costs["probe"], costs["none"]
    assert on_host.sops < on_chip.sops == on_chip.effective_acs
    # all neurons have the same fan-out here
    assert on_host.effective_acs == pytest.approx(on_chip.effective_acs)
    assert on_chip.sparsity == pytest.approx(on_host.sparsity)
    assert on_chip.input_spikes == on_host.input_spikes > 0


@pytest.mark.parametrize(("target", "way"), [
    ("loihi1", "2 neurons leave loihi1 .* reads from their registers"),
    ("loihi2", "2 neurons leave loihi2 .* graded spikes"),
    ("loihi1:membrane_output=none", "membranes do not leave loihi1, so the host integrates it"),
    ("ideal", "^$"),
])  # fmt: skip
def test_a_program_says_where_its_readout_is_read(target, way, tmp_path):
    remarks = compile_program(load(shipped(tmp_path)[1]), chip(target)).remarks
    assert re.search(way, " ".join(each for each in remarks if "leave" in each))


def test_run_says_how_late_a_pipelined_policy_acts_in_control_steps_and_in_time(
    world, tmp_path, command
):
    _, file = shipped(tmp_path)
    _, out, _ = command("run", file, "--chip", "loihi1:clock=pipelined", "--json")
    (row,) = json.loads(out)["rows"]
    program = compile_program(load(file), chip("loihi1"), clock="pipelined")
    assert row["control_steps_late"] == list(program.trailing) == [1, 2]
    assert row["late_s"] == [0.02, 0.04]
    _, out, _ = command("run", file, "--chip", "loihi1:clock=pipelined")
    assert "an observation acts 1 to 2 control steps later (20 to 40 ms)" in " ".join(out.split())
    _, out, _ = command("run", file, "--chip", "loihi1:clock=gated", "--json")
    assert "control_steps_late" not in json.loads(out)["rows"][0]
