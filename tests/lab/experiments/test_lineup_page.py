"""results/lineup.md is what its table says, and the sparse policies' in results/pareto."""

import shlex
import sys

from lab.experiments.lineup import page, records
from lab.experiments.lineup.design import asked
from tests.paths import ROOT

RESULTS = ROOT / "results"


def test_the_page_is_made_of_the_table(monkeypatch):
    text = (RESULTS / "lineup.md").read_text("utf-8")
    command = next(shlex.split(line) for line in text.splitlines() if line.startswith("    "))
    monkeypatch.setattr(sys, "argv", command)
    rows = records.read(RESULTS / "lineup.csv")
    assert page.text(asked({}), rows, RESULTS / "pareto") == text
