"""The gymnasium experiment in its smallest size: trained, evaluated, written, resumed."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from lab.experiments.gymnasium import (
    RATE,
    TASKS,
    GymnasiumDesign,
    points,
    read_table,
    reference,
    role,
    verdict,
)
from lab.experiments.runner import run_experiment

TASK = "Pendulum-v1"
FEWER = tuple(
    f"{role}.{setting}"
    for role in ("sparse", "small-mlp")
    for setting in ("dense_updates=6", "level_updates=6", "polish_updates=4",
                    "validation.every=2", "checkpoint_every=4")
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _few_copies():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("spikedeploy.trainers.sparse.sparse._ENV_COPIES", 3)
        yield


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    runs = str(tmp_path_factory.mktemp("gymnasium") / "runs")
    return GymnasiumDesign(1, runs, FEWER, episodes=3, limit=25, quick=True, tasks=(TASK,))


@pytest.fixture(scope="module")
def results(design, ran):
    """The folder of the page of one task."""
    folder = Path(design.runs).parent / "results"
    outcome = run_experiment(design, (), 1, folder)
    assert (outcome.done, outcome.of, outcome.failed) == (10, 10, {})
    return folder


def rows(results):
    return read_table(results / "gymnasium.csv")


def of(results, role, place):
    (row,) = (r for r in rows(results) if (r["role"], r["place"]) == (role, place))
    return row


def test_a_task_is_trained_from_the_teacher_to_the_baseline(results, ran):
    assert [name for name in ran if ":" not in name] == [
        f"{TASK}-{part}-s0" for part in ("teacher", "sparse", "tuned", "dense", "small-mlp")
    ]


def test_every_policy_has_a_row_at_every_place_on_the_same_episodes(results):
    found = {(row["role"], row["place"]) for row in rows(results)}
    assert found == {
        ("teacher", "float"), ("random", "random"), ("sparse", "loihi1"), ("tuned", "ideal"),
        ("tuned", "loihi1"), ("tuned", "xylo-a3"), ("tuned", "int"), ("dense", "ideal"),
        ("dense", "loihi1"), ("small-mlp", "int8"),
    }  # fmt: skip
    assert {len(row["scores"]) for row in rows(results) if not row["refusal"]} == {3}


def test_a_chip_that_refuses_a_policy_says_why(results):
    assert "reset" in of(results, "tuned", "xylo-a3")["refusal"]
    assert "| refused: rule reset" in (results / "gymnasium.md").read_text()


def test_students_are_of_the_run_of_their_teacher(design, results):
    teacher, sparse, tuned, dense, baseline = design.trainings()
    for student in (sparse, dense, baseline):
        settings = json.loads((student.run / "config.json").read_text())
        assert settings["teacher"] == str(teacher.run)
    settings = json.loads((baseline.run / "config.json").read_text())
    assert (settings["pool"], settings["teacher_walks"]) == (str(sparse.run), 0)
    assert json.loads((tuned.run / "config.json").read_text())["start"] == sparse.run.name
    assert [training.changed_settings for training in design.trainings()] == [[]] * 5


def test_a_run_of_other_settings_or_another_seed_is_not_taken(design, results):
    wider = replace(design, settings=(*FEWER, "teacher.policy.hidden=[24]"))
    assert wider.trainings()[0].run is None
    (teacher, *_) = design.trainings()
    assert replace(teacher, seed=1).run is None


def test_a_teacher_that_was_trained_elsewhere_and_otherwise_computed_is_taken(
    design, results, tmp_path
):
    (teacher, *_) = design.trainings()
    there = tmp_path / "runs"
    shutil.copytree(teacher.run, there / teacher.run.name)
    file = there / teacher.run.name / "config.json"
    settings = json.loads(file.read_text())
    file.write_text(json.dumps({**settings, "precision": "bfloat16", "device": "cuda"}))
    moved = replace(design, runs=str(there), settings=(*FEWER, 'teacher.precision="float32"'))
    assert moved.trainings()[0].is_trained
    assert not moved.parts()[1].is_done


def test_the_page_says_what_is_missing_and_keeps_the_rows_of_other_tasks(results, tmp_path):
    shutil.copytree(results, tmp_path / "results")
    other = GymnasiumDesign(1, str(tmp_path / "runs"), quick=True, tasks=("CartPole-v1",))
    run_experiment(other, (), 1, tmp_path / "results", train=False)
    assert rows(tmp_path / "results") == rows(results)
    text = (tmp_path / "results" / "gymnasium.md").read_text()
    assert "4 of 4 trainings, or their rows, are missing: CartPole-v1-teacher-s0" in text
    assert "    python -m lab experiment gymnasium CartPole-v1 --quick --seeds 1" in text


@pytest.mark.parametrize("env", TASKS)
def test_the_table_has_the_sizes_of_each_task(env):
    task, world = TASKS[env], gymnasium.make(env)
    space = world.action_space
    assert task.is_continuous == isinstance(space, gymnasium.spaces.Box)
    assert task.observations == world.observation_space.shape[0]
    assert task.actions == (space.shape[0] if task.is_continuous else space.n)
    world.close()


def test_the_dense_network_is_counted_synapse_by_synapse():
    hopper = TASKS["Hopper-v5"]
    assert hopper.synapses == 110 * 256 + 256 * 256 + 256 * 30
    assert hopper.dense_operations(1.0) == 5 * hopper.synapses
    assert reference("Hopper-v5", [], "loihi1").operations == 5 * RATE * hopper.synapses


def row(role, place, scores, seed=0, **more):
    return {"env": "Hopper-v5", "role": role, "place": place, "seed": seed, "scores": scores,
            "terminated": 0.0, **more}  # fmt: skip


def verdict_of(student, operations):
    found = [
        row("teacher", "float", [100.0, 200.0]),
        row("random", "random", [1.0, 2.0], None),
        row("dense", "loihi1", [90.0, 190.0], operations=50_000.0, neuron_updates=1.0),
        row("tuned", "loihi1", student, operations=operations, neuron_updates=1.0),
    ]
    return verdict("Hopper-v5", found, "loihi1")


def test_a_verdict_needs_the_return_and_the_operations():
    assert verdict_of([96.0, 194.0], 499.0).startswith("* ✓ **Hopper-v5**")
    missed = verdict_of([90.0, 180.0], 499.0)
    assert missed.startswith("* ✗")
    assert missed.endswith("missed by the return.")
    assert verdict_of([94.0, 200.0], 499.0).startswith("* ≈ **Hopper-v5**")
    assert verdict_of([94.0, 200.0], 501.0).startswith("* ✗ **Hopper-v5**")
    assert "missed by the operations." in verdict_of([96.0, 194.0], 501.0)
    assert "50,000 (measured)" in verdict_of([96.0, 194.0], 499.0)


def test_a_negative_return_counts_from_random_actions_on():
    found = points(
        [
            row("teacher", "float", [-100.0, -200.0]),
            row("random", "random", [-1100.0, -1200.0], None),
            row("tuned", "loihi1", [-200.0, -300.0], operations=1.0),
        ]
    )
    shares = {role(point): point.of_teacher.mean for point in found}
    assert shares["teacher"] == 1.0
    assert shares["tuned"] == pytest.approx(0.9)
    assert np.isclose(shares["random"], 0.0)
