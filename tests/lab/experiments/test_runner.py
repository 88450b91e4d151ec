"""Pages are what their tables say, to the last digit; rows that are there stay."""

from dataclasses import replace

import pytest

from lab.experiments import chips, clocks, digits, energy, own_networks, runner, students
from lab.experiments.runner import Experiment
from spikedeploy.runtime.artifact.artifact import load

EXPERIMENTS = [each.EXPERIMENT for each in (chips, clocks, digits, own_networks, students)]


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda each: each.name)
def test_a_page_is_made_of_its_table(experiment):
    made = experiment.page(experiment.read())
    assert made == (runner.RESULTS / f"{experiment.name}.md").read_text("utf-8")


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda each: each.name)
def test_a_table_has_rows_of_jobs_alone_and_a_second_reading_is_the_same(
    experiment, tmp_path, monkeypatch
):
    rows, jobs = experiment.read(), list(experiment.jobs(5))
    assert {row[experiment.columns[0]] for row in rows} == {job[0] for job in jobs}
    monkeypatch.setattr(runner, "RESULTS", tmp_path)
    runner.write_rows(rows, experiment.columns, experiment.table)
    assert experiment.read() == rows


@pytest.fixture
def toy(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "RESULTS", tmp_path)
    measured = []

    def measure(job):
        measured.append(job)
        yield {"task": job[0], "seed": job[1], "scores": [1.0, 2.0]}

    jobs = lambda seeds: [("a", seed) for seed in range(seeds)]  # noqa: E731
    columns = ("task", "seed", "scores")
    return Experiment("toy", columns, ("task",), jobs, measure, lambda rows: {}), measured


def test_what_is_missing_is_measured_once(toy):
    experiment, measured = toy
    assert list(experiment.fill([("a", 0)])) == [("a", 0)]
    list(experiment.fill([("a", 0), ("a", 1)]))
    assert measured == [("a", 0), ("a", 1)]
    assert [row["scores"] for row in experiment.read()] == [[1.0, 2.0]] * 2
    list(experiment.fill([("a", 0)], again=True))
    stale = replace(experiment, is_current=lambda row: row["seed"] == 0)
    list(stale.fill([("a", 0), ("a", 1)]))
    assert measured[2:] == [("a", 0), ("a", 1)]
    assert len(experiment.read()) == 2


def test_a_command_measures_the_jobs_that_it_is_asked_for(toy, monkeypatch, capsys):
    experiment, measured = toy
    monkeypatch.setattr(runner, "render", lambda name, **facts: f"page of {name}\n")
    monkeypatch.setattr("sys.argv", ["toy", "--only", "a/1", "--seeds", "2"])
    experiment.main()
    assert measured == [("a", 1)]
    assert experiment.table.with_suffix(".md").read_text() == "page of toy\n"
    assert capsys.readouterr().out.startswith("a 1\n")


def test_clocks_count_the_trainings_whose_policies_are_shipped_with_them():
    for row in clocks.EXPERIMENT.read():
        if row["clock"] == "pipelined":
            middle = "-tuned" if "reward" in row["kind"] else ""
            files = list((runner.RESULTS / "clocks").glob(f"{row['task']}{middle}-s*.nir"))
            assert len(files) == row["trainings"] == len(row["each"].split())
            assert all(load(file).convention.clock == "pipelined" for file in files)


def test_energies_are_what_the_command_writes_today(tmp_path, monkeypatch):
    before = {
        name: (runner.RESULTS / f"energy.{name}").read_text("utf-8") for name in ("csv", "md")
    }
    monkeypatch.setattr(energy, "RESULTS", tmp_path)
    monkeypatch.setattr("sys.argv", ["energy"])
    energy.main()
    for name, text in before.items():
        assert (tmp_path / f"energy.{name}").read_text("utf-8") == text
