"""`distill`: from anybody's teacher to a spiking student that runs on a chip."""

import json

import pytest

from spikedeploy.commands.distillation import (
    STUDENT,
    Level,
    describe,
    front,
)
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.training_settings import student
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
    words = ["tests.own_teachers:level", "--env", LEVELS, "--dense", *settings(), "--runs", "mine"]
    code, out, err = command("distill", *words)
    assert code == 0, err
    assert "validation, 1 episodes: teacher 5, student " in out
    code, out, err = command("distill", "--resume", "last", "--runs", "mine")
    assert code == 0, err
    assert len(list((here / "mine").iterdir())) == 1


PRUNED = [
    "teacher_walks=3", "noisy_walks=2", "walks=2", "dense_updates=60", "dense_rounds=2",
    "patience=1", "level_updates=20", "polish=1", "polish_updates=20", "shrink=0.1", "batch=8",
    "prune_every=5", "window=8", "burn_in=2", "validation.every=10", "validation.episodes=2",
]  # fmt: skip


def pruned(*changes):
    return [word for change in (*PRUNED, *changes) for word in ("--set", change)]


def test_a_student_is_pruned_by_default_and_a_float_rival_beside_it(here, command):
    words = ["tests.own_teachers:reach", "--env", REACH, *pruned(), "--size", 6]
    code, out, err = command("distill", *words)
    assert code == 0, err
    (student,) = here.glob("runs/*")
    (rival,) = student.glob("rival/*")
    assert "float MLP" in err
    assert f"trained: {student.relative_to(here)}\nvalidation, 2 episodes: teacher" in out
    assert "SOPs of teacher kept" in " ".join(out.split())
    assert "MACs of teacher kept" in " ".join(out.split())
    line = f"compare {REACH} {student.relative_to(here)} {rival.relative_to(here)} --teacher tests."
    assert line in out
    found = json.loads((rival / "config.json").read_text())
    assert found["pool"] == str(student.relative_to(here))
    assert (found["policy"]["kind"], found["search"]) == ("pruned-mlp", True)
    assert found["dense_updates"] == 60
    # going on finds both as they are
    code, out, err = command("distill", "--resume", student, "--json")
    assert code == 0, err
    again = json.loads(out)
    assert (again["run"], again["rival"]) == (str(student), str(rival))
    assert [each["chosen"] for each in again["front"]["spiking student"]].count(True) == 1
    assert len(list(here.glob("runs/*"))) == len(list(here.glob("runs/*/rival/*"))) == 1


def test_the_rival_can_be_left_out_and_a_budget_named(here, command):
    words = ["tests.own_teachers:reach", "--env", REACH, *pruned(), "--size", 6, "--no-rival"]
    code, out, err = command("distill", *words, "--budget", "sops=5", "--json")
    assert code == 0, err
    record = json.loads(out)
    assert record["rival"] is None
    assert list(record["front"]) == ["spiking student"]
    levels = front(here / record["run"])
    assert levels[-1].operations <= 5.5
    assert levels[-1].chosen


def test_a_student_that_learned_too_little_is_told_what_helps(here, command, monkeypatch):
    words = ["tests.own_teachers:reach", "--env", REACH, *pruned("learning_rate=1e-9")]
    code, out, err = command("distill", *words, "--size", 2, "--no-rival")
    assert code == 0, err
    assert "it keeps only " in out
    helps = "--set walks=4 --set dense_updates=120, or --set step=0.125 --set policy.most=10"
    assert helps in out


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
    code, _, err = command("distill", "--resume", "last", "--timesteps", 2, "--dense")
    assert code == 2
    said = " ".join(err.replace("│", " ").split())
    assert "keeps its network: leave --timesteps, --dense out" in said


def test_a_budget_asks_for_the_event_driven_student():
    assert student("a.zip", dense=True) == ("distill-snn", ['teacher="a.zip"'])
    recipe, found = student("a.zip", size="16", encoder="delta", timesteps=1)
    assert recipe == "distill-sparse"
    assert found == ['teacher="a.zip"', "policy.hidden=16", "policy.timesteps=1"]
    recipe, found = student("a", chip="odin", size="16", timesteps=4)
    assert recipe == "for-chip"
    assert found[1:] == ['policy.chip="odin"', "policy.hidden=[16]", "policy.timesteps=4"]
    assert student("a", budget="sops=20")[0] == "distill-sparse"
    for dense, chip in ((True, None), (False, "odin")):
        with pytest.raises(ConfigError, match="such students are not pruned"):
            student("a", chip=chip, dense=dense, budget="sops=20")
    _, found = student("a", encoder="population", timesteps=2)
    assert found[1:] == ['policy.coding="population"', "policy.timesteps=2"]


def test_a_network_of_the_user_is_a_student_as_it_is():
    recipe, found = student("a", "mine:Net", "odin", encoder="rate", timesteps=4)
    assert recipe == "distill-network"
    assert found == [
        'teacher="a"', 'policy.network="mine:Net"', 'policy.chip="odin"',
        'policy.coding="regular"', "policy.timesteps=4",
    ]  # fmt: skip
    for refused in ({"size": "16"}, {"budget": "sops=20"}, {"dense": True}):
        with pytest.raises(ConfigError, match="a network of yours is trained as it is"):
            student("a", "mine:Net", **refused)


@pytest.mark.parametrize(("before", "said"), [(84.0, True), (130.0, False)])
def test_a_budget_that_does_not_bind_is_said(before, said, tmp_path, monkeypatch):
    config = {"budget": 120.0, "search": True, "validation": {"episodes": 3}}
    ended = [{"goal": None, "operations": before, "share": 1.0}]
    numbers = {"teacher_return": 9.0, "random_return": 1.0, "ended": ended}
    best = {"eval_return": 9.0, "eval_share": 1.0, "eval_operations": 80.0, "updates": 3}
    monkeypatch.setattr(RunFolder, "settings", lambda self: config)
    monkeypatch.setattr(RunFolder, "load", lambda self, name: (numbers | best, {}))
    monkeypatch.setattr("pathlib.Path.is_file", lambda self: True)
    line = "did not bind: by training's estimate the student had 84 before pruning"
    assert (line in describe(tmp_path, {STUDENT: [Level(80.0, 1.0, True)]})) == said


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"size": "64x64", "dense": True}, r"--size 64x64: .* as in --size 64,64"),
        ({"size": "64,", "dense": True}, r"--size 64,:"),
        ({"encoder": "delta", "dense": True}, "leave --dense, --for and --network out"),
        ({"size": "64,64"}, "a sparse student has one hidden layer"),
        ({"encoder": "rate", "budget": "sops=20"}, "leave one of the two out"),
    ],
)
def test_options_that_do_not_go_together_are_refused(asked, message):
    with pytest.raises(ConfigError, match=message):
        student("a.zip", **asked)
