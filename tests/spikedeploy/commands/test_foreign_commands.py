"""Somebody else's environment on the command line, from training to a chip."""

import json

import pytest

ENV = "tests.own_env:Reach"
SMALL = [
    "steps=128", "env.count=2", "horizon=16", "epochs=1", "minibatch=16", "critic_hidden=[8]",
    "policy.hidden=[8,8]", "policy.timesteps=2", "policy.populations=2", "validation.every=64",
    "validation.episodes=1",
]  # fmt: skip


def settings(*changes):
    return [word for change in (*SMALL, *changes) for word in ("--set", change)]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_from_an_unregistered_environment_to_a_chip(here, command):
    code, out, err = command("train", ENV, "--recipe", "ppo-snn", *settings(), "--json")
    assert code == 0, err
    run = here / json.loads(out)["run"]
    assert run.name.startswith("ppo-snn-tests.own-env-Reach-s0-")
    assert json.loads((run / "config.json").read_text())["actor_rate"]["finish"] == 128

    asked = ["--metric", "error:max", "--metric", "error:mean", "--success", "close"]
    words = ["compare", ENV, "last", "--episodes", 2, "--workers", 1, *asked, "-o", "report"]
    words += ["--tables", "all"]
    code, out, err = command(*words)
    assert code == 0, err
    assert f"exported runs/{run.name}/{run.name}.nir" in err.replace("\n", "")
    assert "What does it earn?" in out
    assert "walk" not in out
    rows = json.loads((here / "report/report.json").read_text())["rows"]
    assert [row["chip"] for row in rows] == ["float", "loihi1", None]
    assert [row["policy"] for row in rows] == [run.name, run.name, "random"]
    for row in rows:
        assert 0.0 <= row["measured"]["error:mean"] <= row["measured"]["error:max"]
        assert row["success_rate"] in (0.0, 0.5, 1.0)
        assert row["return_mean"] < 0
        assert row["foreign"] is True
    assert rows[1]["sops_per_inference"] > 0
    assert rows[1]["ratio_to_reference"] is None  # shares of a loss say nothing
    assert rows[1]["static_energy_j"]  # of a control step of 25 ms

    code, out, _ = command("run", "last", "--json")
    row = json.loads(out)["rows"][0]
    assert (code, row["chip"], row["success_rate"]) == (0, "loihi1", None)

    assert command("drift", "last", "--steps", 5, "--json")[0] == 0
    assert command("check", run.name, "--chip", "loihi1", "--json")[0] == 0
    code, _, err = command("drift", run / f"{run.name}.nir")
    assert code == 2
    assert "is not run because a file names it" in err
    code, _, err = command("run", run / f"{run.name}.nir")
    assert code != 0
    assert f"name it yourself, with --env {ENV}" in err.replace("\n", " ").replace("  ", " ")
    code, _, err = command("reproduce", "report")
    assert code != 0
    assert f"--env {ENV}" in err.replace("\n", " ")
    code, out, err = command("reproduce", "report", "--env", ENV, "--workers", 1)
    assert code == 0, out + err


def test_a_float_run_is_its_onnx_file_and_an_unknown_success_has_no_column(here, command):
    words = ["train", "CartPole-v1", "--recipe", "ppo-mlp"]
    small = [word for word in SMALL if not word.startswith(("policy.t", "policy.p"))]
    changes = [part for change in small for part in ("--set", change)]
    assert command(*words, *changes, "--json")[0] == 0
    code, out, err = command("compare", "CartPole-v1", "last", "--episodes", 2, "--workers", 1)
    assert code == 0, err
    assert "of ANN" in out
    assert "MACs" in out
    code, out, _ = command("run", "random", "--env", "Pendulum-v1")
    assert code == 0
    assert "success" not in out
    assert "return" in out
