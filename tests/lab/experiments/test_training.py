"""A training does what is missing, and nothing twice: found, resumed, started, or refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lab.experiments.kart import KartTraining
from lab.experiments.pareto import BEST, ParetoDesign, StudentTraining
from lab.experiments.runner import Part, run_experiment
from lab.experiments.training import counters
from spikedeploy.jobs import resumable
from spikedeploy.policies.registry import find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers import train
from spikedeploy.trainers.metrics import read
from spikedeploy.trainers.run_folder import RunFolder
from tests import toy_race_env

QUICK = ("steps=1024", "policy.timesteps=8")


@pytest.fixture
def race(monkeypatch):
    toy_race_env.install(monkeypatch, "kart-grid")


def make(folder, **changes):
    plain = {
        "recipe": "smoke-kart", "seed": 1, "folder": str(folder), "overrides": QUICK,
        "episodes": 3, "chip": "loihi1", **changes,
    }  # fmt: skip
    return KartTraining(f"smoke-kart-s{plain['seed']}", **plain)


def part(training):
    return Part(training.name, training.stored, training)


def test_a_trial_is_trained_exported_and_evaluated(race, tmp_path):
    one = make(tmp_path)
    assert (one.run, one.is_trained, one.evaluation) == (None, False, None)
    assert part(one).perform()
    assert one.run.name.startswith("smoke-kart-s1-")
    assert counters(one.run)["env_steps"] == 1024
    assert [row["chip"] for row in one.evaluation["rows"]] == ["float", "loihi1"]
    assert all(row["episodes"] == 3 for row in one.evaluation["rows"])
    # 2-8-8-4 with biases
    assert one.evaluation["parameters"] == 2 * 8 + 8 + 8 * 8 + 8 + 8 * 4 + 4
    assert find(str(one.run / "policy.nir")).kind == "snn"


def test_a_longer_budget_goes_on_with_the_same_run(race, tmp_path):
    one, longer = make(tmp_path), make(tmp_path, overrides=(*QUICK[1:], "steps=1280"))
    part(one).perform()
    assert not longer.is_trained
    part(longer).perform()
    assert longer.run == one.run
    assert counters(longer.run)["env_steps"] == 1280
    assert part(longer).is_done


def test_an_interrupted_training_goes_on_where_it_stopped(race, monkeypatch, tmp_path):
    from spikedeploy.trainers.train import Interrupt

    asked = iter([False, False, False, True])
    monkeypatch.setattr(Interrupt, "__call__", lambda self: next(asked, False))
    one = make(tmp_path)
    assert not part(one).perform()
    steps, run = counters(one.run)["env_steps"], one.run
    assert 0 < steps < 1024
    assert part(one).perform()
    assert one.run == run
    ends = [row["env_steps"] for row in read(run / "episodes.csv")]
    assert ends == sorted(ends)


def test_enough_finishes_end_a_training(race, tmp_path):
    one = make(tmp_path, overrides=(*QUICK, "env.options.luck=6", "stop_at_finishes=4"))
    part(one).perform()
    assert one.is_trained
    assert 4 <= len(one.finishes) < 20
    assert counters(one.run)["env_steps"] < 1024
    assert one.evaluation["rows"][0]["success_rate"] == 1  # evaluated in the same world


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
def test_greedy_episodes_must_finish_in_two_validations(race, tmp_path, shares, reached):
    one = make(tmp_path)
    run = RunFolder.create(tmp_path, one.planned()).path
    rows = "".join(f"{k}0,{share}\n{k}5,\n" for k, share in enumerate(shares, 1))
    (run / "metrics.csv").write_text("env_steps,eval_finish\n" + rows)
    assert one.steps_to_greedy(0.95) == reached


def test_both_limits_must_be_reached_where_both_are_set(race, tmp_path):
    both = make(tmp_path, overrides=(*QUICK, "stop_at_finishes=4", "stop_at_greedy=0.95"))
    part(make(tmp_path, overrides=QUICK)).perform()
    last = both.run / "checkpoints/last.json"
    for found, trained in (
        ({"finishes": 4, "held": 1}, False),
        ({"finishes": 3, "held": 2}, False),
        ({"finishes": 4, "held": 2}, True),
        ({"finishes": 4}, False),  # of a run before there was such a limit
    ):
        last.write_text(json.dumps({"env_steps": 512, **found}))
        assert both.is_trained == trained


def test_a_broken_export_is_not_evaluated(race, monkeypatch, tmp_path):
    from spikedeploy.exporters.check import ParityCheck
    from spikedeploy.runtime.errors import SpikedeployError

    monkeypatch.setattr(
        "spikedeploy.shipping.export_run.check",
        lambda *_: [ParityCheck("spikes", False, "3 differ")],
    )
    one = make(tmp_path)
    with pytest.raises(SpikedeployError, match=r"does not do what .*: spikes"):
        part(one).perform()
    assert one.is_trained
    assert one.evaluation is None


# students of teachers

ENV = "kart-grid"


def student(name, folder, overrides=()):
    recipe = f"{ENV}-{name}"
    return StudentTraining(f"{recipe}-s1", recipe, 1, str(folder), overrides, student=name)


@pytest.fixture
def asked(tmp_path):
    return student("sparse", tmp_path, ("walks=7",))


@pytest.fixture
def baseline(tmp_path):
    return replace(student("small-mlp", tmp_path), parents={"pool": student("sparse", tmp_path)})


@pytest.fixture
def calls(monkeypatch):
    """What the trainer was asked for; it does nothing."""
    found = []
    monkeypatch.setattr(train, "train", lambda *words, **options: found.append((words, options)))
    return found


def leave(asked, finished, *, seed=1, **more):
    """A run folder; with a checkpoint if it is said whether it finished."""
    config = asked.planned().model_copy(update={"seed": seed, **more})
    run = RunFolder.create(asked.folder, config).path
    if finished is not None:
        (run / "checkpoints/last.json").write_text(json.dumps({"finished": finished}))
    return run


def test_a_training_that_is_missing_is_started_with_its_settings(asked, calls):
    assert asked.complete() is False  # the trainer of this test makes no updates
    ((words, options),) = calls
    assert words == ("kart-grid-sparse",)
    assert (options["seed"], options["overrides"]) == (1, ["walks=7"])


def test_an_unfinished_training_is_resumed(asked, calls):
    leave(asked, True, seed=2)  # of another seed
    run = leave(asked, False)
    assert asked.complete() is False
    assert calls[0][1]["resume"] == run


def test_a_baseline_takes_over_the_walks_of_the_finished_spiking_run(baseline, asked, calls):
    with pytest.raises(
        ConfigError,
        match="needs kart-grid-sparse-s1, which is not trained yet",
    ):
        baseline.complete()
    run = leave(asked, True)
    baseline.complete()
    assert calls[0][1]["overrides"] == [f'pool="{run}"', "teacher_walks=0", "noisy_walks=0"]


def test_settings_that_are_not_the_recipes_are_named(asked):
    leave(asked, True)
    assert asked.changed_settings == []
    now = replace(asked, overrides=("walks=8",))
    assert now.changed_settings == ["walks=7"]


# with reward


def tuned(start, level=BEST):
    at = (f"start_checkpoint={level}",)
    name = f"{ENV}-tuned-{start.student}{'' if level == BEST else f'-{level}'}-s1"
    overrides = ("iterations=5", *(() if level == BEST else at))
    return StudentTraining(
        name, f"{ENV}-sparse-tuned", 1, start.folder, overrides, {"start": start}, at,
        start.student, level,
    )  # fmt: skip


def test_a_training_with_reward_waits_for_its_start_and_begins_there(asked, calls):
    with pytest.raises(ConfigError, match="kart-grid-tuned-sparse-s1 needs kart-grid-sparse-s1"):
        tuned(asked).complete()
    run = leave(asked, True)
    assert tuned(asked).complete() is False
    ((words, options),) = calls
    assert words == ("kart-grid-sparse-tuned",)
    assert (options["seed"], options["overrides"]) == (1, ["iterations=5", f'start="{run}"'])


def test_runs_with_reward_are_told_apart_by_the_runs_that_they_began_at(asked, baseline, calls):
    starts = {}
    starts["asked"] = leave(asked, True)
    starts["baseline"] = leave(baseline, True, pool=str(starts["asked"]))
    leave(tuned(asked), None)  # refused, and left without a start
    leave(tuned(asked), True, start="gone-s1")
    mine = leave(tuned(asked), True, start=starts["asked"].name)
    theirs = leave(tuned(baseline), False, start=starts["baseline"].name)
    assert (tuned(asked).run, tuned(baseline).run) == (mine, theirs)
    assert (tuned(asked).is_trained, tuned(baseline).is_trained) == (True, False)
    assert tuned(asked).complete() is True
    assert calls == []
    tuned(baseline).complete()
    assert calls[0][1]["resume"] == theirs


def test_reward_from_an_earlier_level_of_pruning_is_a_training_of_its_own(asked, calls):
    run = leave(asked, True)
    plain, early = tuned(asked), tuned(asked, "ops-45")
    assert early.aim("best") == 45
    mine = leave(plain, True, start=run.name)
    assert (plain.run, early.run) == (mine, None)
    assert early.complete() is False
    assert calls[0][1]["overrides"] == [
        "iterations=5", "start_checkpoint=ops-45", f'start="{run}"'
    ]  # fmt: skip
    theirs = leave(early, True, start=run.name)
    assert (plain.run, early.run) == (mine, theirs)
    assert early.changed_settings == []


# refused before anything runs


@pytest.fixture
def started(monkeypatch):
    """The names of the jobs that were started; they do nothing."""
    names = []
    monkeypatch.setattr(
        resumable, "run", lambda jobs, *_: names.extend(job.name for job in jobs) or True
    )
    monkeypatch.setattr(ParetoDesign, "write", lambda design, results: [results / "pareto.md"])
    return names


@pytest.mark.parametrize(
    ("only", "missing"),
    [
        ("kart-grid-sparse-linear-s0", "needs kart-grid-sparse-s0, which is not trained yet"),
        ("kart-grid-tuned-sparse-s0", "needs kart-grid-sparse-s0, which is not trained yet"),
        ("kart-grid-sparse-s0: levels", "needs kart-grid-sparse-s0, which is not trained yet"),
    ],
)
def test_a_part_whose_training_before_is_missing_is_refused_at_the_start(
    only, missing, started, tmp_path
):
    design = ParetoDesign(1, str(tmp_path / "runs"), quick=True, env=ENV)
    with pytest.raises(ConfigError, match=missing):
        run_experiment(design, [only], 1, tmp_path / "results")
    assert started == []
    assert not list(tmp_path.iterdir())
    run_experiment(design, [only, "kart-grid-sparse-s0"], 1, tmp_path / "results")
    assert {"kart-grid-sparse-s0", only} <= set(started)
