import json
from collections import Counter

import numpy as np
import pytest
import torch

from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.policies import MlpPolicy
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sac import SacConfig
from spikedeploy.trainers.sparse.batch_controllers import controller_of
from spikedeploy.trainers.sparse.phases import Ended, target
from spikedeploy.trainers.sparse.settings import SparseConfig
from spikedeploy.trainers.sparse.sparse import Sparse, with_budget
from spikedeploy.trainers.sparse.walks import Episodes, Stateless, walks_of
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

    def move_to(self, step, total):
        self.count = step

    def add(self, row):
        self.rows.append(row)

    def rewind(self, step):
        self.rows = [row for row in self.rows if row["updates"] <= step]


def learned(config, folder, until=END, run=None, rows=None):
    """A run folder, trained up to an update."""
    run = run or RunFolder.create(folder, config)
    rows = Rows() if rows is None else rows
    runner = Sparse(config, run)
    if run.begun:
        runner.resume()
        rows.rewind(runner.step)
    else:
        runner.begin()
    runner.learn(rows, lambda: rows.count >= until)
    return run, rows


POLICIES = [
    {"kind": "delta-snn", "hidden": 5},
    {"kind": "delta-snn", "hidden": 0},
    {"kind": "pruned-mlp", "hidden": [6, 4]},
    {"kind": "delta-snn", "hidden": 5, "integrated": True, "timesteps": 2},
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
    assert best["eval_operations"] <= 1.5  # in validation; the budget is one of the pool
    assert best["eval_of_teacher"] == pytest.approx(best["eval_return"] / best["teacher_return"])
    earned, none = best["eval_return"] - best["random_return"], best["random_return"]
    assert best["eval_share"] == pytest.approx(earned / (best["teacher_return"] - none))


@pytest.mark.parametrize(("policy", "stop"), list(zip(POLICIES, (12, 31, 31, 31), strict=True)))
def test_a_stopped_run_resumes_to_the_same_bits(policy, stop, stroll, tmp_path):
    validation = {"every": 6, "episodes": 1}
    config = settings(teacher=stroll, policy=policy, validation=validation)
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


def assert_same(one, other):
    expected, found = (each.load("last") for each in (one, other))
    assert expected[0] == found[0]
    assert expected[1].keys() == found[1].keys()
    for name, tensor in expected[1].items():
        assert torch.equal(tensor, found[1][name]), name


def walks_in(run):
    walks = walks_of(run.load("last")[1])
    return Counter(walk.observation.tobytes() for walk in walks)


def test_walks_of_another_run_are_taken_over(stroll, tmp_path):
    first, _ = learned(settings(teacher=stroll), tmp_path, until=1)
    second, _ = learned(settings(teacher=stroll, pool=str(first.path), seed=1), tmp_path, until=1)
    assert walks_in(first) <= walks_in(second)
    assert walks_in(second).total() == 2 * walks_in(first).total()
    second.save("last", second.policy("last"), second.load("last")[0])
    with pytest.raises(ConfigError, match="no pool of walks"):
        learned(settings(teacher=stroll, pool=str(second.path)), tmp_path, until=1)


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


def test_an_unsuitable_teacher_or_chip_is_refused_before_training(stroll, tmp_path):
    for changes, message in (
        ({"teacher": ""}, "--set teacher=PATH"),
        ({"env": {"name": "hexapod"}}, "not in hexapod"),
        ({"chip": "xylo-a3"}, "rounding=false"),
    ):
        config = settings(**{"teacher": stroll, **changes})
        with pytest.raises(ConfigError, match=message):
            Sparse(config, RunFolder.create(tmp_path, config))


def sparse(recipe):
    return resolve(SparseConfig, recipe)


def test_a_budget_replaces_that_of_the_recipe_and_moves_its_levels():
    before = sparse("hexapod-sparse").model_copy(update={"budget": 60.0, "levels": (180.0, 90.0)})
    found = with_budget(before, "sops=120")
    assert (found.budget, found.levels_in_order) == (120, (360, 180, 120))
    same = {"budget": 60.0, "levels": (180.0, 90.0)}
    assert found.model_copy(update=same) == before
    derived = with_budget(before.model_copy(update={"levels": ()}), "sops=20")
    assert derived.levels_in_order == (60, 40, 30, 24, 20)
    assert with_budget(sparse("hexapod-small-mlp"), "macs=500").budget == 500


@pytest.mark.parametrize(
    ("recipe", "text", "message"),
    [
        ("hexapod-sparse", "macs=480", r"delta-snn policy are sops, .* --budget sops="),
        ("hexapod-small-mlp", "sops=480", r"pruned-mlp policy are macs, .* --budget macs="),
        ("hexapod-sparse", "480", "--budget sops="),
        ("hexapod-sparse", "sops=", "--budget sops="),
        ("hexapod-sparse", "sops=many", "budget: .* number, .* got 'many'"),
        ("hexapod-sparse", "sops=-3", r"budget: .* greater than or equal to 0, got -3"),
        ("hexapod-sparse", "sops=0", r"budget: 0 operations"),
        ("distill-sparse", "sops=0", r"--budget sops=0: 0 operations"),
        ("hexapod-sparse", "sops=inf", r"budget: .* finite number, got inf"),
        ("hexapod-sparse", "sops=1e308", r"--budget sops=1e308: levels.0: .* finite number"),
    ],
)
def test_a_wrong_budget_is_refused_in_one_line(recipe, text, message):
    with pytest.raises(ConfigError, match=message) as error:
        with_budget(sparse(recipe), text)
    assert "\n" not in str(error.value)


def test_other_recipes_have_no_budget(tmp_path):
    with pytest.raises(
        ConfigError, match="hexapod-sac has no budget of operations; hexapod-sparse"
    ):
        with_budget(resolve(SacConfig, "hexapod-sac"), "sops=480")
    with pytest.raises(ConfigError, match="smoke has no budget"):
        train("smoke", budget="sops=480", runs=tmp_path)
    assert not list(tmp_path.iterdir())


SEARCH = {"search": True, "budget": 0, "patience": 1, "shrink": 0.5, "polish": 1}


@pytest.fixture
def few(monkeypatch):
    """The toy's policies take few operations from the start."""
    monkeypatch.setattr("spikedeploy.trainers.sparse.phases._FEWEST", 0.3)


@pytest.mark.parametrize(
    ("policy", "stop"), [(POLICIES[0], 7), (POLICIES[0], 31), (POLICIES[2], 13)]
)
def test_a_stopped_search_resumes_to_the_same_bits(policy, stop, stroll, few, tmp_path):
    config = settings(teacher=stroll, policy=policy, keep=0.5, **SEARCH)
    whole, _ = learned(config, tmp_path, until=1_000)
    assert whole.load("last")[0]["finished"]
    part, again = learned(config, tmp_path, until=stop)
    assert part.load("last")[0]["updates"] == stop
    learned(config, tmp_path, until=1_000, run=part, rows=again)
    assert_same(whole, part)


def test_a_search_keeps_the_policy_of_the_lowest_level_that_keeps_its_share(stroll, few, tmp_path):
    config = settings(teacher=stroll, keep=0.9, **SEARCH)
    run, _ = learned(config, tmp_path, until=1_000)
    last, best = run.load("last")[0], run.load("best")[0]
    ended = [Ended(**each) for each in last["ended"]]
    wanted = target(config, ended)
    assert last["kept"] == min(e.goal for e in ended if e.goal and e.share >= wanted)
    assert best["eval_share"] >= wanted
    # what decides are episodes on which no checkpoint was chosen
    assert not set(config.confirming) & set(config.validation.seeds)
    policy, played = (
        controller_of(run.policy("best"), chip(config.chip)),
        Episodes(config.env, 3, None),
    )
    _, returns, _ = played.play(config.confirming, policy)
    # by the ledger, not by what training expected
    assert best["eval_operations"] == policy.operations(played.lengths)
    teacher, none = last["confirming"]
    assert best["eval_return"] == np.mean(returns)
    assert best["eval_share"] == (best["eval_return"] - none) / (teacher - none)


def test_a_level_that_was_kept_by_chance_is_not_kept(stroll, few, tmp_path, monkeypatch):
    config, evaluate = settings(teacher=stroll, keep=0.9, **SEARCH), Sparse._measure

    def unlucky(self, policy, seeds, references):
        row = evaluate(self, policy, seeds, references)
        return {**row, "eval_share": 0.1} if seeds == config.confirming else row

    monkeypatch.setattr(Sparse, "_measure", unlucky)
    run, _ = learned(config, tmp_path, until=1_000)
    assert run.load("last")[0]["kept"] == 0
    best = [each for each in run.load("last")[0]["ended"] if each["goal"] is None]
    assert run.load("best")[0]["eval_share"] == max(each["share"] for each in best)


def test_a_search_refuses_a_teacher_that_earns_no_more_than_random_actions(
    stroll, tmp_path, monkeypatch
):
    perfect = Stateless(lambda seen: np.tanh(seen[:, :2]))  # in place of random ones
    monkeypatch.setattr("spikedeploy.trainers.sparse.sparse.random_actions", lambda *_: perfect)
    with pytest.raises(ConfigError, match=r"earns .*, and random actions .* other units"):
        learned(settings(teacher=stroll, **SEARCH), tmp_path, until=1)
