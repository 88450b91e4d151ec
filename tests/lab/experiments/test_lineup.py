"""The lineup experiment in its smallest size: what is shipped, and the same trained again."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.experiments import lineup
from lab.experiments.lineup import LineupDesign, read_table
from lab.experiments.runner import run_experiment
from spikedeploy.runtime.errors import ConfigError
from tests.paths import ROOT

ENV, RESULTS = "hexapod-command", ROOT / "results"
TEACHERS = {"fourier": "smooth", "linear": "sac"}


@pytest.fixture(scope="module", autouse=True)
def _two_policies():
    every = lineup._distilled
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            lineup,
            "_distilled",
            lambda env: {n: c for n, c in every(env).items() if n in TEACHERS},
        )
        yield


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    runs = str(tmp_path_factory.mktemp("lineup") / "runs")
    return LineupDesign(2, runs, episodes=2, quick=True, tasks=(ENV,))


@pytest.fixture(scope="module")
def results(design, ran):
    folder = Path(design.runs).parent / "results"
    outcome = run_experiment(design, (), 1, folder)
    assert (outcome.done, outcome.of, outcome.failed) == (6, 6, {})
    return folder


def rows(results):
    return read_table(results / "lineup.csv")


def test_shipped_policies_are_evaluated_and_the_other_seeds_trained(results, ran):
    assert ran == [
        f"{ENV}-{name}"
        for name in ("smooth-s0", "sac-s0", "fourier-s0", "linear-s0", "fourier-s1", "linear-s1")
    ]
    shipped = {(row["policy"], row["seed"]) for row in rows(results) if row["shipped"]}
    assert shipped == {("smooth", 0), ("sac", 0), ("fourier", 0), ("linear", 0)}


def test_the_page_has_a_row_a_policy_and_what_is_smallest(results):
    text = (results / "lineup.md").read_text(encoding="utf-8")
    (linear,) = (line for line in text.splitlines() if line.startswith("| linear |"))
    mean = np.mean([row["return_mean"] for row in rows(results) if row["policy"] == "linear"])
    assert "| 2 |" in linear
    assert f"| {mean:,.0f} [" in linear
    assert "The smallest of these float policies not shown to earn less than `sac` is" in text
    assert "of 2 shipped float policies earn more than the mean of their trainings." in text
    assert "missing" not in text


def test_rows_of_trainings_elsewhere_are_kept(design, results, tmp_path):
    other = replace(design, runs=str(tmp_path / "none"))
    copy = tmp_path / "results"
    copy.mkdir()
    (copy / "lineup.csv").write_bytes((results / "lineup.csv").read_bytes())
    other.write(copy)
    assert (copy / "lineup.csv").read_bytes() == (results / "lineup.csv").read_bytes()
    with (copy / "lineup.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 6


def test_rows_of_other_sizes_are_not_written_over(design, results):
    before = {path: path.read_bytes() for path in results.iterdir()}
    for changed in ({"episodes": 3}, {"quick": False}):
        with pytest.raises(
            ConfigError, match=r"lineup\.csv has rows of 2 episodes, of quick .* -o"
        ):
            run_experiment(replace(design, **changed), (), 1, results, train=False)
    assert {path: path.read_bytes() for path in results.iterdir()} == before


def test_a_damaged_table_is_named_before_anything_is_done(design, results, tmp_path):
    written = (results / "lineup.csv").read_text(encoding="utf-8")
    for text in (written[:-40], written.replace('"[', '"x', 1), f"{written}a,b", "a,b\n1,2\n"):
        (tmp_path / "lineup.csv").write_text(text, encoding="utf-8")
        with pytest.raises(ConfigError, match=r"lineup\.csv is damaged .*: put it back, or move"):
            run_experiment(design, (), 1, tmp_path)
        assert (tmp_path / "lineup.csv").read_text(encoding="utf-8") == text
