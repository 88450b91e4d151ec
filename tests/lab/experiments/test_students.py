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
        assert (outcome.done, outcome.of, outcome.failed) == (4, 4, {})
        yield folder / "results"
    assert ran[-4:] == [
        "reach-teacher",
        "reach-episodes",
        "reach-spiking-student-s0",
        "reach-float-MLP-s0",
    ]


def test_each_part_has_its_row(results):
    rows = read_rows(results / "students.csv", ("task", "role"))
    assert [row["role"] for row in rows] == [
        "teacher", "random", "spiking student", "float MLP",
    ]  # fmt: skip
    teacher, at_random, student, rival = rows
    assert student["minutes"] > 0
    assert teacher["operations"] == 4 * 8 + 8 * 6 + 6 * 2
    assert at_random["operations"] is None
    assert student["updates"] > 0
    assert rival["updates"] is None
    assert all(len(row["scores"]) == 2 for row in rows)


def test_the_page_says_what_it_has(results):
    text = Path(results / "students.md").read_text("utf-8")
    assert "| reach * | " in text
    assert "Not trained" not in text


def test_returns_below_zero_are_measured_from_random_actions_on():
    def row(role, *scores):
        return {
            "role": role,
            "scores": list(scores),
            "operations": 5.0,
            "updates": 9.0,
            "minutes": 1.0,
        }

    by = {("a", role): [row(role, *of)] for role, of in (
        ("teacher", (-10.0, -10.0)), ("random", (-110.0, -110.0)),
        ("spiking student", (-12.0, -14.0)),
    )}  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(students, "TASKS", {"a": REACH})
        found = _facts("a", by)
        assert found["students"]["spiking student"]["share"].mean == pytest.approx(0.97)
        assert found["mark"]
        by["a", "teacher"] = [row("teacher", 10.0, 10.0)]
        by["a", "spiking student"] = [row("spiking student", 9.0, 9.0)]
        found = _facts("a", by)
        assert found["students"]["spiking student"]["share"].mean == pytest.approx(0.9)
        assert not found["mark"]
