"""A search: what is tried, kept, pruned, made again and called best."""

import csv
import json
import sys
from html import unescape
from pathlib import Path

import pytest

from spikedeploy.campaign import tune
from spikedeploy.campaign.tune import TuningPlan, best, describe
from spikedeploy.campaign.tune_page import is_study, study_page
from spikedeploy.jobs import Serial
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import parse_override

optuna = pytest.importorskip("optuna")

PLAN = TuningPlan("smoke-popsan", search=("gamma=0.0..1.0",))
FRONT = TuningPlan("smoke-popsan", objective="return,sops", search=("gamma=0.0..1.0",))


class Trainings:
    """Stand-ins for training, evaluation and processes: the return is gamma, SOPs are 100 gamma.

    log: gamma and resumed run of each training
    """

    def __init__(self, monkeypatch):
        self.log, self.fault = [], None
        monkeypatch.setattr(tune, "train", self.train)
        monkeypatch.setattr(tune, "evaluate", self.evaluate)
        monkeypatch.setattr(tune, "Pool", lambda count: Serial())

    def train(self, recipe, *, overrides, resume, runs, interrupt, watch, **_):
        gamma = {}
        for text in overrides:
            gamma |= parse_override(text)
        self.log.append((gamma["gamma"], resume))
        run = resume or Path(runs) / "run"
        run.mkdir(parents=True, exist_ok=True)
        (run / "config.json").write_text("{}")
        if self.fault:
            self.fault(len(self.log))
        with (run / "metrics.csv").open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["env_steps", "eval_return"])
            for number in range(1, 5):
                table.writerow([10 * number, gamma["gamma"] * number])
                file.flush()
                watch(run)
                if interrupt():
                    break
        self.steps = number
        (run / "gamma").write_text(str(gamma["gamma"]))
        return run

    def evaluate(self, run, plan):
        gamma = float((run / "gamma").read_text())
        return gamma, 100 * gamma


@pytest.fixture
def trainings(monkeypatch):
    return Trainings(monkeypatch)


def states(study):
    return [describe(trial)["state"] for trial in study.trials]


def fails_at(number, error):
    def fault(count):
        if number in (count, None):
            raise error

    return fault


def test_the_best_of_as_many_trials_as_asked_is_found_and_a_search_goes_on(trainings, tmp_path):
    study, finished = tune.tune(PLAN, tmp_path, 3)
    assert finished
    assert states(study) == ["complete"] * 3
    assert best(PLAN, study)[0].value == max(gamma for gamma, _ in trainings.log)
    first = study.trials
    again, _ = tune.tune(PLAN, tmp_path, 5)
    assert again.trials[:3] == first
    assert len({gamma for gamma, _ in trainings.log}) == len(again.trials) == 5
    assert tune.tune(PLAN, tmp_path, 5)[0].trials == again.trials
    assert len(trainings.log) == 5


def test_the_page_has_the_command_the_pictures_and_every_trial(trainings, tmp_path):
    trainings.fault = fails_at(2, ConfigError("out | over"))
    study, _ = tune.tune(PLAN, tmp_path, 6)
    page = unescape(study_page(PLAN, study))
    assert PLAN.command(best(PLAN, study)[0].params) in page
    assert "out | over" in page
    assert page.count("<svg") == 2
    assert page.count(">complete<") == 5


def test_a_failed_trial_is_kept_with_its_reason_and_the_search_goes_on(trainings, tmp_path):
    trainings.fault, said = fails_at(2, ConfigError("the robot is out")), []
    study, _ = tune.tune(PLAN, tmp_path, 3, say=said.append)
    assert states(study) == ["complete", "failed", "complete"]
    assert describe(study.trials[1])["reason"] == "the robot is out"
    assert said[1] == "trial 1 failed, reason the robot is out"


def test_where_the_first_three_trials_fail_the_others_are_not_tried(trainings, tmp_path):
    trainings.fault = fails_at(None, ConfigError("no such teacher"))
    with pytest.raises(ConfigError, match="the first 3 trials failed: no such teacher"):
        tune.tune(PLAN, tmp_path, 9)
    assert len(trainings.log) == 3


def test_a_training_far_below_the_others_is_pruned(trainings, tmp_path):
    study, _ = tune.tune(PLAN, tmp_path, 6)
    study.enqueue_trial({"gamma": 1e-3})
    trial = tune.TrialJob(PLAN, tmp_path, study.ask(PLAN.space).number)
    assert tune.run_trial(trial) == optuna.trial.TrialState.PRUNED
    assert trainings.steps == 1  # at its first validation
    study, _ = tune.tune(PLAN, tmp_path, 7)
    assert describe(study.trials[6]) | {"seconds": 0} == {
        "number": 6, "state": "pruned", "settings": {"gamma": 1e-3}, "return": None, "sops": None,
        "seconds": 0, "reason": "",
    }  # fmt: skip


def test_an_interrupted_trial_goes_on_with_its_settings_and_its_run(trainings, tmp_path):
    trainings.fault = fails_at(2, KeyboardInterrupt)
    stopped, finished = tune.tune(PLAN, tmp_path, 3)
    assert not finished
    assert states(stopped) == ["complete", "interrupted"]
    study, finished = tune.tune(PLAN, tmp_path, 3)
    assert finished
    assert states(study) == ["complete"] * 3
    assert trainings.log[2] == (trainings.log[1][0], tmp_path / "trial-1/run")


def test_of_two_objectives_the_pareto_front_is_found(trainings, tmp_path, monkeypatch):
    # the last digits decide how much is earned for the operations
    monkeypatch.setattr(tune, "evaluate", lambda run, plan: (
        round(100 * float((run / "gamma").read_text()) % 7, 1), float((run / "gamma").read_text())
    ))  # fmt: skip
    study, _ = tune.tune(FRONT, tmp_path, 6)
    points = [tuple(trial.values) for trial in study.trials]
    front = [tuple(trial.values) for trial in best(FRONT, study)]
    assert front == sorted(front)
    for earned, sops in points:
        beaten = any(e >= earned and s <= sops and (e, s) != (earned, sops) for e, s in points)
        assert ((earned, sops) in front) != beaten


def test_folders_of_other_searches_are_refused(trainings, tmp_path):
    tune.tune(PLAN, tmp_path, 1)
    other = TuningPlan("smoke-popsan", search=("gamma=0.5..1.0",))
    with pytest.raises(ConfigError, match=r"gamma=0.5..1.0.*--folder"):
        tune.tune(other, tmp_path, 2)
    (tmp_path / "journal.log").unlink()
    with pytest.raises(ConfigError, match="trial-0 is of another search"):
        tune.tune(PLAN, tmp_path, 1)
    (tmp_path / "journal.log").write_text("torn {\n")
    with pytest.raises(ConfigError, match="damaged"):
        tune.tune(PLAN, tmp_path, 1)


@pytest.mark.parametrize("name", ["report.json", "journal.log"])
def test_notes_and_journals_of_somebody_else_are_no_search(name, tmp_path):
    (tmp_path / name).write_text("my notes")
    assert not is_study(tmp_path)


def test_without_optuna_the_remedy_is_said(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(ConfigError, match=r"pip install .*\[tune\]"):
        tune.tune(PLAN, tmp_path, 1)


TINY = [
    "steps=64", "horizon=32", "env.count=2", "validation.every=64", "validation.episodes=1",
    "policy.hidden=[6]", "policy.populations=3", "policy.timesteps=3", "normaliser.finish=32",
    "critic_hidden=[8]",
]  # fmt: skip


def test_trials_are_trained_exported_and_judged_on_the_chip(command, tmp_path, monkeypatch):
    monkeypatch.setattr(tune, "Pool", lambda count: Serial())
    fixed = [word for text in TINY for word in ("--set", text)]
    code, out, err = command(
        "tune", "ppo-snn", "--env", "tests.own_env:Reach", *fixed,
        "--search", "actor_rate.start=1e-3..1e-2:log", "--objective", "return,sops",
        "--trials", 1, "--episodes", 1, "--folder", tmp_path, "--json",
    )  # fmt: skip
    assert code == 0, err
    found = json.loads(out)
    assert [trial["state"] for trial in found["trials"]] == ["complete"]
    assert all(trial["return"] < 0 <= trial["sops"] for trial in found["trials"])
    words = found["best"][0]["command"]
    assert words.startswith("spikedeploy train tests.own_env:Reach --recipe ppo-snn --set steps")
    assert "--set actor_rate.start=0.00" in words
    assert "return,sops" in (tmp_path / "report.json").read_text()
    assert is_study(tmp_path)
