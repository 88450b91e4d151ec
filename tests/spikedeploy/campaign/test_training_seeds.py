"""`train --seeds`: several trainings side by side, each as a command of its own would be."""

import json
from pathlib import Path

import pytest

from spikedeploy.campaign import training_seeds as campaign
from spikedeploy.campaign.training_seeds import SeedTraining, estimate, train_seeds
from spikedeploy.jobs import Serial
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.train import train

QUICK = ["steps=256", "env.count=2", "validation.every=256", "validation.episodes=1"]
WORDS = ["train", "CartPole-v1", "--recipe", "ppo-mlp", *(w for q in QUICK for w in ("--set", q))]


def test_each_seed_gives_what_a_command_of_its_own_does(tmp_path, command, monkeypatch):
    monkeypatch.setattr(campaign, "Pool", lambda count: Serial())
    code, out, err = command(*WORDS, "--seeds", "0,3", "--runs", tmp_path, "--json")
    assert code == 0, err
    found = json.loads(out)
    assert [each["seed"] for each in found["seeds"]] == [0, 3]
    low, high = sorted(each["best"] for each in found["seeds"])
    assert low <= found["best"]["ci95"][0] <= found["best"]["mean"] <= high
    assert all(f"seed {seed}: best validation return" in err for seed in (0, 3))
    alone = train(
        "ppo-mlp", env="CartPole-v1", overrides=QUICK, seed=3, runs=tmp_path / "alone", quiet=True
    )
    run = Path(found["seeds"][1]["run"])
    assert run.parent == tmp_path
    for name in ("checkpoints/last.safetensors", "checkpoints/best.safetensors", "config.json"):
        assert (run / name).read_bytes() == (alone / name).read_bytes()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--seeds", "0", "--seed", "1"], "goes without --seed"),
        (["--seeds", "0", "--resume", "last"], "goes without --seed"),
        (["--jobs", "2"], "--jobs goes with --seeds"),
        (["--seeds", "4999-5000"], "5000 is no seed of a training"),
        (["--seeds", "all"], "write numbers and ranges"),
    ],
)
def test_options_that_do_not_go_together_are_refused(words, said, command):
    code, _, err = command(*WORDS, *words)
    assert code == 2
    assert said in " ".join(err.replace("│", " ").split())


def test_a_training_that_fails_says_why_and_the_others_count(tmp_path):
    def run(logs, arguments, seed):
        if seed == 4:
            raise ConfigError("the shop was closed")
        if seed == 6:
            raise KeyboardInterrupt
        return SeedTraining(seed, "runs/a", 7.5)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "train_seed", run)
        patch.setattr(campaign, "Pool", lambda count: Serial())
        found, interrupted = train_seeds(
            [4, 5, 6], 1, tmp_path / "logs", {"recipe": "x"}, lambda each: None
        )
    assert found[0].line.startswith("seed 4: failed: the shop was closed (")
    assert found[1:] == [SeedTraining(5, "runs/a", 7.5)]
    assert (interrupted, estimate(found).mean) == (True, 7.5)


def test_what_was_stopped_is_no_part_of_the_mean():
    some = [SeedTraining(0, "a", 3.0), SeedTraining(1, "b", 9.0, stopped="40 %")]
    assert estimate(some).mean == 3.0
    assert estimate(some[1:]) is None
    assert some[1].line == "seed 1: stopped at 40 %, best validation return 9, b"
