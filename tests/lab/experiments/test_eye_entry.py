"""The entry test of kart-eye in its smallest size, and what its page concludes."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.experiments import eye_entry
from lab.experiments.eye_entry import EyeEntryDesign, outcomes, read_table, right_share, verdicts
from lab.experiments.eye_map import NOT_PRUNED
from lab.experiments.runner import run_experiment
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.config import SparseConfig

SOME = ("linear-traces-8x16", "cnn", "snn", "if", "if-240")


@pytest.fixture(scope="module", autouse=True)
def _three_networks():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(eye_entry, "_ROWS", {name: eye_entry._ROWS[name] for name in SOME})
        yield


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    runs = str(tmp_path_factory.mktemp("eye") / "runs")
    return EyeEntryDesign(1, runs, episodes=2, quick=True, limit=60)


@pytest.fixture(scope="module")
def results(design, ran):
    folder = Path(design.runs).parent / "results"
    outcome = run_experiment(design, (), 1, folder)
    assert (outcome.done, outcome.of, outcome.failed) == (8, 8, {})
    assert ran == [
        "teacher",
        *eye_entry.DESIGNS["kart-eye"]["walks"],
        *(f"{name}-s0" for name in SOME),
    ]
    return folder


def test_each_row_holds_its_episodes_one_by_one(results):
    found = read_table(results / "kart-eye.csv")
    assert all(len(row["right"]) == len(row["finish"]) == 2 for row in found)
    rows = {row["network"]: row for row in found if row["level"] in (None, NOT_PRUNED)}
    assert list(rows) == ["teacher", *SOME]
    assert rows["cnn"]["updates"] == rows["linear-traces-8x16"]["updates"] > 0
    assert {rows[name]["walks"] for name in ("cnn", "snn", "if-240")} == {3 + 2 * 2}
    # 2 x 8 x 16 cells and three traces of each, onto seven actions and three of the second head
    assert rows["linear-traces-8x16"]["weights"] == 4 * 256 * 10 + 10


def test_what_is_done_is_not_done_again_and_rows_of_elsewhere_stay(design, results, ran, tmp_path):
    before, count = (results / "kart-eye.csv").read_bytes(), len(ran)
    run_experiment(design, (), 1, results)
    assert len(ran) == count
    shutil.copy(results / "kart-eye.csv", tmp_path)
    replace(design, runs=str(tmp_path / "none")).write(tmp_path)
    assert (tmp_path / "kart-eye.csv").read_bytes() == before
    for changed in ({"episodes": 3}, {"quick": False}):
        with pytest.raises(ConfigError, match=r"rows of 2 episodes, of quick trainings: .* -o"):
            replace(design, **changed).check(results)


def test_all_networks_train_equally_hard(tmp_path, monkeypatch):
    def effort(row):
        made = resolve(SparseConfig, row["recipe"], overrides=row["settings"], seed=0)
        return made.model_dump(exclude={"policy", "recipe"})

    whole = eye_entry.DESIGNS["kart-eye"]["networks"]
    unlike = {"budget", "levels", "chip", "rounding"}  # behind the level that is not pruned
    first, *others = (effort(row) for row in whole.values() if "start" not in row)
    assert len(others) == 9
    assert all(each[n] == first[n] for each in others for n in first.keys() - unlike)
    monkeypatch.setattr(eye_entry, "_ROWS", whole)
    trainings = EyeEntryDesign(runs=str(tmp_path)).trainings()
    unlike |= {"start"}
    for ending in ("-240-s0", "-pruned-s0"):
        goes_on = [each.planned() for each in trainings if each.name.endswith(ending)]
        first, second = (each.model_dump(exclude={"policy", "recipe"}) for each in goes_on)
        assert {n for n in first if first[n] != second[n]} <= unlike


def test_the_runs_of_one_network_are_not_those_of_another(tmp_path, monkeypatch):
    networks = eye_entry.DESIGNS["kart-eye"]["networks"]
    monkeypatch.setattr(eye_entry, "_ROWS", networks)
    for name, guide in (("cnn", ""), ("cnn-small", "kart-eye-cnn-s0-cnn")):
        run = RunFolder(tmp_path / f"kart-eye-cnn-s0-{name}")
        run.path.mkdir()
        made = [*networks[name]["settings"], f'guide="{guide}"']
        run.write_config(resolve(SparseConfig, "kart-eye-cnn", overrides=made, seed=0))
    found = {t.name: t.run for t in EyeEntryDesign(runs=str(tmp_path)).trainings()}
    assert {name: run.name for name, run in found.items() if run} == {
        "cnn-s0": "kart-eye-cnn-s0-cnn",
        "cnn-small-s0": "kart-eye-cnn-s0-cnn-small",
    }


def test_spiking_policies_drive_on_their_chips_at_each_level_of_pruning(results):
    rows = [r for r in read_table(results / "kart-eye.csv") if r["network"] == "snn"]
    assert [row["level"] for row in rows] == [NOT_PRUNED, "ops-60000", "ops-40000"]
    assert all(row["way"] == "loihi1" and row["neuron_update"] > 0 for row in rows)
    page = (results / "kart-eye.md").read_text(encoding="utf-8")
    assert page.count("| snn | loihi1 |") == 3
    assert page.count("| cnn | zero-skipping |") == 3


def test_right_counts_the_forks_that_were_taken():
    ends = [
        {"forks": 6.0, "wrong": 0.0, "finish": 1.0, "crash": 0.0},
        {"forks": 2.0, "wrong": 1.0, "finish": 0.0, "crash": 0.0},
        {"forks": 0.0, "wrong": 0.0, "finish": 0.0, "crash": 1.0},
    ]
    row = outcomes(ends)
    assert (row["right_share"], row["finish_share"]) == (pytest.approx(8 / 9), pytest.approx(1 / 3))
    assert right_share([row, row]).mean == pytest.approx(8 / 9)
    assert right_share([outcomes(ends[2:])]) is None


@pytest.mark.parametrize(
    ("right", "finish", "words"),
    [((6, 6), (1, 1), "cnn does,"), ((6, 1), (1, 0), "cnn does not,")],
)
def test_the_page_concludes_from_its_numbers(right, finish, words):
    def row(right, finish):
        wrong = [int(taken < 6) for taken in right]
        return {"right": list(right), "wrong": wrong, "finish": list(finish), "crash": [0, 0]}

    found = list(
        verdicts({"linear-traces-8x16": [row((6, 0), (1, 0))], "cnn": [row(right, finish)]})
    )
    assert "right: no: linear-traces-8x16" in found[0]  # 6 of 7
    assert words in found[1]
    assert np.isclose(right_share([row((6, 0), (1, 0))]).mean, 6 / 7)
