"""A trial does what is missing, and nothing twice."""

import json

import numpy as np
import pytest

from lab.experiments import evaluation, trial
from lab.experiments.finishes import (
    finished_by,
    finishes,
    progress_of,
    steps_to,
    steps_to_greedy,
)
from lab.experiments.trial import Trial, perform
from spikedeploy.policies.registry import find
from spikedeploy.trainers.metrics import read
from tests import toy_race_env

QUICK = ("steps=1024", "policy.timesteps=8")


@pytest.fixture(autouse=True)
def _race(monkeypatch):
    toy_race_env.install(monkeypatch, "kart-grid")


def make(folder, **changes):
    plain = {
        "recipe": "smoke-kart", "seed": 1, "folder": str(folder), "overrides": QUICK,
        "episodes": 3, "chip": "loihi1",
    }  # fmt: skip
    return Trial(**{**plain, **changes})


def count(monkeypatch, name):
    """Count the calls of a function of the trial's module."""
    calls, function = [], getattr(trial, name)
    monkeypatch.setattr(trial, name, lambda *given: calls.append(1) or function(*given))
    return calls


def test_a_trial_is_trained_exported_and_evaluated(tmp_path):
    one = make(tmp_path)
    assert (one.run, one.trained, one.done) == (None, False, False)
    assert perform(**one.arguments())
    assert one.run.name.startswith("smoke-kart-s1-")
    assert one.counters["env_steps"] == 1024
    assert [row["chip"] for row in one.evaluation["rows"]] == ["float", "loihi1"]
    assert all(row["episodes"] == 3 for row in one.evaluation["rows"])
    # 2-8-8-4 with biases
    assert one.evaluation["parameters"] == 2 * 8 + 8 + 8 * 8 + 8 + 8 * 4 + 4
    assert find(str(one.run / "policy.nir")).kind == "snn"


def test_what_is_done_is_not_done_again(monkeypatch, tmp_path):
    one = make(tmp_path)
    perform(**one.arguments())
    trained, evaluated = count(monkeypatch, "_train"), count(monkeypatch, "_evaluate")
    assert perform(**one.arguments())
    assert (trained, evaluated) == ([], [])
    more = make(tmp_path, episodes=4)
    assert not more.done
    perform(**more.arguments())
    assert (trained, evaluated) == ([], [1])
    assert more.evaluation["rows"][0]["episodes"] == 4


def test_a_longer_budget_goes_on_with_the_same_run(tmp_path):
    one, longer = make(tmp_path), make(tmp_path, overrides=(*QUICK[1:], "steps=1280"))
    perform(**one.arguments())
    assert not longer.trained
    perform(**longer.arguments())
    assert longer.run == one.run
    assert longer.counters["env_steps"] == 1280
    assert longer.done


def test_an_interrupted_training_goes_on_where_it_stopped(monkeypatch, tmp_path):
    from spikedeploy.trainers.train import Interrupt

    asked = iter([False, False, False, True])
    monkeypatch.setattr(Interrupt, "__call__", lambda self: next(asked, False))
    one = make(tmp_path)
    assert not perform(**one.arguments())
    steps, run = one.counters["env_steps"], one.run
    assert 0 < steps < 1024
    assert perform(**one.arguments())
    assert one.run == run
    ends = [row["env_steps"] for row in read(run / "episodes.csv")]
    assert ends == sorted(ends)


def test_a_training_killed_before_its_first_checkpoint_begins_anew(tmp_path):
    one = make(tmp_path)
    perform(**one.arguments())
    for file in (*(one.run / "checkpoints").iterdir(), *one.run.glob("policy.*")):
        file.unlink()
    (one.run / "evaluation.json").unlink()
    rows = len(read(one.run / "episodes.csv"))
    assert perform(**one.arguments())
    assert len(read(one.run / "episodes.csv")) == rows
    assert len(list(tmp_path.glob("smoke-kart-s1-*"))) == 1


def test_enough_finishes_end_a_training(tmp_path):
    one = make(tmp_path, overrides=(*QUICK, "env.options.luck=6", "stop_at_finishes=4"))
    perform(**one.arguments())
    assert one.trained
    assert 4 <= len(one.finishes) < 20
    assert one.counters["env_steps"] < 1024
    assert one.evaluation["rows"][0]["success_rate"] == 1  # evaluated in the same world


def test_a_run_of_an_older_recipe_is_found_out(monkeypatch, tmp_path):
    from spikedeploy.trainers.recipes import RECIPES, Recipe, merged

    one = make(tmp_path)
    perform(**one.arguments())
    assert one.changed_settings == []
    old = RECIPES["smoke-kart"]
    newer = Recipe(old.algorithm, old.summary, merged(old.settings, {"gamma": 0.5}))
    monkeypatch.setitem(RECIPES, "smoke-kart", newer)
    assert one.changed_settings == [f"gamma={one.config.gamma}"]


def test_seeds_and_recipes_do_not_take_each_other_for_themselves(tmp_path):
    one, eleven = make(tmp_path, seed=1), make(tmp_path, seed=11)
    perform(**eleven.arguments())
    assert one.run is None
    assert eleven.run is not None


def test_a_built_in_player_is_evaluated_once(tmp_path, monkeypatch):
    one = evaluation.BuiltInEvaluation("kart-grid", "random", str(tmp_path), 3)
    assert evaluation.perform(**one.arguments())
    assert one.done
    assert one.evaluation["rows"][0]["policy"] == "random"
    assert not evaluation.BuiltInEvaluation("kart-grid", "random", str(tmp_path), 4).done


def test_finishes_are_read_to_the_step(tmp_path):
    file = tmp_path / "episodes.csv"
    file.write_text("env_steps,finish\n30,1\n10,0\n20,1\n40,\n")
    steps = finishes(file)
    assert steps.tolist() == [20, 30]
    assert (steps_to(1, steps), steps_to(2, steps)) == (20, 30)
    assert np.isinf(steps_to(3, steps))
    assert finished_by(steps, np.array([19.0, 20.0, 35.0])).tolist() == [0, 1, 2]
    assert finishes(tmp_path / "nothing.csv").size == 0


@pytest.mark.parametrize(
    ("shares", "reached"),
    [
        ((0.0, 0.95, 1.0, 0.0), 20),
        ((0.95, 0.9, 0.95, 0.95), 30),  # the first did not hold
        ((0.0, 0.9, 0.0, 0.95), 40),  # the last one has none after it
        ((0.95, 0.9, 0.95, 0.9), np.inf),
        ((), np.inf),
    ],
)
def test_greedy_episodes_must_finish_in_two_validations(tmp_path, shares, reached):
    file = tmp_path / "metrics.csv"
    rows = "".join(f"{k}0,{share}\n{k}5,\n" for k, share in enumerate(shares, 1))
    file.write_text("env_steps,eval_finish\n" + rows)
    assert steps_to_greedy(0.95, file) == reached
    assert steps_to_greedy(0.95, tmp_path / "nothing.csv") == np.inf


def test_both_limits_must_be_reached_where_both_are_set(tmp_path):
    both = make(tmp_path, overrides=(*QUICK, "stop_at_finishes=4", "stop_at_greedy=0.95"))
    perform(**make(tmp_path, overrides=QUICK).arguments())
    last = both.run / "checkpoints/last.json"
    for counters, trained in (
        ({"finishes": 4, "held": 1}, False),
        ({"finishes": 3, "held": 2}, False),
        ({"finishes": 4, "held": 2}, True),
        ({"finishes": 4}, False),  # of a run before there was such a limit
    ):
        last.write_text(json.dumps({"env_steps": 512, **counters}))
        assert both.trained == trained


def test_the_progress_of_a_training_is_its_last_line(tmp_path):
    run = tmp_path / "kart-s0-20260101-000000"
    run.mkdir()
    assert progress_of(tmp_path, "kart-s0") is None
    (run / "metrics.csv").write_text("env_steps,episodes,finishes\n")
    assert progress_of(tmp_path, "kart-s0") is None
    (run / "metrics.csv").write_text("env_steps,episodes,finishes\n512,4,0\n1024,9,2\n")
    found = progress_of(tmp_path, "kart-s0")
    assert (found.steps, found.finishes) == (1024, 2)


def test_a_broken_export_is_not_evaluated(monkeypatch, tmp_path):
    from spikedeploy.exporters.check import ParityCheck
    from spikedeploy.runtime.errors import SpikedeployError

    monkeypatch.setattr(
        "spikedeploy.shipping.export_run.check",
        lambda *_: [ParityCheck("spikes", False, "3 differ")],
    )
    one = make(tmp_path)
    with pytest.raises(SpikedeployError, match=r"does not do what .*: spikes"):
        perform(**one.arguments())
    assert one.trained
    assert not one.done


def test_arguments_survive_json(tmp_path):
    one = make(tmp_path)
    assert Trial(**json.loads(json.dumps(one.arguments()))).config == one.config
