"""Delta networks as sparse students: thresholds, rounding, training, resuming."""

import numpy as np
import pytest
import torch

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.trainers.policies import DeltaMlpPolicy
from spikedeploy.trainers.policies.delta import delta_artifact
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.run_folder import RunFolder, load_policy
from spikedeploy.trainers.sparse.pool import Walk, WalkPool
from spikedeploy.trainers.sparse.sparse import Sparse
from spikedeploy.trainers.sparse.student import (
    operations,
    rounding_offsets,
    student,
    tuned_thresholds,
)
from tests import toy_stroll_env
from tests.delta_policies import delta_mlp, followed, walk
from tests.trainers.sparse.toy import settings

NETWORK = {"policy": {"kind": "delta-mlp", "hidden": 5}, "chip": "loihi2"}
END = 44  # updates of the toy's settings


def pool_of(walks, seed=0):
    labels = np.random.default_rng(seed).uniform(-1, 1, (60, 2)).astype(np.float32)
    pool = WalkPool()
    pool.add(Walk(walk(60, seed=k).astype(np.float32), labels) for k in range(walks))
    return pool


def test_thresholds_are_shares_of_how_much_activations_vary():
    policy = delta_mlp(left=1.0, threshold=0.4)
    policy.into.mask[2], policy.bias[2] = 0.0, 0.5  # a constant
    before = policy.threshold.clone()
    config, pool = settings(**NETWORK), pool_of(8)
    student(policy, config).prepare(pool)
    found = tuned_thresholds(policy, pool, config)
    activations = []
    for each in pool.walks:
        _, events, _ = followed(policy, each.observation)
        level = torch.from_numpy(np.cumsum(events, 0)) * policy.step
        activations.append(torch.relu(level @ policy.into().T + policy.bias))
    spread = torch.cat(activations).std(0)
    alive = torch.arange(8) != 2
    # of some windows, not of all walks
    torch.testing.assert_close(found[alive], 0.4 * spread[alive], rtol=0.35, atol=0.01)
    assert found[2] == before[2]


def test_operations_of_messages_are_those_of_the_ledger():
    policy = delta_mlp(left=0.8)
    config, pool = settings(window=40, **NETWORK), pool_of(12)
    learner = student(policy, config)
    learner.prepare(pool)
    rng = np.random.default_rng(0)
    for _ in range(300):
        learner.loss(pool, rng)
    controller = SpikingController(delta_artifact(policy), chip("ideal"))
    for each in pool.walks:
        controller.reset(0)
        for row in each.observation.astype(np.float64):
            controller.act(row)
    assert operations(learner.synapses()) == pytest.approx(
        controller.ledger.per_inference("sop"), rel=0.1
    )


def test_offsets_bring_torch_to_the_weights_of_the_chip():
    policy = delta_mlp(left=0.7)
    offsets = rounding_offsets(policy, chip("loihi2"))
    program = compile_program(delta_artifact(policy), chip("loihi2"))
    readout = program.layer("readout")
    (onto,) = (s for s in readout.synapses if s.source == "sd1")
    held = onto.weight * 64.0 * readout.scale  # of graded spikes [float units]
    live = [k for k in range(8) if (policy.out() + offsets["out"])[:, k].any()]
    found = ((policy.out() + offsets["out"]) * policy.threshold)[:, live].numpy()
    np.testing.assert_allclose(found, held.T, atol=1e-6)
    assert not offsets["out"][policy.out.mask == 0].any()


@pytest.fixture
def stroll(monkeypatch, tmp_path):
    monkeypatch.setattr("spikedeploy.trainers.sparse.sparse._ENV_COPIES", 3)
    toy_stroll_env.install(monkeypatch)
    return str(toy_stroll_env.ann(tmp_path / "teacher.onnx"))


class Rows(list):
    """Takes metrics like a journal."""

    count = 0

    def at(self, step, total):
        self.count = step

    def add(self, row):
        self.append(row)

    def rewind(self, step):
        self[:] = [row for row in self if row["updates"] <= step]


def learned(config, run, until=END, rows=None):
    rows = Rows() if rows is None else rows
    Sparse(config, run).learn(rows, lambda: rows.count >= until)
    return rows


def test_it_learns_down_to_its_budget(stroll, tmp_path):
    config = settings(teacher=stroll, budget=1.0, levels=(1.5,), **NETWORK)
    run = RunFolder.create(tmp_path, config)
    rows = learned(config, run)
    assert [row for row in rows if row["updates"] == END][-1]["operations"] <= 1.1
    policy = load_policy(run.path)
    assert isinstance(policy, DeltaMlpPolicy)
    assert (policy.threshold != policy.share).any()


def test_a_resumed_run_ends_as_one_that_was_not_interrupted(stroll, tmp_path):
    config = settings(teacher=stroll, checkpoint_every=6, **NETWORK)
    whole = RunFolder.create(tmp_path / "whole", config)
    learned(config, whole)
    parts = RunFolder.create(tmp_path / "parts", config)
    rows = learned(config, parts, 18)
    learned(config, parts, rows=rows)
    one, other = (load_policy(run.path, "last").state_dict() for run in (whole, parts))
    for name, tensor in one.items():
        assert torch.equal(tensor, other[name]), name


@pytest.mark.parametrize("task", ["hexapod", "hexapod-command", "kart-grid"])
def test_every_task_has_a_recipe_on_a_chip_with_graded_spikes(task):
    recipe = RECIPES[f"{task}-delta-mlp"]
    assert recipe.settings["policy"]["kind"] == "delta-mlp"
    assert chip(recipe.settings["chip"]).arithmetic.graded_bits
