"""`distill`: from anybody's teacher to a spiking student that runs on a chip."""

import json

import pytest

from spikedeploy.commands.distillation import student_settings, summarise_returns
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.run_folder import RunFolder
from tests.paths import ROOT

REACH, LEVELS = "tests.own_env:Reach", "tests.own_env:Levels"
QUICK = [
    "states=24", "iterations=2", "updates=20", "env.count=2", "validation.every=10",
    "validation.episodes=1", "policy.populations=2",
]  # fmt: skip


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def settings(*changes):
    return [word for change in (*QUICK, *changes) for word in ("--set", change)]


@pytest.mark.parametrize(
    ("teacher", "env"),
    [
        (ROOT / "tests/golden/sb3/sac.zip", REACH),
        (ROOT / "tests/golden/sb3/ppo.zip", "CartPole-v1"),
        ("tests.own_teachers:reach", REACH),
        ("tests.own_teachers:level", LEVELS),
    ],
)
def test_a_student_of_any_teacher_runs_on_a_chip(teacher, env, here, command):
    options = ["--size", "8,6", "--encoder", "rate", "--timesteps", 3, "--seed", 2]
    code, out, err = command("distill", teacher, "--env", env, *options, *settings(), "--json")
    assert code == 0, err
    run = here / json.loads(out)["run"]
    found = json.loads((run / "config.json").read_text())
    assert (found["teacher"], found["env"]["name"], found["seed"]) == (str(teacher), env, 2)
    policy = found["policy"]
    assert policy["hidden"] == [8, 6]
    assert (policy["coding"], policy["timesteps"]) == ("regular", 3)
    code, out, err = command("run", "last", "--chip", "loihi1", "--json")
    assert code == 0, err
    assert json.loads(out)["rows"][0]["chip"] == "loihi1"


def test_it_says_what_teacher_and_student_earn_and_a_run_goes_on(here, command):
    words = ["tests.own_teachers:level", "--env", LEVELS, *settings(), "--runs", "mine"]
    code, out, err = command("distill", *words)
    assert code == 0, err
    assert "validation, 1 episodes: teacher 5, student " in out
    code, out, err = command("distill", "--resume", "last", "--runs", "mine")
    assert code == 0, err
    assert len(list((here / "mine").iterdir())) == 1


def test_a_teacher_that_is_refused_leaves_no_run_folder(here, command):
    (here / "weights.pth").write_bytes(b"")
    for teacher, line in (
        ("gone.onnx", "there is no teacher at gone.onnx"),
        ("weights.pth", "is a pickle"),
        ("gone:act", "no module gone"),
        (ROOT / "tests/golden/sb3/sac.zip", "takes a Discrete"),
    ):
        code, out, err = command("distill", teacher, "--env", "CartPole-v1")
        assert (code, out) == (2, "")
        assert line in " ".join(err.split())
    assert not list(here.glob("runs/*"))


def test_what_is_missing_is_asked_for(here, command):
    for words in (["distill"], ["distill", "a.onnx"], ["distill", "--env", REACH]):
        code, _, err = command(*words)
        assert code == 2
        assert "name a TEACHER and --env ENV" in " ".join(err.replace("│", " ").split())
    code, _, err = command("distill", "--resume", "last", "--seed", 3)
    assert code == 2
    assert "keeps its seed" in err


def test_a_budget_asks_for_the_event_driven_student():
    assert student_settings("a.zip", None, None, None, sparse=False) == (
        "distill-snn",
        ['teacher="a.zip"'],
    )
    recipe, found = student_settings("a.zip", "16", "delta", 1, sparse=True)
    assert (recipe, found) == ("distill-sparse", ['teacher="a.zip"', "policy.hidden=16"])
    recipe, found = student_settings("a", "16", None, 4, sparse=False, chip="odin")
    assert recipe == "for-chip"
    assert found[1:] == ["policy.hidden=[16]", "policy.timesteps=4", 'policy.chip="odin"']
    with pytest.raises(ConfigError, match="are not pruned"):
        student_settings("a", None, None, None, sparse=True, chip="odin")
    _, found = student_settings("a", None, "population", 2, sparse=False)
    assert found[1:] == ["policy.coding=population", "policy.timesteps=2"]


@pytest.mark.parametrize(
    ("operations", "said"),
    [([900, 84, 80], True), ([900, 130, 100], False), ([900, 84, 130], False)],
)
def test_a_budget_that_does_not_bind_is_said(operations, said, tmp_path, monkeypatch):
    run = RunFolder(tmp_path)
    monkeypatch.setattr(RunFolder, "settings", lambda self: {"budget": 120.0})
    rows = zip(operations, ("", "", 120), strict=True)
    lines = [f"{step},{count},{goal}" for step, (count, goal) in enumerate(rows)]
    run.metrics.write_text("\n".join(["updates,operations,goal", *lines]) + "\n")
    line = "the budget of 120 operations did not bind: the student had 84 before pruning"
    assert (line in summarise_returns(tmp_path)) == said


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (("64x64", None, None, False), r"--size 64x64: .* as in --size 64,64"),
        (("64,", None, None, False), r"--size 64,:"),
        ((None, "delta", None, False), "--budget sops=200"),
        (("64,64", None, None, True), "has one hidden layer, as in --size 32"),
        ((None, "population", None, True), "sends events by the delta code"),
        ((None, None, 8, True), "computes one timestep in a control step"),
    ],
)
def test_options_that_do_not_go_together_are_refused(asked, message):
    *options, sparse = asked
    with pytest.raises(ConfigError, match=message):
        student_settings("a.zip", *options, sparse)
