"""The pareto experiment in its smallest size: trained, evaluated, written, resumed."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lab.experiments import networks
from lab.experiments.costs import INT8, LEAN_UPDATE, energies, terms
from lab.experiments.fronts import (
    Point,
    pairing,
    pairing_at,
    points,
    read_table,
    write_table,
)
from lab.experiments.pages import share
from lab.experiments.pareto import FLOAT, LAST, SPIKING, ParetoDesign
from lab.experiments.pareto_page import sentences
from lab.experiments.runner import run_experiment
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.sparse.pool import Walk
from tests.paths import ROOT

ENV = "kart-grid"
SMALLER = (
    "dense_updates=8", "level_updates=8", "polish_updates=4", "validation.every=4",
    "validation.limit=10", "checkpoint_every=4", "log_every=4", "tuned.validation.limit=20",
)  # fmt: skip


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    runs = str(tmp_path_factory.mktemp("pareto") / "runs")
    return ParetoDesign(
        1, runs, SMALLER, episodes=3, limit=12, quick=True, env=ENV, chip_episodes=2
    )


@pytest.fixture(scope="module")
def results(design, ran):
    """The folder of the page of the whole experiment."""
    folder = Path(design.runs).parent / "results"
    outcome = run_experiment(design, (), 1, folder)
    assert (outcome.done, outcome.of, outcome.failed) == (24, 24, {})
    return folder


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rows(results):
    return read_table(results / "pareto" / f"{ENV}.csv")


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
    sparse, *baselines = design.imitations()
    for baseline in baselines:
        settings = json.loads((baseline.run / "config.json").read_text())
        assert settings["pool"] == str(sparse.run)
        assert (settings["teacher_walks"], settings["noisy_walks"]) == (0, 0)
        assert not baseline.changed_settings


def test_every_student_goes_on_with_reward_and_is_one_more_row(design, results):
    rewarded = [row for row in rows(results) if row["trained_by"] == "reward"]
    assert [row["student"] for row in rewarded] == [*SPIKING, *FLOAT]
    assert {(row["level"], row["part"], len(row["scores"])) for row in rewarded} == {
        (60, "levels", 3)
    }
    for tuning in design.tunings():
        settings = json.loads((tuning.run / "config.json").read_text())
        assert settings["start"] == tuning.parents["start"].run.name
        assert settings["validation"]["limit"] == 20
        assert tuning.changed_settings == []
    assert len({tuning.run for tuning in design.tunings()}) == 4
    text = (results / "pareto.md").read_text()
    assert "| LIF, with reward | 60 |" in text
    assert "| float linear, with reward | 60 |" in text


def test_fewer_levels_have_less_to_do_and_keep_the_rows_of_the_others(design, results, tmp_path):
    fewer = replace(design, levels=1)
    (training, *_) = design.imitations()
    assert {row.of["level"] for row in fewer.rows(training, False, 1)} == {"ops-60"}
    lost = Path(design.runs) / "evaluations" / f"{training.name}" / "ops-200@loihi1.json"
    kept = lost.read_bytes()
    lost.unlink()
    outcome = run_experiment(fewer, (), 1, tmp_path)
    assert (outcome.done, outcome.of) == (24, 24)
    assert not lost.exists()
    lost.write_bytes(kept)
    fewer.write(tmp_path)
    table = Path("pareto") / f"{ENV}.csv"
    assert (tmp_path / table).read_bytes() == (results / table).read_bytes()
    text = (tmp_path / "pareto.md").read_text()
    assert "--levels 1" in text
    assert "3 episodes of the last level from seed" in text


def test_a_chip_that_refuses_a_network_is_named_with_its_rule(results):
    refused = [row for row in rows(results) if row["refusal"]]
    assert {(row["student"], row["place"]) for row in refused} >= {("sparse", "xylo-a3")}
    assert all(row["part"] == LAST and row["refusal"].startswith("rule ") for row in refused)
    assert "refused: rule reset" in (results / "pareto.md").read_text()


def test_a_second_run_has_nothing_to_do_and_changes_nothing(design, results, ran):
    before, count = contents(results), len(ran)
    assert run_experiment(design, (), 1, results).done == 24
    assert len(ran) == count
    assert contents(results) == before


def test_a_row_that_is_missing_is_made_again_and_no_other(design, results, ran):
    before = contents(results)
    folder = Path(design.runs) / "evaluations" / "kart-grid-small-mlp-s0"
    lost, kept = folder / "ops-60@int8.json", folder / "ops-200@int8.json"
    lost.unlink()
    age, count = kept.stat().st_mtime_ns, len(ran)
    run_experiment(design, (), 1, results)
    assert ran[count:] == ["kart-grid-small-mlp-s0: levels"]
    assert lost.is_file()
    assert kept.stat().st_mtime_ns == age
    assert contents(results) == before


@pytest.mark.parametrize(
    ("row", "said"), [("x", 'row must be an object, found "x"'), ({}, r"row\.env must be a text")]
)
def test_an_evaluation_of_another_form_is_named(row, said, design, results):
    file = Path(design.runs) / "evaluations" / "kart-grid-small-mlp-s0" / "ops-60@int8.json"
    kept = file.read_bytes()
    file.write_text(json.dumps({**json.loads(kept), "row": row}))
    try:
        with pytest.raises(ConfigError, match=rf"ops-60@int8\.json is damaged: {said}"):
            list(design.all_rows())
    finally:
        file.write_bytes(kept)


def test_the_command_leaves_the_published_page_alone_where_sizes_are_quick(
    design, results, ran, tmp_path, monkeypatch, lab
):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(results / "pareto", tmp_path / "runs/pareto-quick/pareto")
    words = ["experiment", "pareto", ENV, "--quick", "--no-train", "--json"]
    assert lab(*words)[0] == 0
    assert (tmp_path / "runs/pareto-quick/pareto.md").is_file()
    assert not (tmp_path / "results").exists()


# costs

LIF = {
    "operations": 100.0, "bias_operations": 0.0, "neuron_updates": 10.0, "neuron_idle": 4.0,
    "messages": 6.0, "spikes_out": 2.0, "observations": 20.0, "events": 5.0, "constants": 3.0,
}  # fmt: skip
MLP = {"operations": 200.0, "observations": 20.0, "constants": 8.0}


def in_pico(joules):
    return {name: 1e12 * value for name, value in joules.items()}


def test_every_term_of_a_spiking_policy_is_what_the_page_says():
    assert in_pico(terms(LIF, INT8)) == pytest.approx(
        {
            "operations": 100 * 1.35,
            "updates": 10 * 26.5,
            "traffic": 0.0,
            # read the observation, subtract, compare, read the level; add and write an event
            "encoder": 20 * (2.5 + 0.1 + 0.1 + 2.5) + 5 * (0.1 + 2.5),
            "constants": 3 * 1.35,
        }
    )
    lean = in_pico(terms(LIF, INT8, lean=True))["updates"]
    assert lean == pytest.approx(10 * 10.5)
    assert pytest.approx(10.5e-12) == LEAN_UPDATE


def test_an_operation_of_a_graded_spike_costs_a_multiply_accumulate():
    graded = terms({**LIF, "graded_operations": 40.0}, INT8)
    assert in_pico(graded)["operations"] == pytest.approx(60 * 1.35 + 40 * 1.55)
    # tables without a price for it charge an operation
    assert terms({**LIF, "graded_operations": 40.0}, "davies2018") == terms(LIF, "davies2018")


def point(student, score, operations, level=100.0):
    costs = LIF if student.startswith("sparse") else MLP
    row = {**costs, "student": student, "operations": operations, "scores": [score, score]}
    return Point([row | {"level": level, "place": "here"}], [10.0, 10.0])


def test_a_baseline_is_the_cheapest_float_student_that_is_not_below():
    mine = point("sparse", 9.8, 50.0)
    found = [
        mine, point("small-mlp", 10.0, 300.0), point("small-linear", 9.9, 250.0),
        point("small-linear", 9.7, 100.0),
    ]  # fmt: skip
    pair = pairing(found, mine, "operations")
    assert pair.baseline is found[2]
    assert pair.ratio == pytest.approx(50 * 1.35 / (250 * 1.55))
    assert pairing(found, point("sparse", 10.1, 50.0), "operations").ratio is None


def test_sentences_say_who_wins_and_which_term_decides():
    found = [point("sparse", 9.9, 50.0), point("small-mlp", 10.0, 100.0)]
    alone, updates, *_ = sentences(found)
    assert alone == (
        "- ✓ Operations alone: for 98% of the teacher's score LIF at 100 (99.0%) costs 68 pJ, "
        "float MLP at 100 (100.0%) 155 pJ: 0.44 times; for 95% of the teacher's score LIF at 100 "
        "(99.0%) costs 68 pJ, float MLP at 100 (100.0%) 155 pJ: 0.44 times."
    )
    # 155 - 67.5 = 87.5 of the 265 pJ of updates
    assert updates.startswith("- ✗ With neuron updates")
    assert (
        "80% of the first is for the neuron updates; it would draw level if that cost 0.33"
        in updates
    )
    alone = point("sparse", 9.9, 50.0)
    assert "no float student is evaluated yet" in sentences([alone])[0]
    worse = sentences([alone, point("small-mlp", 9.6, 50.0)])[0]
    assert "LIF at 100 (99.0%) costs 68 pJ, no float student is good enough; for 95%" in worse
    nothing = sentences([alone, point("small-mlp", 9.4, 50.0)])
    assert "no float student reaches the return of a spiking one" in nothing[0]


def test_robots_at_their_end_are_not_counted():
    counts = np.zeros((3 * 2, 1, len(EVENTS)), np.int64)  # three control steps of two robots
    counts[:, 0, EVENTS.index("sop")] = [1, 10, 1, 1000, 1, 1000]
    counts[:, 0, EVENTS.index("graded_sop")] = [0, 4, 0, 1000, 0, 1000]
    ledger = Ledger(("out",), (4,), counts, 6, 6, 6, readouts=("out",))
    layer = SimpleNamespace(name="out", synapses=(), size=4)
    program = SimpleNamespace(
        layers=(layer,), spiking=(), input="in", readout=None, outlets=(), host=()
    )
    spiking = SimpleNamespace(ledger=ledger, program=program)
    walks = [Walk(np.zeros((n, 1), np.float32), np.zeros((n, 0), np.float32)) for n in (3, 1)]
    found = networks._chip_counts(spiking, 2, walks)
    assert found["operations"] == (1 + 1 + 1 + 10) / 4
    assert found["graded_operations"] == 4 / 4
    assert found["sparsity"] is None
    assert found["observations"] == 2


def test_a_teacher_that_scores_nothing_leaves_no_share():
    beside = point("sparse", 1.0, 50.0)
    nothing = Point(beside.rows, [0.0, 0.0])
    assert math.isnan(nothing.of_teacher.mean)
    assert share(nothing.of_teacher) == "–"


def test_a_baseline_with_reward_counts_and_is_named(tmp_path):
    def row(student, score, operations, **more):
        costs = LIF if student.startswith("sparse") else MLP
        return {
            **costs, "student": student, "operations": operations, "scores": [score, score],
            "level": 60.0, "place": "here", "part": "levels", **more,
        }  # fmt: skip

    rows = [
        {"student": "teacher", "scores": [10.0, 10.0]},
        row("sparse", 9.7, 90.0),
        row("sparse", 9.9, 80.0, trained_by="reward"),
        row("small-mlp", 9.6, 100.0, trained_by="imitation"),
        row("small-mlp", 9.9, 110.0, trained_by="reward"),
    ]
    found = points(read_table(write_table(rows, tmp_path / "rows.csv")))
    assert [each.label for each in found] == [
        "LIF", "LIF, with reward", "float MLP", "float MLP, with reward",
    ]  # fmt: skip
    best = pairing_at(found, 0.98, "operations")
    assert (best.point, best.baseline) == (found[1], found[3])
    assert "LIF, with reward at 60 (99.0%) costs" in sentences(found)[0]


@pytest.mark.parametrize(
    "path", sorted((ROOT / "results/pareto").glob("*.csv")), ids=lambda p: p.stem
)
def test_published_energies_follow_from_the_published_counts(path):
    rows = read_table(path)
    for row in rows:
        for name, joules in energies(row).items():
            # both are rounded to ten digits
            assert row[name] == pytest.approx(joules, rel=1e-9)
    assert sum(bool(energies(row)) for row in rows) > 10
