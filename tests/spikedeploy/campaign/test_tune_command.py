"""`spikedeploy tune` with real trainings of a toy world, in processes of their own."""

import json

import pytest

from tests.paths import ROOT

pytest.importorskip("optuna")

TINY = [
    "steps=256", "horizon=64", "env.count=2", "validation.every=128", "validation.episodes=2",
    "policy.hidden=[6]", "policy.populations=3", "policy.timesteps=3", "normaliser.finish=64",
    "critic_hidden=[8]",
]  # fmt: skip


def test_trials_are_trained_exported_and_judged_on_the_chip(command, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)  # where the processes find tests.own_env
    fixed = [word for text in TINY for word in ("--set", text)]
    code, out, err = command(
        "tune", "ppo-snn", "--env", "tests.own_env:Reach", *fixed,
        "--search", "actor_rate.start=1e-3..1e-2:log", "--objective", "return,sops",
        "--trials", 2, "--jobs", 2, "--episodes", 2, "--folder", tmp_path, "--json",
    )  # fmt: skip
    assert code == 0, err
    found = json.loads(out)
    assert [trial["state"] for trial in found["trials"]] == ["complete", "complete"]
    assert all(trial["earned"] < 0 <= trial["sops"] for trial in found["trials"])
    words = found["best"][0]["command"]
    assert words.startswith("spikedeploy train tests.own_env:Reach --recipe ppo-snn --set steps")
    assert "--set actor_rate.start=0.00" in words
    assert (tmp_path / "tune.md").is_file()
