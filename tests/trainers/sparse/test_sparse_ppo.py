import shutil

import numpy as np
import pytest
import torch

from spikedeploy import envs
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.distill.teachers import Teacher
from spikedeploy.trainers.metrics_file import read_metrics
from spikedeploy.trainers.ppo import minibatches
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.rounding import rounding_offsets
from spikedeploy.trainers.sparse.settings import SparseConfig
from spikedeploy.trainers.sparse.sparse_ppo import (
    Exploring,
    SparsePpoConfig,
    SparsePpoLearner,
    cut_tiles,
    starting_point,
)
from spikedeploy.trainers.sparse.walks import Episodes, WalkPool
from spikedeploy.trainers.train import train
from tests.toy_pointing_env import PointingEnv
from tests.toy_quadrant_env import QuadrantEnv

SHORT = [
    "dense_updates=10", "level_updates=10", "polish=0", "teacher_walks=1", "noisy_walks=0",
    "validation.every=5", "budget=400", "levels=[500]",
]  # fmt: skip


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """A finished run of a sparse recipe."""
    return train("smoke-sparse", overrides=SHORT, runs=tmp_path_factory.mktemp("runs"), quiet=True)


@pytest.fixture
def played(start):
    """A learner with rounded weights, and two walks on which it explored."""
    torch.manual_seed(0)
    run = RunFolder(start)
    source = run.config(SparseConfig)
    config = resolve(SparsePpoConfig, "smoke-sparse-tuned", overrides=["batch=3"])
    learner = SparsePpoLearner(config, source, run.policy("best").requires_grad_(True))
    learner.student.round(chip(source.chip))
    controller = Exploring(learner.student.acting(), learner.head)
    episodes = Episodes(config.env, 2, 40)
    walks, _, _ = episodes.play([1, 2], controller, lambda seen: np.zeros((len(seen), 18)))
    return learner, WalkPool(walks), torch.stack(controller.drawn)


def tried(learner, pool, drawn):
    """Windows of the walks, with random advantages."""
    found, mean = learner.replay(pool)
    return learner.trials(found, mean, drawn, torch.randn(drawn.shape[:2]))


def test_it_trains_from_the_command_line_and_never_ends_below_its_start(start, tmp_path, command):
    code, _, err = command(
        "train", "smoke-sparse-tuned", "--set", f"start={start}", "--runs", tmp_path
    )
    assert code == 0, err
    (run,) = tmp_path.iterdir()
    rows = read_metrics(run / "metrics.csv")
    assert [row["iterations"] for row in rows] == [0, 1, 2, 3]
    assert "gain" not in rows[1]  # the critic alone learns first
    assert "gain" in rows[2]
    begin = rows[0]
    record = RunFolder(run).load("best")[0]
    # the CSV file has ten digits
    assert record["eval_return"] >= begin["eval_return"] - 1e-6
    assert record["eval_operations"] <= max(400, begin["eval_operations"]) + 1e-6
    # the folder says which policy is in it, and exporters find it there
    assert RunFolder(run).settings()["policy"] == RunFolder(start).settings()["policy"]


def test_it_can_start_at_an_earlier_level_of_pruning(start, tmp_path):
    overrides = [f"start={start}", "start_checkpoint=ops-500"]
    run = train("smoke-sparse-tuned", overrides=overrides, runs=tmp_path, quiet=True)
    config = RunFolder(run).config(SparsePpoConfig)
    found, source, policy = starting_point(config, tmp_path)
    assert (found.path, source.budget) == (start, 500)
    earlier, best = RunFolder(start).policy("ops-500"), RunFolder(start).policy()
    for name, mask in earlier.state_dict().items():
        if name.endswith("mask"):
            assert torch.equal(policy.state_dict()[name], mask)
            assert torch.equal(RunFolder(run).policy("last").state_dict()[name], mask)
    synapses = [sum(int(m.sum()) for n, m in each.state_dict().items() if n.endswith("mask"))
                for each in (earlier, best)]  # fmt: skip
    assert synapses[0] > synapses[1]


def test_the_float_baseline_learns_in_the_same_way(tmp_path):
    baseline = train("smoke-sparse-mlp", overrides=SHORT, runs=tmp_path, quiet=True)
    run = train("smoke-sparse-tuned", overrides=[f"start={baseline}"], runs=tmp_path, quiet=True)
    policy, old = RunFolder(run).policy("last"), RunFolder(baseline).policy()
    assert RunFolder(run).settings()["policy"]["kind"] == policy.kind == "pruned-mlp"
    for one, other in zip(policy.matrices, old.matrices, strict=True):
        assert torch.equal(one.mask, other.mask)
    assert not torch.equal(policy.matrices[-1].weight, old.matrices[-1].weight)
    rows = read_metrics(run / "metrics.csv")
    assert all(0 < row["operations"] <= 77 * 8 + 8 * 18 + 77 * 18 for row in rows[1:])


def test_hidden_neurons_can_be_left_as_they_are(start, tmp_path):
    overrides = [f"start={start}", "learns=readout"]
    run = train("smoke-sparse-tuned", overrides=overrides, runs=tmp_path, quiet=True)
    policies = RunFolder(start).policy(), RunFolder(run).policy("last")
    before, after = (dict(policy.named_parameters()) for policy in policies)
    changed = {name for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"out.weight", "past.weight", "action_bias", "_gamma"}


def test_a_run_is_resumed_where_it_was_moved_with_its_start(start, tmp_path, monkeypatch):
    from spikedeploy.trainers.sparse.sparse_ppo import SparsePpo

    inside = shutil.copytree(start, tmp_path / "runs" / start.name)
    with monkeypatch.context() as patch:
        patch.setattr(SparsePpo, "_iterate", lambda *_: False)
        part = train(
            "smoke-sparse-tuned", overrides=[f"start={inside}"], runs=inside.parent, quiet=True
        )
    inside.parent.rename(tmp_path / "elsewhere")
    moved = tmp_path / "elsewhere" / part.name
    assert train("smoke-sparse-tuned", resume=moved, quiet=True) == moved
    assert RunFolder(moved).load("last")[0]["iterations"] == 3


def test_the_ratio_is_one_before_the_first_update(played):
    learner, pool, drawn = played
    trials = tried(learner, pool, drawn)
    for part in minibatches(trials, 3):
        mean, _ = learner._replayed(part)
        again = learner.log_probability(mean, part.drawn)
        # matrix products of other batch sizes add in another order
        torch.testing.assert_close(again, part.before, rtol=1e-4, atol=1e-4)
    metrics = learner._update(trials)
    assert metrics["kl"] == pytest.approx(0, abs=1e-5)
    assert metrics["clipped"] == 0


def test_replayed_windows_have_the_log_probabilities_of_what_was_executed(played):
    learner, pool, drawn = played
    policy = learner.student.acting()
    observation = torch.from_numpy(np.stack([walk.observation for walk in pool.walks], 1))
    state = policy.initial_states(2)
    executed = torch.stack(
        [learner.head.log_probability(policy.advance(seen, state)[0], each)
         for seen, each in zip(observation, drawn, strict=True)]
    )  # fmt: skip
    learner._config = learner._config.model_copy(update={"window": 44})  # the whole walk
    trials = tried(learner, pool, drawn)
    assert len(trials.drawn) == 2
    torch.testing.assert_close(trials.before, executed.T.contiguous(), rtol=1e-3, atol=1e-3)


def test_windows_cover_every_step_of_every_walk_once(played):
    learner, pool, _ = played
    learner.replay(pool)
    walks = list(pool.walks)
    pool.walks[1] = type(walks[1])(walks[1].observation[:30], walks[1].label[:30])
    found = cut_tiles(pool, 16, 4)
    counted = zip(found.row, found.at, found.counts, strict=True)
    steps = [(int(row), int(t)) for row, at, counts in counted for t in at[counts]]
    assert sorted(steps) == [(0, t) for t in range(40)] + [(1, t) for t in range(30)]
    assert found.windows.begins.tolist() == [True, False, False, False, True, False, False]


def test_exploration_and_replay_compute_with_the_weights_of_the_chip(played):
    learner, _, _ = played
    offsets, _ = rounding_offsets(learner.student.policy, chip("loihi1"))
    assert any(added.abs().max() > 0 for added in offsets.values())
    for name, added in offsets.items():
        plain = getattr(learner.student.policy.weights(), name)
        exploring = learner.student.acting().weights()
        torch.testing.assert_close(getattr(exploring, name), plain + added)
        torch.testing.assert_close(getattr(learner.student.weights(), name), plain + added)


def test_the_learning_rate_follows_the_divergence(played):
    learner, pool, drawn = played
    trials = tried(learner, pool, drawn)
    learner.rate = 1e-6
    row = learner._improve(trials)
    assert row["kl"] < 0.005
    assert row["learning_rate"] == pytest.approx(1e-6 * 1.5**2)  # after two passes
    learner.rate = 0.3
    row = learner._improve(trials)
    assert row["kl"] > 0.02
    assert row["learning_rate"] == pytest.approx(0.2)  # after one


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ([], "smoke-sparse-tuned needs a finished run: --set start=RUN"),
        (["start=nowhere"], "'nowhere' is no run folder"),
        (["start={start}", "env.name=hexapod-command"], "trained in hexapod, not in hexapod-comm"),
        (
            ["start={start}", "start_checkpoint=ops-9"],
            "no policy 'ops-9' yet; of its levels it has ops-400, ops-5",
        ),
        (["start={start}", "burn_in=9"], "window: 16 is less than twice burn_in"),
    ],
)
def test_what_it_cannot_start_from_is_refused(overrides, message, start, tmp_path):
    overrides = [each.format(start=start) for each in overrides]
    with pytest.raises(ConfigError, match=message):
        train("smoke-sparse-tuned", overrides=overrides, runs=tmp_path, quiet=True)


def test_runs_without_a_policy_at_their_budget_and_other_runs_are_refused(start, tmp_path):
    unfinished = tmp_path / "unfinished"
    shutil.copytree(start, unfinished)
    (unfinished / "checkpoints" / "best.safetensors").unlink()
    with pytest.raises(ConfigError, match="no policy 'best' yet"):
        train("smoke-sparse-tuned", overrides=[f"start={unfinished}"], runs=tmp_path, quiet=True)
    tuned = train("smoke-sparse-tuned", overrides=[f"start={start}"], runs=tmp_path, quiet=True)
    with pytest.raises(ConfigError, match="is a run of sparse-ppo"):
        train("smoke-sparse-tuned", overrides=[f"start={tuned}"], runs=tmp_path, quiet=True)


TOY = [
    "env.name=kart-grid", "teacher=toy", "budget=40", "levels=[60]", "walks=50", "window=10",
    "burn_in=0", "validation.limit=10", "validation.episodes=20", "dense_updates=150",
    "level_updates=60", "polish=0", "step=0.2", "policy.most=8", "teacher_walks=50",
]  # fmt: skip
REWARDED = [
    "env.name=kart-grid", "iterations=12", "episodes=60", "window=10", "burn_in=0", "batch=20",
    "gamma=0.0", "validation.limit=10", "validation.every=4", "actor_rate=1e-2",
    "validation.episodes=20", "imitation=0.0", "target_kl=0.2", "noise=[0.3,0.1]",
]  # fmt: skip


GATED = ["policy.clock=gated"]


@pytest.mark.parametrize(
    ("world", "taught"),
    [
        # both teachers know half of what the task rewards
        (PointingEnv, lambda seen: seen * np.array([1.0, 0.0])),
        (QuadrantEnv, lambda seen: 3.0 * np.stack([x := -np.sign(seen[:, 0]), -x, x, -x], 1)),
    ],
)
def test_reward_teaches_what_the_teacher_does_not_know(world, taught, tmp_path, monkeypatch):
    monkeypatch.setattr(envs, "make", lambda name, **options: world())
    actions = 2 if world is PointingEnv else 4
    toy = Teacher(taught, 2, actions)
    for module in ("sparse.sparse", "sparse.sparse_ppo"):
        monkeypatch.setattr(f"spikedeploy.trainers.{module}.teacher", lambda *_: toy)
    # the goal of a step is drawn anew in the next: a policy that is late cannot know it
    run = train("smoke-sparse", overrides=[*TOY, *GATED], runs=tmp_path, quiet=True)
    rewarded = [f"start={run}", *REWARDED, *GATED]
    better = train("smoke-sparse-tuned", overrides=rewarded, runs=tmp_path, quiet=True)
    first, *_, last = (
        row["eval_return"] for row in read_metrics(better / "metrics.csv") if "eval_return" in row
    )
    assert last > first + 1.0
