"""results/clocks.md is what `python -m lab clocks` makes of its table; the policies are there."""

import shutil
import sys

import pytest

from lab.experiments import clocks
from lab.experiments.clocks import REFERENCES, page, read
from spikedeploy.runtime.artifact.artifact import load
from tests.paths import ROOT

RESULTS = ROOT / "results"


def test_the_page_is_made_from_its_table():
    found = read(RESULTS / "clocks.csv")
    assert {row.task for row in found} == set(REFERENCES)
    assert page(found, found[0].episodes) == (RESULTS / "clocks.md").read_text(encoding="utf-8")


def test_the_table_counts_the_trainings_whose_policies_are_shipped_with_it():
    for row in read(RESULTS / "clocks.csv"):
        if row.clock == "pipelined":
            middle = "-tuned" if "reward" in row.kind else ""
            files = list((RESULTS / "clocks").glob(f"{row.task}{middle}-s*.nir"))
            assert len(files) == row.trainings == len(row.each.split())
            assert all(load(file).convention.clock == "pipelined" for file in files)


def test_rows_that_stay_are_of_as_many_episodes_as_the_page_says(tmp_path, monkeypatch, capsys):
    shutil.copy(RESULTS / "clocks.csv", tmp_path)
    words = ["clocks.py", "kart-grid", "--episodes", "2", "-o", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit):
        clocks.main()
    assert "rows that stay are of 100 episodes: --episodes 100" in capsys.readouterr().err
