"""Drivers on tracks that they were not trained on, and a first look at the whole experiment."""

import json
from importlib import import_module

import pytest

from lab.experiments.evaluation import BuiltInEvaluation
from lab.experiments.kart import heldout
from lab.experiments.kart.design import ExperimentDesign, asked
from lab.experiments.kart.experiment import experiment
from lab.experiments.kart.heldout import UNSEEN, TrackEvaluation, perform
from spikedeploy.jobs import resumable
from spikedeploy.jobs.resumable import JobEnd
from spikedeploy.runtime.errors import ConfigError


@pytest.fixture
def short(monkeypatch):
    """Two tracks, one of them with starts of its own."""
    monkeypatch.setattr(heldout, "TRACKS", ("big_S", "small_S"))


def test_the_gap_follower_finishes_where_it_was_tuned_and_not_everywhere(tmp_path, short):
    script = BuiltInEvaluation("kart-gazebo", "gap", str(tmp_path), 3)
    asked = TrackEvaluation(script, 2)
    assert not asked.done
    assert perform(**json.loads(json.dumps(asked.arguments())))
    assert asked.finished == {"big_S": [1, 1], "small_S": [0, 0]}
    assert not TrackEvaluation(script, 3).done


def test_unseen_tracks_are_those_that_no_recipe_is_trained_on():
    from spikedeploy.trainers.recipes import KART_ENVS, RECIPES

    trained = {
        recipe.settings["env"].get("options", {}).get("track", "big_S")
        for recipe in RECIPES.values()
        if recipe.algorithm == "ppo" and recipe.settings["env"]["name"] in KART_ENVS
    }
    assert trained == {"big_S", "corridor-8"}
    assert not trained & set(UNSEEN)


def test_corridor_policies_observe_nothing_of_a_track():
    from spikedeploy import envs

    design = ExperimentDesign()
    trial = next(t for t in design.trials() if t.recipe == "kart-steer-corridor-snn")
    env = envs.make("kart-steer", **trial.config.env.options)
    assert set(env.unwrapped.OBSERVATION) == {"lidar", "velocity"}


def test_a_first_look_trains_evaluates_and_writes_the_page(tmp_path, monkeypatch, short):
    def run(jobs, count, ended, update=None):
        for job in jobs:
            module, _, function = job.call.partition(":")
            call = getattr(import_module(module), function)
            done = call(**json.loads(json.dumps(job.arguments)))
            ended(JobEnd(job, 1.0, 0 if done else 1))
        return True

    monkeypatch.setattr(resumable, "run", run)
    design = asked({"quick": True, "runs": str(tmp_path / "runs")})
    only = ["kart-gazebo-corridor-snn", "kart-gazebo-small", "kart-gazebo-classic-ann"]
    outcome = experiment(design, [*only, "kart-gazebo-gap"], 1, tmp_path)
    assert outcome.failed == {}
    assert outcome.done == 3 + 2 + 2  # trainings, their tracks, and the script's two
    page = outcome.files[0].read_text()
    assert "| kart-gazebo | corridor-8 | snn · loihi1 | 1 |" in page
    assert "| kart-gazebo | – | gap | – |" in page


def test_options_of_other_experiments_are_refused():
    with pytest.raises(ConfigError, match="the experiment kart has no levels"):
        asked({"levels": 3})
    quick = asked({"quick": True})
    assert (quick.folder, quick.seeds) == ("runs/kart-quick", 1)
