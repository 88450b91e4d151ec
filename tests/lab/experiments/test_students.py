"""The students experiment in its smallest size, with a teacher that is there."""

import shutil
from pathlib import Path

import pytest

from lab.experiments import students
from lab.experiments.runner import run_experiment
from lab.experiments.students import StudentsDesign, _facts
from lab.experiments.training import read_rows
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
    assert student["updates"] > 0
    assert rival["updates"] is linear["updates"] is None
    assert all(len(row["scores"]) == 2 for row in rows)


def test_the_page_says_what_it_has(results):
    text = Path(results / "students.md").read_text("utf-8")
    assert "| reach | " in text
    assert "Not trained" not in text


def facts(**scores):
    """Facts of a task from scores of each role, a training each of as many operations."""

    def row(role, returns, operations):
        counts = {"operations": operations, "updates": 9.0, "minutes": 1.0}
        return {"role": role, "scores": returns, **counts}

    by = {
        ("a", role.replace("_", " ")): [row(role, *each) for each in of]
        for role, of in scores.items()
    }
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


def test_energy_is_over_the_cheapest_float_policy_that_keeps_enough():
    scores = {
        "teacher": [([10.0], 64.0)],
        "random": [([0.0], None)],
        "spiking_student": [([10.0], 5.0), ([10.0], 7.0), ([10.0], 20.0)],
        "float_MLP": [([9.9], 6.0), ([9.9], 10.0), ([9.9], 12.0)],
        "float_linear": [([5.0], 1.0)],  # which does not keep enough
    }
    found = facts(**scores)
    # (7 x 1.35 + 9 x 26.5) / (10 x 1.55) pJ
    assert found["energy"][0] == pytest.approx((7 * 1.35 + 9 * 26.5) / 15.5)
    assert found["fewer"] == [True, True]
    found = facts(**{**scores, "float_linear": [([10.0], 5.5)]})
    assert found["energy"][0] == pytest.approx((7 * 1.35 + 9 * 26.5) / (5.5 * 1.55))
    assert found["fewer"] == [False, True]
    assert facts(**{**scores, "float_MLP": [([5.0], 1.0)]})["energy"] == []
