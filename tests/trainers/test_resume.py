"""A training that was stopped or killed ends with the files of one that was not."""

import json
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.progress import Interrupt
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.runner import Runner
from spikedeploy.trainers.train import train
from tests.paths import ROOT
from tests.toy_pointing_env import PointingEnv
from tests.toy_quadrant_env import QuadrantEnv
from tests.trainers.kills import differences

SAC = [
    "steps=300", "warm_up=40", "batch=8", "policy.hidden=[8]", "critic_hidden=[8]", "buffer=70",
    "log_every=35", "checkpoint_every=60", "validation.every=80", "validation.limit=5",
    "learn_temperature=true", "env.count=3",
]  # fmt: skip
PPO = [
    "steps=600", "horizon=7", "checkpoint_every=60", "validation.every=90", "env.count=3",
    "policy.hidden=[8]",
]  # fmt: skip
CASES = {"smoke": (SAC, PointingEnv), "smoke-kart": (PPO, QuadrantEnv)}
KART = ["steps=384", "checkpoint_every=128", "horizon=32"]


class After(Interrupt):
    """A stop that is requested by the n-th time that it is asked for."""

    def __init__(self, count):
        super().__init__()
        self.left = count

    def __call__(self):
        self.left -= 1
        return self.left < 0


class Killed(BaseException):
    """What a test raises where a process would be killed."""


@pytest.fixture(params=CASES)
def case(request, monkeypatch):
    settings, env = CASES[request.param]
    monkeypatch.setattr(envs, "make", lambda name, **options: env())
    return request.param, settings


@pytest.fixture
def sac(monkeypatch):
    monkeypatch.setattr(envs, "make", lambda name, **options: PointingEnv())


def trained(recipe, settings, runs):
    return train(recipe, overrides=settings, runs=runs, quiet=True)


def resumed(run):
    return train(None, resume=run, quiet=True)


def kill(run, monkeypatch, place, count):
    """Resume or begin a run, and kill it when it calls a method for the n-th time."""
    owner, name = place
    left, method = [count], getattr(owner, name)

    def killed(*arguments, **named):
        left[0] -= 1
        if left[0] == 0:
            raise Killed
        return method(*arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, killed)
        with pytest.raises(Killed):
            run()


@pytest.fixture(params=[*CASES, "smoke-distill", "smoke-sparse-tuned"])
def any_case(request, monkeypatch, tmp_path):
    if request.param in CASES:
        settings, env = CASES[request.param]
        monkeypatch.setattr(envs, "make", lambda name, **options: env())
    elif request.param == "smoke-distill":
        settings = ["teacher=hexapod/sac", "states=24", "updates=30", "policy.hidden=[8]"]
    else:
        short = ["dense_updates=4", "level_updates=4", "polish=0", "teacher_walks=1"]
        short += ["noisy_walks=0", "budget=900", "levels=[]", "validation.every=2"]
        settings = [f"start={trained('smoke-sparse', short, tmp_path / 'start')}", "episodes=2"]
    return request.param, settings


def test_a_stopped_run_ends_with_the_same_files(any_case, tmp_path):
    recipe, settings = any_case
    whole = trained(recipe, settings, tmp_path / "whole")
    for first, *later in ((2,), (11, 1, 20)):
        runs = tmp_path / f"{first}"
        part = train(recipe, overrides=settings, runs=runs, quiet=True, interrupt=After(first))
        for count in later:
            train(None, resume=part, quiet=True, interrupt=After(count))
        resumed(part)
        assert differences(whole, part) == []


def test_episodes_go_on_where_a_kart_was(tmp_path):
    whole = trained("smoke-kart", KART, tmp_path / "whole")
    part = train("smoke-kart", overrides=KART, runs=tmp_path, quiet=True, interrupt=After(3))
    assert json.loads((part / "checkpoints" / "last.json").read_text())["env_steps"] < 384
    resumed(part)
    assert differences(whole, part) == []


@pytest.mark.parametrize("place", [(RunFolder, "save"), (RunFolder, "write_numbers")])
def test_a_kill_while_a_checkpoint_is_written_loses_nothing(place, sac, tmp_path, monkeypatch):
    whole = trained("smoke", SAC, tmp_path / "whole")
    runs = tmp_path / "part"
    train("smoke", overrides=SAC, runs=runs, quiet=True, interrupt=After(50))
    (part,) = runs.iterdir()
    for _ in range(2):
        kill(lambda: resumed(part), monkeypatch, place, 1)
    resumed(part)
    assert differences(whole, part) == []


def test_a_run_that_was_killed_early_begins_anew(case, tmp_path, monkeypatch):
    whole = trained(*case, tmp_path / "whole")
    runs, reports = tmp_path / "part", {"smoke": 19, "smoke-kart": 3}[case[0]]
    kill(lambda: trained(*case, runs), monkeypatch, (Runner, "_report"), reports)
    (part,) = runs.iterdir()
    assert (part / "metrics.csv").read_text().count("\n") > 1
    resumed(part)
    assert differences(whole, part) == []


def test_a_run_whose_last_checkpoint_is_gone_does_not_begin_anew(sac, tmp_path):
    run = RunFolder(trained("smoke", [*SAC, "checkpoint_every=20"], tmp_path))
    run.checkpoint("last").unlink()
    with pytest.raises(ConfigError, match=r"last\.safetensors is missing"):
        resumed(run.path)
    assert run.checkpoint("best").is_file()


class Restless(PointingEnv):
    """Draws what no seed decides."""

    def _draw(self):
        return np.random.default_rng().uniform(-0.8, 0.8, 2)


def test_an_environment_that_does_not_repeat_itself_is_named(tmp_path, monkeypatch, capsys):
    made = gymnasium.make("CartPole-v1").spec
    monkeypatch.setattr(Restless, "spec", made, raising=False)
    monkeypatch.setattr(envs, "make", lambda name, **options: Restless())
    run = train("smoke", overrides=SAC, runs=tmp_path, quiet=True, interrupt=After(43))
    capsys.readouterr()
    resumed(run)
    assert "CartPole-v1 did not repeat the episodes under way" in capsys.readouterr().err
    assert json.loads((run / "checkpoints" / "last.json").read_text())["finished"]


def test_episodes_begin_anew_in_an_environment_that_was_exchanged(sac, tmp_path, capsys):
    run = train("smoke", overrides=SAC, runs=tmp_path, quiet=True, interrupt=After(43))
    train(None, resume=run, overrides=["env.count=2", "steps=302"], quiet=True)
    assert json.loads((run / "checkpoints" / "last.json").read_text())["finished"]
    assert capsys.readouterr().err == ""


def test_a_training_that_is_really_killed_ends_with_the_same_files():
    done = subprocess.run(
        [sys.executable, "-m", "tests.trainers.kills", "--kills", "2", "--only", "ppo-mlp"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert [(row["kills"], row["differences"]) for row in rows] == [(2, [])]


def test_a_run_folder_has_its_versions_before_it_counts_as_one(sac, tmp_path, monkeypatch):
    kill(lambda: trained("smoke", SAC, tmp_path), monkeypatch, (RunFolder, "write_config"), 1)
    (part,) = tmp_path.iterdir()
    assert (part / "versions.json").is_file()
    assert not (part / "config.json").exists()


def test_a_run_that_lost_its_last_checkpoint_does_not_begin_anew(sac, tmp_path):
    run = trained("smoke", SAC, tmp_path)
    note = run / "checkpoints" / ".notes"
    note.write_text("keep")
    resumed(run)
    assert note.is_file()
    for path in run.glob("checkpoints/last.*"):
        path.unlink()
    (run / "checkpoints" / "best.json").touch()
    with pytest.raises(ConfigError, match="missing"):
        resumed(run)


@pytest.mark.parametrize(
    ("override", "says"),
    [("seed=7", "seed"), ("algorithm=ppo", "algorithm"), ("recipe=smoke-kart", "recipe"),
     ("critic_hidden=[4]", "those of before"), ("actor_rate.start=-1", "actor_rate")],
)  # fmt: skip
def test_what_a_resumed_run_keeps_is_refused_to_change(override, says, sac, tmp_path):
    run = trained("smoke", SAC, tmp_path)
    before = (run / "config.json").read_bytes()
    with pytest.raises(ConfigError, match=says):
        train(None, resume=run, overrides=[override], quiet=True)
    assert (run / "config.json").read_bytes() == before


def test_a_longer_training_says_that_its_learning_rate_has_ended(tmp_path, capsys):
    run = trained("smoke-kart", [*KART, "actor_rate.end=0", "actor_rate.finish=384"], tmp_path)
    train(None, resume=run, overrides=["steps=512"], quiet=True)
    assert "--set actor_rate.finish=512" in capsys.readouterr().err
    train(None, resume=run, overrides=["steps=600", "actor_rate.finish=600"], quiet=True)
    assert capsys.readouterr().err == ""
