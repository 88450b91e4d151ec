"""Pages of results/ are what their tables say, to the last digit; nothing is trained or played."""

import shlex
import shutil
import sys

import pytest

from lab.experiments import chip_policies, clocks
from lab.experiments.runner import design_class
from spikedeploy.runtime.artifact.artifact import load
from tests.lab.versions import without_version
from tests.paths import ROOT

RESULTS = ROOT / "results"


@pytest.mark.parametrize(
    ("name", "options"),
    [("lineup", {}), ("pareto", {"env": "kart-grid"}), ("robustness", {"env": "hexapod"})],
)
def test_the_page_of_an_experiment_is_made_of_its_tables(name, options, monkeypatch, tmp_path):
    text = (RESULTS / f"{name}.md").read_text("utf-8")
    command = next(shlex.split(line) for line in text.splitlines() if line.startswith("    python"))
    monkeypatch.setattr(sys, "argv", command)
    for path in (*RESULTS.glob(f"{name}.*"), RESULTS / name, RESULTS / "pareto"):
        if path.is_file():
            shutil.copy(path, tmp_path)
        elif path.is_dir():
            shutil.copytree(path, tmp_path / path.name, dirs_exist_ok=True)
    design_class(name).of({**options, "runs": str(tmp_path / "none")}).write(tmp_path)
    assert without_version((tmp_path / f"{name}.md").read_text("utf-8")) == without_version(text)


def test_the_page_of_clocks_is_made_of_its_table():
    found = clocks.read(RESULTS / "clocks.csv")
    assert {row["task"] for row in found} == set(clocks.FLOATS)
    made = clocks.page(found, found[0]["episodes"])
    assert made == (RESULTS / "clocks.md").read_text("utf-8")


def test_the_page_of_chips_is_made_of_its_table():
    made = chip_policies.page(chip_policies.read(chip_policies.TABLE))
    assert made == chip_policies.PAGE.read_text("utf-8")


def test_the_table_counts_the_trainings_whose_policies_are_shipped_with_it():
    for row in clocks.read(RESULTS / "clocks.csv"):
        if row["clock"] == "pipelined":
            middle = "-tuned" if "reward" in row["kind"] else ""
            files = list((RESULTS / "clocks").glob(f"{row['task']}{middle}-s*.nir"))
            assert len(files) == row["trainings"] == len(row["each"].split())
            assert all(load(file).convention.clock == "pipelined" for file in files)


def test_rows_that_stay_are_of_as_many_episodes_as_the_page_says(tmp_path, monkeypatch, capsys):
    shutil.copy(RESULTS / "clocks.csv", tmp_path)
    words = ["clocks.py", "kart-grid", "--episodes", "2", "-o", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit):
        clocks.main()
    assert "rows that stay are of 100 episodes: --episodes 100" in capsys.readouterr().err
