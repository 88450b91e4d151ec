"""The students experiment in its smallest size, with a teacher that is there."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from lab.experiments import late, students
from lab.experiments.runner import run_experiment
from lab.experiments.students import PRICES, StudentsDesign, _facts
from lab.experiments.training import read_rows
from spikedeploy.runtime.metrics.energy import TABLES
from tests.paths import ROOT

REACH = {"env": "tests.own_env:Reach", "teacher": {"algorithm": "SAC", "copies": 1, "settings": {}}}


@pytest.fixture(scope="module")
def results(tmp_path_factory, ran):
    folder = tmp_path_factory.mktemp("students")

    def teach(of, file):
        file.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / "tests/golden/sb3/sac.zip", file)
        return {"minutes": 1.0}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(students, "TASKS", {"reach": REACH})
        patch.setattr(students, "_teach", teach)
        design = StudentsDesign(1, str(folder / "runs"), tasks=("reach",), episodes=2, quick=True)
        outcome = run_experiment(design, (), 1, folder / "results")
        assert (outcome.done, outcome.of, outcome.failed) == (5, 5, {})
        yield folder / "results"
    assert ran[-5:] == [
        "reach-teacher",
        "reach-episodes",
        "reach-spiking-student-s0",
        "reach-float-MLP-s0",
        "reach-float-linear-s0",
    ]


def test_each_part_has_its_row(results):
    rows = read_rows(results / "students.csv", ("task", "role"))
    assert [row["role"] for row in rows] == [
        "teacher", "random", "no action", "spiking student", "float MLP", "float linear",
    ]  # fmt: skip
    teacher, at_random, _, student, rival, linear = rows
    assert student["minutes"] > 0
    assert teacher["operations"] == 4 * 8 + 8 * 6 + 6 * 2
    assert at_random["operations"] is None
    assert student["updates"] > student["readout_updates"] > 0
    assert None not in [row["validation"] for row in (student, rival, linear)]
    assert rival["updates"] is linear["updates"] is None
    assert all(len(row["scores"]) == 2 for row in rows)


def test_the_page_says_what_it_has(results):
    text = Path(results / "students.md").read_text("utf-8")
    assert "| reach | " in text
    assert "Not trained" not in text


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
        return _facts("a", by)


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


def test_episodes_are_solved_from_the_registered_return_on(monkeypatch):
    rows = [{"scores": [199.9, 200.0, 300.0, -5.0]}]
    monkeypatch.setattr(
        students, "TASKS", {"lander": {"env": "LunarLanderContinuous-v3"}, "a": REACH}
    )
    solved = students._threshold("lander")
    found = students._policy(rows, np.full(4, 250.0), 0.0, solved)
    assert found["solved"] == [0.5]
    assert students._threshold("a") is None  # nothing is registered
    assert students._policy(rows, np.full(4, 250.0), 0.0, None)["solved"] == []


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


def test_a_late_regulator_needs_its_last_action():
    """Of the linearised pendulum: with it nothing grows, without it something does."""
    move, push = late._linearised()
    plain, shown = late.gain(False), late.gain(True)
    assert plain.shape == (1, 6)
    # x' = (A - B K) x at once; one step late x' = A x + B a, a' = -K x
    at_once = np.linalg.eigvals(move - push @ plain)
    unaware = np.linalg.eigvals(np.block([[move, push], [-plain, np.zeros((1, 1))]]))
    aware = np.linalg.eigvals(np.block([[move, push], [-shown[:, :6], -shown[:, 6:]]]))
    assert max(abs(at_once)) < 1 < max(abs(unaware))
    assert max(abs(aware)) < 1


def test_the_last_actions_stand_behind_the_observation():
    env = late.shown()
    seen, _ = env.reset(seed=0)
    assert env.observation_space.shape == (11,)
    assert seen[9:].tolist() == [0, 0]
    env.step(np.array([0.5], np.float32))
    assert env.step(np.array([-0.25], np.float32))[0][9:].tolist() == [-0.25, 0.5]
    assert env.reset(seed=0)[0].tolist() == seen.tolist()
    assert late.taught(seen[None]).shape == (1, 1)


def test_regulators_act_at_once_or_a_step_late():
    gains = np.array([[2.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    seen = np.zeros((1, 9))
    at_once, delayed = (late.Regulator(gains, each) for each in (False, True))
    for controller, acted in ((at_once, [-0.2, -1.0, 0.0]), (delayed, [0.0, -0.2, -1.0])):
        controller.reset(1)
        found = []
        for place in (0.1, 3.0, 0.0):
            seen[0, 0] = place
            found.append(float(controller.act_batch(seen)[0, 0]))
        assert found == acted
