"""The pareto experiment in its smallest size: trained, evaluated, written, resumed."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.experiments.pareto import evaluation, page, records
from lab.experiments.pareto.design import (
    FLOAT,
    LAST,
    SPIKING,
    STUDENTS,
    ParetoDesign,
    asked,
)
from lab.experiments.pareto.experiment import experiment
from spikedeploy.jobs import resumable
from spikedeploy.runtime.errors import ConfigError
from tests.job_functions import in_this_process

ENV = "kart-grid"
SMALLER = (
    "dense_updates=8", "level_updates=8", "polish_updates=4", "validation.every=4",
    "validation.limit=10", "checkpoint_every=4", "log_every=4", "tuned.validation.limit=20",
)  # fmt: skip


@pytest.fixture(scope="module")
def ran():
    """The names of the jobs that ran, each in this process."""
    names = []

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(resumable, "run", in_this_process(names))
        patch.setattr("lab.experiments.parts._EVERY", -1.0)
        yield names


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    runs = str(tmp_path_factory.mktemp("pareto") / "runs")
    return ParetoDesign(ENV, 1, runs, SMALLER, episodes=3, chip_episodes=2, limit=12, quick=True)


@pytest.fixture(scope="module")
def results(design, ran):
    """The folder of the page of the whole experiment."""
    folder = Path(design.runs).parent / "results"
    outcome = experiment(design, (), 1, folder)
    assert (outcome.done, outcome.of, outcome.failed) == (24, 24, {})
    return folder


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rows(results):
    return records.read(results / "pareto" / f"{ENV}.csv")


def by_imitation(results):
    return [row for row in rows(results) if row["trained_by"] == "imitation"]


def test_the_spiking_network_comes_first_and_last_levels_elsewhere_come_last(results, ran):
    assert ran[:4] == [
        "teacher", "kart-grid-sparse-s0", "kart-grid-sparse-s0: levels",
        "kart-grid-sparse-linear-s0",
    ]  # fmt: skip
    assert ran[11:13] == ["kart-grid-tuned-sparse-s0", "kart-grid-tuned-sparse-s0: levels"]
    assert all("-tuned-" in name for name in ran[11:19])
    assert all(name.endswith("last level on chips") for name in ran[19:24])


def test_baselines_learn_from_the_walks_of_the_spiking_network(design, results):
    sparse, *baselines = design.trainings()
    for baseline in baselines:
        settings = json.loads((baseline.run / "config.json").read_text())
        assert settings["pool"] == str(sparse.run)
        assert (settings["teacher_walks"], settings["noisy_walks"]) == (0, 0)
        assert not baseline.changed_settings


def test_every_level_of_every_student_has_a_row_on_all_episodes(results):
    levels = [row for row in by_imitation(results) if row["part"] == "levels"]
    assert {(row["student"], row["level"]) for row in levels} == {
        (student, level) for student in STUDENTS for level in (200, 60)
    }
    assert {len(row["scores"]) for row in levels} == {3}
    assert all(row["operations"] > 0 for row in levels)


def test_every_student_goes_on_with_reward_and_is_one_more_row(design, results):
    rewarded = [row for row in rows(results) if row["trained_by"] == "reward"]
    assert [row["student"] for row in rewarded] == [*SPIKING, *FLOAT]
    assert {(row["level"], row["part"], len(row["scores"])) for row in rewarded} == {
        (60, "levels", 3)
    }
    for tuning in design.tunings():
        settings = json.loads((tuning.run / "config.json").read_text())
        assert settings["start"] == tuning.start.run.name
        assert settings["validation"]["limit"] == 20
        assert tuning.changed_settings == []
    assert len({tuning.run for tuning in design.tunings()}) == 4
    text = (results / "pareto.md").read_text()
    assert "| LIF, with reward | 60 |" in text
    assert "| float linear, with reward | 60 |" in text


def test_fewer_levels_have_less_to_do_and_keep_the_rows_of_the_others(design, results, tmp_path):
    fewer = replace(design, levels=1)
    (training, *_) = design.trainings()
    assert {row.of["level"] for row in evaluation.rows(fewer, training, False, 1)} == {"ops-60"}
    lost = Path(design.runs) / "evaluations" / f"{training.name}" / "ops-200@loihi1.json"
    kept = lost.read_bytes()
    lost.unlink()
    outcome = experiment(fewer, (), 1, tmp_path)
    assert (outcome.done, outcome.of) == (24, 24)
    assert not lost.exists()
    lost.write_bytes(kept)
    page.write(fewer, tmp_path)
    table = Path("pareto") / f"{ENV}.csv"
    assert (tmp_path / table).read_bytes() == (results / table).read_bytes()
    text = (tmp_path / "pareto.md").read_text()
    assert "--levels 1" in text
    assert "3 episodes of the last level from seed" in text


def test_runs_that_were_moved_are_found_again(design, results, tmp_path):
    moved = tmp_path / "moved"
    shutil.copytree(design.runs, moved)
    there = replace(design, runs=str(moved))
    assert [tuning.run.parent for tuning in there.tunings()] == [moved] * 4
    shutil.rmtree(there.trainings()[0].run)
    assert [tuning.run is None for tuning in there.tunings()] == [True, False, False, False]


def test_delta_networks_run_where_graded_spikes_do(results):
    graded = [row for row in rows(results) if row["student"] == "delta-mlp"]
    assert {row["place"].split(":")[0] for row in graded} == {"loihi2", "ideal"}
    assert all(0 <= row["graded_operations"] < row["operations"] for row in graded)
    text = (results / "pareto.md").read_text()
    assert "| delta network | 60 |" in text
    assert "**A quick trial, whose episodes end after 12 control steps" in text


def test_a_chip_that_refuses_a_network_is_named_with_its_rule(results):
    refused = [row for row in rows(results) if row["refusal"]]
    assert {(row["student"], row["place"]) for row in refused} >= {("sparse", "xylo-a3")}
    assert all(row["part"] == LAST and row["refusal"].startswith("rule ") for row in refused)
    assert "refused: rule reset" in (results / "pareto.md").read_text()


def test_a_second_run_has_nothing_to_do_and_changes_nothing(design, results, ran):
    before, count = contents(results), len(ran)
    assert experiment(design, (), 1, results).done == 24
    assert len(ran) == count
    assert contents(results) == before


def test_a_row_that_is_missing_is_made_again_and_no_other(design, results, ran):
    before = contents(results)
    folder = Path(design.runs) / "evaluations" / "kart-grid-small-mlp-s0"
    lost, kept = folder / "ops-60@int8.json", folder / "ops-200@int8.json"
    lost.unlink()
    age, count = kept.stat().st_mtime_ns, len(ran)
    experiment(design, (), 1, results)
    assert ran[count:] == ["kart-grid-small-mlp-s0: levels"]
    assert lost.is_file()
    assert kept.stat().st_mtime_ns == age
    assert contents(results) == before


def test_the_page_follows_from_its_table_without_the_runs(design, results, tmp_path):
    copy = tmp_path / "results"
    shutil.copytree(results / "pareto", copy / "pareto")
    elsewhere = ParetoDesign(ENV, 1, str(tmp_path / "none"), quick=True)
    files = page.write(elsewhere, copy)
    assert files[0].read_text() == (results / "pareto.md").read_text()
    assert contents(copy / "pareto").keys() == {
        copy / "pareto" / f"{ENV}{suffix}" for suffix in (".csv", ".json", ".png")
    }


def test_the_page_says_what_it_was_made_with(results):
    text = (results / "pareto.md").read_text()
    assert "    python -m lab experiment pareto kart-grid --quick --seeds 1 --episodes 3" in text
    assert "of at most 12 control steps" in text


def test_rows_say_of_how_many_trainings_their_policy_is_and_keep_the_returns_of_karts(results):
    teacher, *others = rows(results)
    assert teacher["training_seeds"] is None
    assert {row["training_seeds"] for row in others} == {1}
    for row in rows(results):
        if not row["refusal"]:
            assert len(row["returns"]) == len(row["scores"])
            assert np.mean(row["returns"]) == pytest.approx(row["return_mean"], rel=1e-5)
    text = (results / "pareto.md").read_text()
    assert "### Returns over training seeds and episodes" in text
    assert "| training seeds | episodes | finished | return | IQM | risk |" in text


def test_scores_of_karts_are_finishes(results):
    found = [score for row in rows(results) for score in row["scores"] or ()]
    assert found
    assert set(found) <= {0, 1}


def test_options_of_other_experiments_are_refused():
    with pytest.raises(ConfigError, match="the experiment pareto has no finishes"):
        asked({"env": "hexapod", "finishes": 3})
    with pytest.raises(ConfigError, match="needs an environment: hexapod, hexapod-command"):
        asked({})
    with pytest.raises(ConfigError, match="no environment 'hexapot'"):
        asked({"env": "hexapot"})


def test_karts_drive_more_episodes_than_robots_walk():
    assert (asked({"env": ENV}).episodes, asked({"env": "hexapod"}).episodes) == (300, 100)
    assert asked({"env": ENV, "episodes": 7}).episodes == 7
    assert asked({"env": ENV, "quick": True}).seeds == 1


def test_an_unknown_part_or_setting_is_refused_before_anything_runs(design, results, ran, tmp_path):
    count = len(ran)
    with pytest.raises(ConfigError, match="no part of the experiment begins with 'kart-grit'"):
        experiment(design, ["kart-grit"], 1, tmp_path)
    odd = ParetoDesign(ENV, 1, str(tmp_path), ("no_such=1",), quick=True)
    with pytest.raises(ConfigError, match=r"kart-grid-sparse-s0: .*no_such"):
        experiment(odd, (), 1, tmp_path)
    assert len(ran) == count


def test_intervals_hold_their_means(results):
    from lab.experiments.pareto.fronts import points

    for point in points(rows(results)):
        low, high = point.of_teacher.ci95
        assert np.isnan(low) or low <= point.of_teacher.mean <= high


def test_the_command_leaves_the_published_page_alone_where_sizes_are_quick(
    design, results, ran, tmp_path, monkeypatch, lab
):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(results / "pareto", tmp_path / "runs/pareto-quick/pareto")
    words = ["experiment", "pareto", ENV, "--quick", "--no-train", "--json"]
    assert lab(*words)[0] == 0
    assert (tmp_path / "runs/pareto-quick/pareto.md").is_file()
    assert not (tmp_path / "results").exists()
