"""Tests of the lab: `./spike test --lab`, not in the default run."""

import os
import sys
from pathlib import Path

import pytest

from lab.__main__ import main
from tests.paths import ROOT

# jobs of experiments are processes that import lab, in whatever folder they run
os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
HERE = Path(__file__).parent


def pytest_collection_modifyitems(items):
    """Mark the tests of this folder."""
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.lab)


@pytest.fixture
def lab(monkeypatch, capsys):
    """Run `python -m lab …`; its exit code, stdout and stderr."""

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["python -m lab", *map(str, words)])
        try:
            code = main()
        except SystemExit as stop:
            code = stop.code
        out, err = capsys.readouterr()
        return code or 0, out, err

    return call
