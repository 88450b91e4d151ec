"""A search with made-up trainings: what is tried, kept, pruned, made again and called best."""

import csv
import json
import sys
import time
from pathlib import Path

import pytest

from spikedeploy.campaign import tune
from spikedeploy.campaign.tune import journal, open_study
from spikedeploy.campaign.tune_plan import TuningPlan
from spikedeploy.campaign.tune_results import PAGE, is_study, write_page
from spikedeploy.jobs.resumable import INTERRUPTED, JobEnd
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import parse_override

optuna = pytest.importorskip("optuna")

PLAN = TuningPlan("smoke-popsan", search=("gamma=0.0..1.0",))


class Trainings:
    """Stand-ins for training, evaluation and processes: the return is gamma, SOPs are 100 gamma.

    log: settings and resumed run of each training.
    """

    def __init__(self, monkeypatch):
        self.log, self.fault, self.validations = [], None, 4
        monkeypatch.setattr(tune, "train", self.train)
        monkeypatch.setattr(tune, "evaluate", self.evaluate)
        monkeypatch.setattr(tune, "run", self.run)
        monkeypatch.setattr(tune, "write_page", lambda plan, study, folder: [])

    def train(self, recipe, *, overrides, resume, runs, interrupt, **_):
        gamma = {}
        for text in overrides:
            gamma |= parse_override(text)
        self.log.append((gamma["gamma"], resume))
        run = resume or Path(runs) / "run"
        (run / "checkpoints").mkdir(parents=True, exist_ok=True)
        (run / "config.json").write_text("{}")
        (run / "checkpoints/last.json").write_text("{}")
        if self.fault:
            self.fault(len(self.log), interrupt)
        with (run / "metrics.csv").open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["env_steps", "eval_return"])
            for number in range(1, self.validations + 1):
                table.writerow([10 * number, gamma["gamma"] * number])
                file.flush()
                if interrupt():
                    break
            self.steps = number
        (run / "gamma").write_text(str(gamma["gamma"]))
        return run

    def evaluate(self, run, plan):
        gamma = float((run / "gamma").read_text())
        return gamma, 100 * gamma

    def run(self, jobs, count, ended):
        for job in jobs:
            job.log.parent.mkdir(parents=True, exist_ok=True)
            start, status = time.monotonic(), 0
            try:
                done = tune.run_trial(**json.loads(json.dumps(job.arguments)))
                status = INTERRUPTED if done is False else 0
            except Exception as error:
                job.log.write_text(f"error: {error}\n")
                status = 1
            ended(JobEnd(job, time.monotonic() - start, status))
            if status == INTERRUPTED:
                return False
        return True


@pytest.fixture
def trainings(monkeypatch):
    return Trainings(monkeypatch)


@pytest.fixture
def page(trainings, monkeypatch):
    """Write pages, which takes as long as everything else."""
    monkeypatch.setattr(tune, "write_page", write_page)


def states(found):
    return [each.state for each in found.trials]


def test_the_best_of_as_many_trials_as_asked_is_found_and_a_search_goes_on(trainings, tmp_path):
    found = tune.tune(PLAN, tmp_path, 3)
    assert states(found) == ["complete"] * 3
    assert found.best[0].earned == max(gamma for gamma, _ in trainings.log)
    again = tune.tune(PLAN, tmp_path, 5)
    assert again.trials[:3] == found.trials
    assert len(trainings.log) == len(again.trials) == 5
    assert len({gamma for gamma, _ in trainings.log}) == 5  # each process draws anew
    assert tune.tune(PLAN, tmp_path, 5).trials == again.trials
    assert len(trainings.log) == 5


def test_the_page_has_the_command_the_pictures_and_every_trial(page, tmp_path):
    found = tune.tune(PLAN, tmp_path, 5)
    study = open_study(PLAN, journal(tmp_path))
    study.set_user_attr("reason 5", "out | over")
    study.tell(study.ask(), state=optuna.trial.TrialState.FAIL)
    assert "out \\| over" in write_page(PLAN, study, tmp_path)[0].read_text()
    names = ["tune.md", "history.png", "importances.png", "tune.html"]
    assert [path.name for path in found.files] == names
    text = found.files[0].read_text()
    assert PLAN.command(found.best[0].settings) in text
    assert all(path.name in text for path in found.files[1:-1])
    text = found.files[0].read_text()
    assert sum(line.startswith("| ") and "complete" in line for line in text.splitlines()) == 5


def test_a_failed_trial_is_kept_with_its_reason_and_the_search_goes_on(trainings, tmp_path):
    def second_fails(number, interrupt):
        if number == 2:
            raise ConfigError("the robot is out")

    trainings.fault = second_fails
    found = tune.tune(PLAN, tmp_path, 3)
    assert states(found) == ["complete", "failed", "complete"]
    assert found.trials[1].reason == "the robot is out"


def test_where_the_first_three_trials_fail_the_others_are_not_tried(trainings, tmp_path):
    def fails(number, interrupt):
        raise ConfigError("no such teacher")

    trainings.fault = fails
    with pytest.raises(ConfigError, match="the first 3 trials failed: error: no such teacher"):
        tune.tune(PLAN, tmp_path, 9)
    assert len(trainings.log) == 3


def test_a_training_far_below_the_others_is_pruned(trainings, tmp_path):
    tune.tune(PLAN, tmp_path, 6)
    study = open_study(PLAN, journal(tmp_path))
    study.enqueue_trial({"gamma": 1e-3})
    found = tune.tune(PLAN, tmp_path, 7)
    assert found.trials[-1].state == "pruned"
    assert found.trials[-1].earned is None
    assert trainings.steps == 1  # at its first validation


def test_an_interrupted_trial_is_made_again_with_its_settings_and_its_run(trainings, tmp_path):
    def ctrl_c(number, interrupt):
        if number == 2:
            raise KeyboardInterrupt

    trainings.fault = ctrl_c
    stopped = tune.tune(PLAN, tmp_path, 3)
    assert stopped.interrupted
    assert states(stopped) == ["complete", "interrupted"]
    found = tune.tune(PLAN, tmp_path, 3)
    assert sorted(states(found)) == ["complete"] * 3 + ["interrupted"]
    assert trainings.log[2][0] == trainings.log[1][0]
    assert trainings.log[2][1] == tmp_path / "trial-1/run"


def test_a_trial_whose_driver_was_killed_is_made_again(trainings, tmp_path):
    def killed(number, interrupt):
        raise SystemExit  # nothing is told to the study

    trainings.fault = killed
    with pytest.raises(SystemExit):
        tune.tune(PLAN, tmp_path, 1)
    trainings.fault = None
    found = tune.tune(PLAN, tmp_path, 1)
    assert states(found) == ["interrupted", "complete"]
    assert trainings.log[0][0] == trainings.log[1][0]


def test_a_trial_whose_process_dies_has_its_last_words_as_reason(trainings, tmp_path, monkeypatch):
    def dies(jobs, count, ended):
        study = open_study(PLAN, journal(tmp_path))
        study.ask().set_user_attr(tune._JOB, jobs[0].name)
        jobs[0].log.parent.mkdir()
        jobs[0].log.write_text("Out of memory\n")
        ended(JobEnd(jobs[0], 1.0, -9))
        return True

    monkeypatch.setattr(tune, "run", dies)
    found = tune.tune(PLAN, tmp_path, 1)
    assert found.trials[0].reason == "its process ended with status -9: Out of memory"


def test_within_a_budget_of_sops_the_best_is_within_it(trainings, tmp_path):
    plan = TuningPlan(
        "smoke-popsan", objective="return-at-sops", sops=50.0, search=("gamma=0.0..1.0",)
    )
    found = tune.tune(plan, tmp_path, 6)
    within = [gamma for gamma, _ in trainings.log if 100 * gamma <= 50]
    assert 0 < len(within) < 6
    assert [each.earned for each in found.best] == [max(within)]
    study = open_study(plan, journal(tmp_path))
    assert study.best_value == max(within)  # the sampler knows the budget too


def test_of_two_objectives_the_pareto_front_is_found_and_drawn(trainings, tmp_path, monkeypatch):
    plan = TuningPlan("smoke-popsan", objective="return,sops", search=("gamma=0.0..1.0",))
    # the last digits decide how much is earned for the operations
    monkeypatch.setattr(tune, "evaluate", lambda run, plan: (
        round(100 * float((run / "gamma").read_text()) % 7, 1), float((run / "gamma").read_text())
    ))  # fmt: skip
    found = tune.tune(plan, tmp_path, 6)
    points = [(each.earned, each.sops) for each in found.trials]
    front = [(each.earned, each.sops) for each in found.best]
    assert front == sorted(front)
    for earned, sops in points:
        beaten = any(e >= earned and s <= sops and (e, s) != (earned, sops) for e, s in points)
        assert ((earned, sops) in front) != beaten
    pictures = write_page(plan, open_study(plan, journal(tmp_path)), tmp_path)[1:-1]
    assert [path.stem for path in pictures] == ["history", "importances", "front"]


def test_a_folder_with_another_question_is_refused(trainings, tmp_path):
    tune.tune(PLAN, tmp_path, 1)
    other = TuningPlan("smoke-popsan", search=("gamma=0.5..1.0",))
    with pytest.raises(ConfigError, match=r"gamma=0.5..1.0.*--folder"):
        tune.tune(other, tmp_path, 2)


def test_a_database_serves_two_folders_as_one_search(trainings, tmp_path):
    url = f"sqlite:///{tmp_path}/study.db"
    tune.tune(PLAN, tmp_path / "one", 2, storage=url)
    found = tune.tune(PLAN, tmp_path / "two", 4, storage=url)
    assert states(found) == ["complete"] * 4
    assert {Path(each.run).parent.name for each in found.trials} == {"one", "two"}


def test_without_optuna_the_remedy_is_said(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(ConfigError, match=r"pip install .*\[tune\]"):
        tune.tune(PLAN, tmp_path, 1)


def test_notes_and_journals_of_somebody_else_are_no_search(tmp_path):
    for name, text, is_ours in (
        (PAGE, "my notes", False),
        ("journal.log", "my log", False),
        ("journal.log", '{"op_code": 0, "worker_id": "x"}\n', True),
    ):
        (tmp_path / name).write_text(text)
        assert is_study(tmp_path) is is_ours


def test_a_database_that_is_none_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(ConfigError, match="no database can be opened there"):
        tune.tune(PLAN, tmp_path, 1, storage="nosuch://host/name")
