"""Notebooks hold what their pages say, and run from top to bottom."""

import json
import os
import re
import subprocess
import sys

import pytest

from tests.paths import ROOT
from tests.project.notebooks import FILES, text
from tests.project.test_docs import checkout  # noqa: F401  the folder of the reader
from tests.project.tutorials import missing, short

_RUN = """
import sys, nbformat, nbclient
file = sys.argv[1]
notebook = nbformat.read(file, 4)
nbclient.NotebookClient(notebook, timeout=500, kernel_name="python3").execute()
nbformat.write(notebook, file)
"""


@pytest.mark.parametrize("name", FILES)
def test_a_notebook_is_its_page(name):
    """Written anew by `python -m tests.project.notebooks`."""
    assert FILES[name].read_text("utf-8") == text(name)


@pytest.mark.parametrize("name", FILES)
def test_links_of_a_notebook_lead_somewhere(name):
    links = re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", _markdown(json.loads(text(name))))
    near = [link for link in links if "://" not in link]
    assert [link for link in near if not (FILES[name].parent / link).exists()] == []


@pytest.mark.parametrize("name", FILES)
def test_a_notebook_runs_and_prints_what_it_shows(name, checkout, monkeypatch):  # noqa: F811
    for module in ("nbclient", "ipykernel"):
        pytest.importorskip(module, reason=f"needs {module}: pip install -e '.[docs]'")
    program = checkout / "bin/spikedeploy"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m spikedeploy "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("COLUMNS", "120")
    shown = json.loads(text(name))
    quick = {**shown, "cells": [_quick(cell) for cell in shown["cells"]]}
    (checkout / "page.ipynb").write_text(json.dumps(quick), encoding="utf-8")
    subprocess.run([sys.executable, "-c", _RUN, "page.ipynb"], check=True, cwd=checkout)
    run = json.loads((checkout / "page.ipynb").read_text("utf-8"))
    for before, after in zip(shown["cells"], run["cells"], strict=True):
        wanted, found = _printed(before), _printed(after)
        assert missing(wanted, found) is None, found


def _quick(cell):
    """A cell, whose trainings take seconds."""
    lines = cell["source"].split("\n")
    commands = [
        f"!{short(line[1:])}" if line.startswith("!spikedeploy train ") else line for line in lines
    ]
    return {**cell, "source": "\n".join(commands), **({"outputs": []} if "outputs" in cell else {})}


def _markdown(notebook):
    return "\n".join(c["source"] for c in notebook["cells"] if c["cell_type"] == "markdown")


def _printed(cell):
    return "".join("".join(each.get("text", "")) for each in cell.get("outputs", []))
