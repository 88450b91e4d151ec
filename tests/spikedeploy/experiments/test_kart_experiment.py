"""The kart experiment: what belongs to it, what its page says, what is left to do."""

import csv
import json
import sys

import numpy as np
import pytest

from spikedeploy import cli
from spikedeploy.experiments import kart_page, workers
from spikedeploy.experiments.kart import experiment
from spikedeploy.experiments.kart_design import WORLDS, ExperimentDesign
from spikedeploy.experiments.kart_page import verdicts
from spikedeploy.experiments.kart_plot import counted, draw
from spikedeploy.experiments.kart_records import NTH, learning
from spikedeploy.experiments.kart_tables import learning_table, percent_of_ann, steps
from spikedeploy.experiments.trial import Trial
from spikedeploy.experiments.workers import JobEnd
from spikedeploy.files import write_text
from spikedeploy.runtime.errors import ConfigError
from tests import toy_race_env

NUMBERS = {
    "episodes": 100, "lap_time": 7.5, "crashes": 0.02, "stalls": 0.0, "gates": 7.9,
    "return_mean": 20.0, "macs_dense": 1000.0, "energy_per_inference_j": {"horowitz45": 1e-7},
}  # fmt: skip


@pytest.fixture(autouse=True)
def _race(monkeypatch):
    toy_race_env.install(monkeypatch, *WORLDS)


@pytest.fixture
def design(tmp_path):
    return ExperimentDesign(seeds=2, controls=1, folder=str(tmp_path / "runs"))


@pytest.fixture
def pretend(monkeypatch):
    """Let every job leave at once what it would after hours; the names of those that ran."""
    ran = []
    monkeypatch.setattr(kart_page, "draw", lambda design, path: write_text(path, "picture"))

    def run(jobs, count, ended, look=None):
        for job in jobs:
            ran.append(job.name)
            if "recipe" in job.arguments:
                leave(Trial(**job.arguments))
            else:
                leave_drive(job.arguments)
            ended(JobEnd(job, 1.0, 0))
        return True

    monkeypatch.setattr(workers, "run", run)
    return ran


def driven(chip=None, rate=0.98, **changes):
    return {**NUMBERS, "chip": chip, "success_rate": rate, **changes}


def leave(trial, first=1_000, gap=1_000):
    """What a complete trial leaves: a finish every `gap` steps, the SNN's twice as far apart."""
    snn = trial.recipe.endswith("snn")
    gap, run = gap * (2 if snn else 1), trial.run
    if run is None:
        from spikedeploy.trainers.run_folder import RunFolder

        run = RunFolder.create(trial.folder, trial.config).path
    ends = [first + trial.seed + gap * k for k in range(300)]
    text = "".join(f"{end},1\n" for end in ends)
    (run / "episodes.csv").write_text("env_steps,finish\n" + text)
    (run / "checkpoints/last.json").write_text(
        json.dumps({"env_steps": ends[-1], "finishes": len(ends)})
    )
    rows = [driven()]
    if snn:
        beside = {"success_difference_mean": -0.01, "actions_equal": 0.97}
        rows = [driven("float"), driven("loihi1", 0.97, sops_per_inference=2000.0, **beside)]
    found = {"of": trial.evaluated_with, "parameters": 25_000, "rows": rows}
    (run / "evaluation.json").write_text(json.dumps(found))


def leave_drive(arguments):
    from spikedeploy.experiments.evaluation import BuiltInEvaluation

    drive = BuiltInEvaluation(**arguments)
    found = {"of": {"episodes": drive.episodes}, "rows": [driven(rate=0.1)]}
    write_text(drive.file, json.dumps(found))


def table(page, title):
    """The cells of the first table below a headline."""
    lines = page.split(f"## {title}")[1].split("\n## ")[0].split("\n")
    return [[c.strip() for c in line.strip("|").split("|")] for line in lines if line[:1] == "|"]


def test_every_world_is_seen_early_and_the_controls_come_last(design):
    names = [trial.name for trial in design.trials()]
    assert names[:3] == ["kart-grid-ann-s0", "kart-grid-snn-s0", "kart-gazebo-ann-s0"]
    assert names[6] == "kart-grid-ann-s1"
    assert names[-2:] == ["kart-steer-small-s0", "kart-steer-linear-s0"]
    assert len(names) == 2 * 6 + 1 * 6
    assert [drive.name for drive in design.built_in()] == [f"{w}-random" for w in WORLDS]


def test_a_setting_that_some_trainings_lack_is_refused_before_any_begins(tmp_path, pretend):
    # spikes can be drawn by chance; a float network has none
    odd = ExperimentDesign(1, 1, str(tmp_path / "runs"), overrides=("policy.coding=bernoulli",))
    with pytest.raises(ConfigError, match=r"kart-grid-ann-s0: .*policy"):
        experiment(odd, (), 1, tmp_path / "results")
    assert pretend == []
    assert not (tmp_path / "results").exists()


def test_the_whole_experiment_is_done_once(design, pretend, tmp_path):
    outcome = experiment(design, (), 2, tmp_path / "results")
    assert (outcome.done, outcome.of, outcome.failed) == (21, 21, {})
    assert len(pretend) == 21
    assert all(path.is_file() for path in outcome.files)
    before = outcome.files[0].read_text()
    again = experiment(design, (), 2, tmp_path / "results")
    assert (again.done, len(pretend)) == (21, 21)  # nothing was left to do
    assert again.files[0].read_text() == before


def test_parts_are_chosen_by_the_beginnings_of_their_names(design, pretend, tmp_path):
    outcome = experiment(design, ["kart-grid-snn", "kart-steer-ann-s1"], 2, tmp_path)
    assert pretend == ["kart-grid-snn-s0", "kart-grid-snn-s1", "kart-steer-ann-s1"]
    assert outcome.done == 3
    assert "**3 of 21 parts are complete.**" in outcome.files[0].read_text()
    with pytest.raises(ConfigError, match=r"begins with 'kart-grit'; known: kart-grid-ann"):
        experiment(design, ["kart-grit"], 2, tmp_path)


def test_the_page_alone_trains_nothing(design, pretend, tmp_path):
    outcome = experiment(design, (), 2, tmp_path, train=False)
    assert (outcome.done, pretend) == (0, [])
    assert "**0 of 21 parts are complete.**" in outcome.files[0].read_text()


def test_a_part_that_fails_is_named_with_its_last_words(design, monkeypatch, tmp_path):
    def run(jobs, count, ended, look=None):
        jobs[0].log.parent.mkdir(parents=True)
        jobs[0].log.write_text("a long story\nerror: no memory\n")
        ended(JobEnd(jobs[0], 1.0, 1))
        return True

    monkeypatch.setattr(workers, "run", run)
    outcome = experiment(design, ["kart-grid-ann-s0"], 1, tmp_path)
    assert outcome.failed == {"kart-grid-ann-s0": "error: no memory"}


def test_the_page_says_how_soon_they_finish_beside_kart_simulator(design, pretend, tmp_path):
    page = experiment(design, (), 2, tmp_path).files[0].read_text()
    cells = table(page, "How soon they finish")
    assert cells[0][3:6] == ["first finish", "300 finishes", "% of ANN"]
    assert cells[2][:6] == [
        "kart-grid", "ann", "2", "1k [1k, 1k]", "300k [300k, 300k]", "–",
    ]  # fmt: skip
    assert cells[3][4:] == [
        "599k [599k, 599k]", "50.1% [50%, 50%]", "175k", "406k", "99.0%",
    ]  # fmt: skip


def test_the_page_says_how_well_each_of_them_drives(design, pretend, tmp_path):
    page = experiment(design, (), 2, tmp_path).files[0].read_text()
    drivers = [row[1] for row in table(page, "How well they drive")[2:8]]
    assert drivers == ["ann", "snn · float", "snn · loihi1", "small", "linear", "random"]
    ann = table(page, "How well they drive")[2]
    assert ann[2:7] == ["2", "25,000", "98% [98%, 98%]", "7.50", "2%"]
    chip = table(page, "The chip beside its float twin")
    assert chip[2] == ["kart-grid", "0", "98%", "97%", "-1", "97.0%"]


def test_the_page_says_plainly_what_was_not_reached(design, pretend, tmp_path):
    page = experiment(design, (), 2, tmp_path).files[0].read_text()
    assert "- ✓ kart-grid, ann: 300 finishes after 300k steps (median), kart-simulator 402k" in page
    assert "- ✗ kart-grid, snn: 300 finishes after 599k steps (median)" in page
    assert "- ✗ kart-grid: the SNN reaches 50% of the ANN (asked for 95%)" in page
    assert "- ✓ kart-grid: chip and float twin differ by up to 1 points" in page


def test_the_tables_are_written_in_full_as_csv(design, pretend, tmp_path):
    experiment(design, (), 2, tmp_path)
    rows = {
        name: list(csv.DictReader((tmp_path / f"kart/{name}.csv").read_text().splitlines()))
        for name in ("learning", "driving", "finishes")
    }
    assert len(rows["learning"]) == 18
    assert len(rows["finishes"]) == 18 * 300
    assert len(rows["driving"]) == 18 + 6 + 3  # spiking ones have two rows, built-in ones one
    assert rows["learning"][0][NTH] == "300000"


def test_a_training_that_never_came_so_far_counts_as_longer_than_its_budget():
    never = float("inf")
    assert steps([1_000, 2_000, never], 500_000) == "2k [1k, > 500k]"
    assert steps([never, never, 1_000], 500_000) == "> 500k [1k, > 500k]"
    rows = [
        {"world": "kart-grid", "policy": policy, NTH: value, "first_finish": 1.0}
        for policy, value in [("ann", 100.0), ("snn", 200.0), ("snn", never), ("snn", 100.0)]
    ]
    assert percent_of_ann(rows, "kart-grid") == "50.0%"  # without an interval
    assert percent_of_ann(rows[:1], "kart-grid") == "–"
    assert "needs" not in "".join(verdicts(rows, []))
    budgets = {(world, policy): 500_000 for world in WORLDS for policy in ("ann", "snn")}
    assert any("> 500k" in line for line in learning_table(rows, budgets))


def test_the_picture_has_a_panel_for_each_world(design, pretend, tmp_path):
    experiment(design, ["kart-grid"], 1, tmp_path)  # the other panels have nothing to show yet
    assert draw(design, tmp_path / "finishes.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_not_trained_to_its_end_is_not_counted(design, pretend, tmp_path):
    experiment(design, ["kart-grid-ann-s0"], 1, tmp_path)
    (trial,) = [trial for trial in design.trials() if trial.run]
    assert len(learning(design)) == 1
    (trial.run / "checkpoints/last.json").write_text('{"env_steps": 5, "finishes": 0}')
    assert learning(design) == []


def test_lines_are_medians_up_to_where_every_run_tells():
    runs = [np.arange(1, 301) * 10.0, np.arange(1, 101) * 20.0]
    grid, counts = counted(runs, [3000.0, 2500.0])
    assert grid[-1] == 2500  # where the run that never reached 300 ends
    assert counts[:, -1].tolist() == [250, 100]
    grid, counts = counted(runs[:1], [9000.0])
    assert (grid[-1], counts[0, -1]) == (3000, 300)


def test_the_command_tells_machines_and_people(design, pretend, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    words = ("experiment", "kart", "--seeds", "1", "--controls", "0", "--only", "kart-grid")
    for extra in (("--json",), ()):
        monkeypatch.setattr(sys, "argv", ["spikedeploy", *words, *extra])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        assert not stop.value.code
    first, _, rest = capsys.readouterr().out.rpartition("}\n")
    assert json.loads(first + "}")["done"] == 3
    assert rest.startswith("3 of 9 parts are complete: results/kart.md")
    monkeypatch.setattr(sys, "argv", ["spikedeploy", "experiment", "cart"])
    with pytest.raises(SystemExit):
        cli.main()
    assert "unknown experiment 'cart'; known: kart" in capsys.readouterr().err
