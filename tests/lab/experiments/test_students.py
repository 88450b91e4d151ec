"""What the page of students says of returns, operations and energies; a training of seconds."""

from pathlib import Path

import numpy as np
import pytest

from lab.experiments import students
from lab.experiments.runner import Record
from lab.experiments.students import PRICES, facts_of_policy, facts_of_task, threshold
from spikedeploy.runtime.metrics.energy_tables import TABLES
from spikedeploy.trainers.train import train
from tests.paths import ROOT

REACH = {"env": "tests.own_env:Reach"}
SECONDS = (
    "search=false", "budget=60", "levels=[200]", "walks=1", "dense_updates=20", "dense_rounds=1",
    "level_updates=20", "polish=1", "polish_updates=10", "prune_every=5", "batch=8", "log_every=5",
    "checkpoint_every=20", "validation.every=10", "validation.episodes=1", "validation.limit=40",
)  # fmt: skip


@pytest.fixture
def short(monkeypatch, tmp_path):
    """Trainings of seconds, two episodes, and a teacher that is there."""

    def trained(name, recipe, env, settings, seed):
        found = sorted((tmp_path / name).glob("*"))
        walks = () if "pool" in str(settings) else ("teacher_walks=2", "noisy_walks=1")
        given = {"overrides": [*SECONDS, *walks, *settings], "seed": seed, "quiet": True}
        return found[0] if found else train(recipe, env=env, runs=tmp_path / name, **given)

    monkeypatch.setattr(students, "TASKS", {"reach": REACH})
    monkeypatch.setattr(students, "trained", trained)
    monkeypatch.setattr(students, "_teacher", lambda task: Path("tests/golden/sb3/sac.zip"))
    monkeypatch.setattr(students.policies.play, "__defaults__", (2,))
    monkeypatch.chdir(ROOT)


def test_each_job_has_its_row_and_the_page_shows_them(short):
    rows: list[Record] = [row for job in students.jobs(1) for row in students.measure(job)]
    assert [row["role"] for row in rows] == [
        "teacher", "random", "no action", "spiking student", "float MLP", "float linear",
    ]  # fmt: skip
    taught, at_random, _, student, rival, linear = rows
    assert student["minutes"] > 0
    assert taught["operations"] == 4 * 8 + 8 * 6 + 6 * 2
    assert at_random["operations"] is None
    assert student["updates"] > student["readout_updates"] > 0
    assert None not in [row["validation"] for row in (student, rival, linear)]
    assert rival["updates"] is linear["updates"] is None
    assert all(len(row["scores"]) == 2 for row in rows)
    page = students.EXPERIMENT.page(rows)
    assert "| reach | " in page
    assert "Not trained" not in page


def facts(validation=(), **scores):
    """Facts of a task from scores of each role, a training each of as many operations.

    validation: role -> of each training
    """

    def row(role, returns, operations, known=None):
        counts = {"operations": operations, "updates": 9.0, "readout_updates": 2.0, "minutes": 1.0}
        return {"role": role, "scores": returns, "validation": known, **counts}

    by = {}
    for role, of in scores.items():
        known = dict(validation).get(role, [None] * len(of))
        by["a", role.replace("_", " ")] = [
            row(role, *each, share) for each, share in zip(of, known, strict=True)
        ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(students, "TASKS", {"a": REACH})
        return facts_of_task("a", by)


def test_shares_are_of_the_way_from_the_better_of_random_and_no_action():
    known = {"teacher": [([10.0, 10.0], 64.0)], "random": [([-110.0, -110.0], None)]}
    student = {"spiking_student": [([7.0, 7.0], 5.0)]}
    found = facts(**known, **student)
    assert found["policies"]["spiking student"]["share"].mean == pytest.approx(117 / 120)
    assert found["kept"]
    found = facts(**known, **student, no_action=[([0.0, 0.0], None)])
    assert found["policies"]["spiking student"]["share"].mean == pytest.approx(0.7)
    assert not found["kept"]


SCORES = {
    "teacher": [([10.0], 64.0)],
    "random": [([0.0], None)],
    "spiking_student": [([10.0], 5.0), ([10.0], 7.0), ([10.0], 20.0)],
    "float_MLP": [([9.9], 6.0), ([9.9], 10.0), ([9.9], 12.0)],
    "float_linear": [([5.0], 1.0)],  # which does not keep enough
}


def test_energy_is_over_the_cheapest_float_policy_that_keeps_enough():
    found = facts(**SCORES)
    # sums in registers, where all updates cost 26.5 pJ
    spent = 7 * 1.35 + 9 * 26.5
    assert found["energy"][0] == pytest.approx(spent / (10 * 1.55))
    # in memory, where two of nine are of readouts, with one state
    price = TABLES[PRICES[1]].joules
    updates = 7 * price["neuron_update"] + 2 * price["one_state_update"]
    assert found["energy"][1] == pytest.approx((7 * price["sop"] + updates) / (10 * price["mac"]))
    found = facts(**{**SCORES, "float_linear": [([10.0], 5.5)]})
    assert found["energy"][0] == pytest.approx(spent / (5.5 * 1.55))
    assert facts(**{**SCORES, "float_MLP": [([5.0], 1.0)]})["energy"] == []


@pytest.mark.parametrize(
    ("changed", "fewer"),
    [
        ({}, [True, True]),
        ({"float_linear": [([10.0], 5.5)]}, [False, True]),
        # no float policy keeps enough: nothing is won
        ({"float_MLP": [([5.0], 100.0)] * 3}, [False, False]),
        # nor by a student that does not
        ({"spiking_student": [([5.0], 1.0)] * 3}, [False, False]),
        ({"spiking_student": [([5.0], 1.0)] * 3, "float_MLP": [([5.0], 9.0)]}, [False, False]),
    ],
)
def test_fewer_operations_count_where_both_sides_keep_enough(changed, fewer):
    assert facts(**{**SCORES, **changed})["fewer"] == fewer


def test_the_cheapest_training_is_one_that_kept_enough_in_validation():
    linear = {"float_linear": [([10.0], 4.0), ([1.0], 1.0), ([1.0], 2.0)]}
    # their mean keeps too little here, and one of them enough in validation
    found = facts({"float_linear": [0.99, 0.2, 0.1]}, **{**SCORES, **linear})
    assert found["fewer"] == [True, False]
    # what happened in the episodes that are shown chooses nothing
    found = facts({"float_linear": [0.5, 0.2, 0.1]}, **{**SCORES, **linear})
    assert found["fewer"] == [True, True]
    found = facts({"spiking_student": [0.9, 1.0, 0.99]}, **SCORES)
    assert found["fewer"] == [True, False]  # 7 of the student against 6


def test_a_regulator_that_keeps_enough_is_a_float_policy_of_the_rule():
    found = facts(**{**SCORES, "LQR": [([10.0], 4.0)], "LQR,_late": [([1.0], 2.0)]})
    assert found["fewer"] == [False, False]
    assert found["energy"][0] == pytest.approx((7 * 1.35 + 9 * 26.5) / (4 * 1.55))


def test_episodes_are_solved_from_the_registered_return_on():
    rows = [{"scores": [199.9, 200.0, 300.0, -5.0]}]
    solved = threshold("LunarLanderContinuous-v3")
    assert facts_of_policy(rows, np.full(4, 250.0), 0.0, solved)["solved"] == [0.5]
    assert threshold("tests.own_env:Reach") is None  # nothing is registered
    assert facts_of_policy(rows, np.full(4, 250.0), 0.0, None)["solved"] == []


def test_episodes_below_half_of_the_way_are_lost():
    scores = {
        "teacher": [([10.0, 10.0, 10.0, 10.0], 64.0)],
        "random": [([2.0, 2.0, 2.0, 2.0], None)],
        "spiking_student": [([10.0, 5.9, 6.1, -4.0], 5.0), ([10.0, 9.0, 9.0, 9.0], 5.0)],
    }
    found = facts(**scores)["policies"]
    assert found["spiking student"]["lost"] == [2, 0]
    assert found["spiking student"]["worst"] == (-4.0 + 9.0) / 2
    assert found["teacher"]["lost"] == [0]
