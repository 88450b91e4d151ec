"""`train --seeds`: several trainings side by side, each as a command of its own would be."""

import json
from pathlib import Path

import pytest

from spikedeploy.campaign import training_seeds
from spikedeploy.campaign.training_seeds import SeedTraining, SeedTrainings, train_seeds
from spikedeploy.jobs.resumable import INTERRUPTED, JobEnd
from spikedeploy.trainers.train import train
from tests.paths import ROOT

QUICK = ["steps=512", "env.count=2", "validation.every=256", "validation.episodes=1"]
WORDS = ["train", "CartPole-v1", "--recipe", "ppo-mlp", *(w for q in QUICK for w in ("--set", q))]


def test_each_seed_gives_what_a_command_of_its_own_does(tmp_path, command, monkeypatch):
    monkeypatch.chdir(ROOT)  # where the processes find the package
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


@pytest.fixture
def ends(monkeypatch, tmp_path):
    """Let the processes of trainings end with these statuses, one leaving a run."""

    def arrange(*statuses, whole=True):
        def run(jobs, count, ended):
            for job, status in zip(jobs, statuses, strict=True):
                job.log.parent.mkdir(exist_ok=True)
                job.log.write_text("error: the shop was closed\n")
                if status == 0:
                    folder = tmp_path / job.name / "checkpoints"
                    folder.mkdir(parents=True)
                    (folder / "best.json").write_text('{"eval_return": 7.5}')
                    (folder / "last.json").write_text('{"finished": true, "share": 1.0}')
                    Path(job.arguments["place"]).write_text(str(folder.parent))
                ended(JobEnd(job, 1.0, status))
            return whole

        monkeypatch.setattr(training_seeds.resumable, "run", run)

    return arrange


def test_a_training_that_fails_says_why_and_the_others_count(ends, tmp_path):
    ends(1, 0)
    found = train_seeds([4, 5], 1, tmp_path / "logs", {"recipe": "x"}, lambda each: None)
    assert found.each[0].failed.startswith("the shop was closed (")
    assert found.each[1] == SeedTraining(5, str(tmp_path / "seed-5"), 7.5)
    assert found.estimate.mean == 7.5


def test_what_was_stopped_is_no_part_of_the_mean(ends, tmp_path):
    ends(INTERRUPTED, whole=False)
    found = train_seeds([4], 1, tmp_path / "logs", {"recipe": "x"}, lambda each: None)
    assert found.interrupted
    assert "before its first checkpoint" in found.each[0].line
    assert found.estimate is None
    some = [SeedTraining(0, "a", 3.0), SeedTraining(1, "b", 9.0, stopped="40 %")]
    assert SeedTrainings(some, True).estimate.mean == 3.0
    assert some[1].line == "seed 1: stopped at 40 %, best validation return 9, b"
