"""Notebooks hold what their pages say, and their first cell what they need."""

import json
import os
from pathlib import Path

import pytest

from tests.lab.notebooks import FILES, text
from tests.paths import ROOT


@pytest.mark.parametrize("name", FILES)
def test_a_notebook_is_its_page(name):
    """Written anew by `python -m tests.lab.notebooks`."""
    assert FILES[name].read_text("utf-8") == text(name)


def begin(name, checkout=""):
    """Run the first cell of code of a notebook in the current folder."""
    cells = json.loads(text(name))["cells"]
    code = next(each["source"] for each in cells if each["cell_type"] == "code")
    exec(code.replace('CHECKOUT = ""', f"CHECKOUT = {str(checkout)!r}"), {})


@pytest.mark.parametrize("name", FILES)
def test_a_copied_notebook_says_what_it_needs_and_finds_the_checkout_it_is_given(
    name, tmp_path, monkeypatch
):
    monkeypatch.setenv("PATH", os.environ["PATH"])
    monkeypatch.chdir(FILES[name].parent)
    begin(name)
    assert Path.cwd() == ROOT
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"needs a checkout of spikedeploy.*CHECKOUT"):
        begin(name)
    assert Path.cwd() == tmp_path
    begin(name, ROOT)
    assert Path.cwd() == ROOT
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spikedeploy").symlink_to(ROOT)
    begin(name)
    assert Path.cwd() == ROOT
