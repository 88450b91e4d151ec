import json
from collections import Counter

import numpy as np
import pytest
import torch

from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.metrics import read
from spikedeploy.trainers.policies import DeltaSnnPolicy, MlpPolicy, PrunedMlpPolicy
from spikedeploy.trainers.run_folder import RunFolder, load_policy
from spikedeploy.trainers.sparse.pool import Episodes, Walk, load_walks, save_walks
from spikedeploy.trainers.sparse.sparse import Sparse
from spikedeploy.trainers.train import train
from tests import toy_race_env, toy_stroll_env
from tests.trainers.sparse.toy import settings

END = 44  # updates of the toy's settings


@pytest.fixture(autouse=True)
def few_copies(monkeypatch):
    monkeypatch.setattr("spikedeploy.trainers.sparse.sparse._ENV_COPIES", 3)


@pytest.fixture
def stroll(monkeypatch, tmp_path):
    toy_stroll_env.install(monkeypatch)
    return str(toy_stroll_env.ann(tmp_path / "teacher.onnx"))


class Rows:
    """Takes metrics like a journal."""

    def __init__(self):
        self.rows, self.count = [], 0

    def at(self, step, total):
        self.count = step

    def add(self, row):
        self.rows.append(row)

    def rewind(self, step):
        self.rows = [row for row in self.rows if row["updates"] <= step]


def learned(config, folder, until=END, run=None, rows=None):
    """A run folder, trained up to an update."""
    run = run or RunFolder.create(folder, config)
    rows = Rows() if rows is None else rows
    Sparse(config, run).learn(rows, lambda: rows.count >= until)
    return run, rows


POLICIES = [
    {"kind": "delta-snn", "hidden": 5},
    {"kind": "delta-snn", "hidden": 0},
    {"kind": "pruned-mlp", "hidden": [6, 4]},
    {"kind": "pruned-mlp", "hidden": []},
]


@pytest.mark.parametrize("policy", POLICIES)
def test_operations_fall_to_the_budget(policy, stroll, tmp_path):
    config = settings(teacher=stroll, policy=policy, budget=1.0, levels=(1.5,))
    run, rows = learned(config, tmp_path)
    found = [row for row in rows.rows if row["updates"] == END][-1]
    assert found["operations"] <= 1.1
    assert found["goal"] == 1
    assert rows.rows[0]["operations"] > 2
    assert sorted(path.stem for path in (run.path / "checkpoints").glob("*.safetensors")) == [
        "best", "last", "ops-1", "ops-1.5",
    ]  # fmt: skip
    best = json.loads(run.checkpoint("best").with_suffix(".json").read_text())
    assert best["eval_operations"] <= 1.1
    assert best["eval_of_teacher"] == pytest.approx(best["eval_return"] / best["teacher_return"])


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("stop", [5, 12, 20, 31])
def test_a_stopped_run_resumes_to_the_same_bits(policy, stop, stroll, tmp_path):
    config = settings(teacher=stroll, policy=policy, validation={"every": 6, "episodes": 1})
    whole, rows = learned(config, tmp_path)
    part, again = learned(config, tmp_path, until=stop)
    assert part.load("last")[0]["updates"] == stop
    learned(config, tmp_path, run=part, rows=again)
    assert_same(whole, part)
    speeds = {"updates_per_s", "episode_return"}
    for one, other in zip(rows.rows, again.rows, strict=True):
        assert {k: v for k, v in one.items() if k not in speeds} == pytest.approx(
            {k: v for k, v in other.items() if k not in speeds}, nan_ok=True
        )


@pytest.mark.parametrize("kill", [14, 25])
def test_a_killed_run_goes_on_from_its_last_checkpoint_with_the_same_walks(kill, stroll, tmp_path):
    config = settings(teacher=stroll, checkpoint_every=10)
    whole, _ = learned(config, tmp_path)
    part = RunFolder.create(tmp_path, config)
    rows = Rows()

    def stopped():
        if rows.count >= kill:
            raise KeyboardInterrupt
        return False

    with pytest.raises(KeyboardInterrupt):
        Sparse(config, part).learn(rows, stopped)
    assert part.load("last")[0]["updates"] == kill // 10 * 10
    learned(config, tmp_path, run=part)
    assert_same(whole, part)
    assert walks_in(whole) == walks_in(part)


def test_a_run_that_is_killed_while_it_begins_begins_anew(stroll, tmp_path, monkeypatch):
    config = settings(teacher=stroll)
    whole, _ = learned(config, tmp_path, until=3)
    part = RunFolder.create(tmp_path, config)
    with monkeypatch.context() as during:
        during.setattr(Sparse, "_fit", lambda self: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            learned(config, tmp_path, run=part)
    learned(config, tmp_path, run=part, until=3)
    assert_same(whole, part)
    assert walks_in(whole) == walks_in(part)


def assert_same(one, other):
    expected, found = (each.load("last") for each in (one, other))
    assert expected[0] == found[0]
    assert expected[1].keys() == found[1].keys()
    for name, tensor in expected[1].items():
        assert torch.equal(tensor, found[1][name]), name


def walks_in(run):
    files = sorted((run.path / "pool").iterdir())
    walks = [walk for path in files for walk in load_walks(path, (3, 2))]
    return Counter(walk.observation.tobytes() for walk in walks)


def test_walks_of_another_run_are_taken_over(stroll, tmp_path):
    first, _ = learned(settings(teacher=stroll), tmp_path, until=1)
    second, _ = learned(settings(teacher=stroll, pool=str(first.path), seed=1), tmp_path, until=1)
    assert walks_in(first) <= walks_in(second)
    assert walks_in(second).total() == 2 * walks_in(first).total()
    (empty := tmp_path / "empty").mkdir()
    (empty / "config.json").write_text("{}")
    with pytest.raises(ConfigError, match="no pool of walks"):
        learned(settings(teacher=stroll, pool=str(empty)), tmp_path, until=1)


def test_walks_of_another_task_or_teacher_are_refused_before_anyone_walks(
    stroll, tmp_path, monkeypatch
):
    first, _ = learned(settings(teacher=stroll), tmp_path, until=1)
    other = str(toy_stroll_env.ann(tmp_path / "other.onnx", seed=1))
    monkeypatch.setattr(Episodes, "play", lambda *_: 1 / 0)
    for teacher, recorded, message in (
        (stroll, {"env": {"name": "hexapod"}}, "has walks in hexapod, not in stroll"),
        (other, {}, rf"by the teacher {stroll}, and the teacher here is {other}"),
    ):
        written = json.loads((first.path / "config.json").read_text()) | recorded
        (first.path / "config.json").write_text(json.dumps(written))
        with pytest.raises(ConfigError, match=message):
            learned(settings(teacher=teacher, pool=str(first.path)), tmp_path)
        (first.path / "config.json").write_text(json.dumps(written | {"env": {"name": "stroll"}}))


def test_a_pool_that_is_not_there_leaves_no_run_folder(stroll, tmp_path):
    overrides = ["env.name=stroll", f"teacher={stroll}", "pool=nowhere"]
    with pytest.raises(ConfigError, match="'nowhere' is no run folder"):
        train("smoke-sparse", overrides=overrides, runs=tmp_path / "runs", quiet=True)
    assert not list((tmp_path / "runs").iterdir())


def of_width(walks, observations, actions):
    return [
        Walk(np.resize(w.observation, (len(w.label), observations)),
             np.resize(w.label, (len(w.label), actions)), w.crashed) for w in walks
    ]  # fmt: skip


def with_nan(walks):
    walks[0].label[3, 1] = np.nan
    return walks


DAMAGES = [
    (lambda path: path.unlink(), r"001\.safetensors is missing: .* train again"),
    (lambda path: path.write_bytes(path.read_bytes()[:99]), r"001\.safetensors holds no walks"),
    (lambda path: save_walks(of_width(load_walks(path, (3, 2)), 4, 2), path),
     r"001\.safetensors holds no walks of this task .*observation is float32 \(\d+, 4\)"),
    (lambda path: save_walks(of_width(load_walks(path, (3, 2)), 3, 1), path),
     r"label is float32 \(\d+, 1\)"),
    (lambda path: save_walks(with_nan(load_walks(path, (3, 2))), path),
     r"001\.safetensors holds no walks .*expected finite float32"),
]  # fmt: skip


@pytest.mark.parametrize(("damage", "message"), DAMAGES)
def test_a_missing_or_damaged_file_of_walks_is_named(damage, message, stroll, tmp_path):
    run, _ = learned(settings(teacher=stroll), tmp_path, until=8)
    damage(run.path / "pool" / "001.safetensors")
    # the run that wrote it knows its checksum; others read what is in it
    own = message if "missing" in message else "does not have the checksum in checkpoints/last"
    with pytest.raises(ConfigError, match=own):
        learned(settings(teacher=stroll), tmp_path, run=run)
    if "missing" not in message:
        with pytest.raises(ConfigError, match=message):
            learned(settings(teacher=stroll, pool=str(run.path)), tmp_path)


def test_a_run_without_any_of_its_walks_is_not_resumed(stroll, tmp_path):
    run, _ = learned(settings(teacher=stroll), tmp_path, until=8)
    for path in (run.path / "pool").iterdir():
        path.unlink()
    with pytest.raises(ConfigError, match=r"000\.safetensors is missing"):
        learned(settings(teacher=stroll), tmp_path, run=run)


def test_binary_observations_step_by_their_whole_swing(stroll, tmp_path, monkeypatch):
    step = toy_stroll_env.StrollEnv.step

    def with_contact(self, action):
        observation, *rest = step(self, action)
        observation[2] = 3.0 if observation[0] > 0 else 1.0
        return observation, *rest

    monkeypatch.setattr(toy_stroll_env.StrollEnv, "step", with_contact)
    reset = toy_stroll_env.StrollEnv.reset

    def with_first(self, *, seed=None, options=None):
        observation, info = reset(self, seed=seed, options=options)
        observation[2] = 1.0
        return observation, info

    monkeypatch.setattr(toy_stroll_env.StrollEnv, "reset", with_first)
    run, _ = learned(settings(teacher=stroll), tmp_path, until=1)
    policy = run.policy("last")
    assert (policy.normalizer.mean[2], policy.normalizer.std[2], policy.step[2]) == (1, 2, 1)
    assert policy.step[:2].tolist() == [0.5, 0.5]


@pytest.mark.parametrize("policy", [POLICIES[0], POLICIES[2]])
def test_a_chooser_learns_from_logits(policy, tmp_path, monkeypatch):
    toy_race_env.install(monkeypatch)
    origin = Provenance(toy_race_env.ID)
    teacher = to_onnx(MlpPolicy(2, 4, hidden=(8,), head="discrete"), origin, tmp_path / "t.onnx")
    config = settings(teacher=str(teacher), env={"name": "race"}, policy=policy, crash_windows=0.3)
    run, rows = learned(config, tmp_path)
    assert run.policy("best").head == "discrete"
    assert "eval_finish" in rows.rows[-1]
    observation = torch.zeros(3, 2)
    assert run.policy("best")(observation).shape == (3,)


@pytest.mark.parametrize(
    ("recipe", "kind"), [("smoke-sparse", DeltaSnnPolicy), ("smoke-sparse-mlp", PrunedMlpPolicy)]
)
def test_a_smoke_recipe_leaves_a_policy_within_its_budget(recipe, kind, tmp_path):
    run = train(recipe, runs=tmp_path, quiet=True)
    rows = read(run / "metrics.csv")
    assert rows[-1]["operations"] < 61
    assert isinstance(load_policy(run), kind)
    assert float(load_policy(run).normalizer.std.min()) > 0


def test_an_unsuitable_teacher_or_chip_is_refused_before_training(stroll, tmp_path):
    for changes, message in (
        ({"teacher": ""}, "--set teacher=PATH"),
        ({"env": {"name": "hexapod"}}, "not in hexapod"),
        ({"chip": "xylo-a3"}, "rounding=false"),
    ):
        config = settings(**{"teacher": stroll, **changes})
        with pytest.raises(ConfigError, match=message):
            Sparse(config, RunFolder.create(tmp_path, config))


def test_noise_and_walks_are_those_of_the_seed(stroll, tmp_path):
    pools = []
    for seed in (0, 0, 1):
        run, _ = learned(settings(teacher=stroll, seed=seed), tmp_path, until=1)
        pools.append(walks_in(run))
    assert pools[0] == pools[1]
    assert pools[0] != pools[2]
    assert np.all([pool.total() == 3 for pool in pools])
