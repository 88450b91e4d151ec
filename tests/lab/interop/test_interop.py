"""`python -m lab interop`: what it asks, keeps, compares and writes; no other tool is needed."""

import json
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from lab.interop import cases
from lab.interop.cases import (
    FOR,
    PEERS,
    PLAIN,
    answers,
    case,
    compare,
    measure,
    pythons,
    versions,
)
from lab.interop.page import page
from spikedeploy.runtime.artifact.artifact import save
from tests.networks import popsan

OWN = f"nir=={version('nir')}"
EQUAL = {"compared": 25, "differ": 0, "first": None, "output": "equal"}
TOOL = {peer.name: peer for peer in PEERS}


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save(popsan(), "policy.nir")
    return Path("policy.nir")


def layers(**changed):
    found = {"a": np.zeros((5, 3)), "b": np.zeros((5, 2)), "output": np.ones((5, 2))}
    return {**found, **changed}


def late(width, timestep):
    """Spikes (5, width): one, in that timestep."""
    return np.eye(1, 5 * width, timestep * width).reshape(5, width)


RENAMED = {"n00_a": np.zeros((5, 3)), "n00_b": np.zeros((5, 2)), "output": np.ones((5, 2))}


@pytest.mark.parametrize(
    ("theirs", "found"),
    [
        (layers(output=np.ones((5, 2)) + 1e-6), EQUAL),
        (RENAMED, EQUAL),  # names of the tool need not be ours
        (layers(a=late(3, 4), b=late(2, 2)), EQUAL | {"differ": 2, "first": [2, "b", 0]}),
        (layers(output=np.zeros((5, 3))), EQUAL | {"output": "another shape"}),
        (layers(output=np.zeros((5, 2))), EQUAL | {"output": "differs"}),
    ],
)
def test_layers_are_compared_in_their_order_and_the_first_difference_is_the_earliest(theirs, found):
    assert compare(theirs, layers()) == found


def test_a_missing_tool_is_a_row_and_a_measured_one_is_kept(file, monkeypatch):
    said, places = [], {OWN: Path(sys.executable)}
    rows = measure([file], places, Path("found.json"), said.append)
    opened = [row for row in rows if row["opens"]]
    assert {row["peer"] for row in opened} == {OWN}
    assert len(said) == 1
    assert all("same after write and read" in row["message"] for row in opened)
    monkeypatch.setattr(cases, "answers", None)  # nobody is asked again
    assert measure([file], places, Path("found.json"), said.append) == rows
    save(popsan(seed=1), file)
    with pytest.raises(TypeError):
        measure([file], places, Path("found.json"), said.append)


def test_the_page_says_what_came_of_each_case(file):
    rows = measure([file], {}, Path("found.json"), print)
    assert page(rows, "python -m lab interop").count("not installed") >= 8
    equal = compare(layers(), layers())
    other = compare(layers(a=np.ones((5, 3))), layers())
    norse = [row for row in rows if row["peer"] == "norse"]
    norse[0] |= {"opens": True, "meant": other, "like": other, "versions": {"norse": "1.1.0"}}
    norse[1] |= {"opens": True, "meant": equal, "like": equal}
    text = page(rows, "python -m lab interop policy.nir -o x.md")
    assert "python -m lab interop policy.nir -o x.md" in text
    assert "opens, 15 of 25 differ, first in timestep 0, `a`, neuron 0" in text
    assert "; from `--like` 15 do" in text
    assert "**equal**, 25 compared" in text
    assert "Releases: norse 1.1.0." in text
    assert "Not opened here: it asks for an older `nir`, and for samna." in text


def test_the_page_counts_the_files_of_which_a_tool_computes_every_spike(file):
    rows = measure([file], {}, Path("found.json"), print)
    equal, other = (compare(layers(**a), layers()) for a in ({}, {"a": np.ones((5, 3))}))
    for row, found in zip([r for r in rows if r["peer"] == "norse"], (other, equal), strict=True):
        row |= {"opens": True, "meant": found, "like": found, "versions": {"norse": "1.1.0"}}
    text = page(rows, "python -m lab interop policy.nir -o x.md")
    assert "| Norse | 1 of 1 | 0 of 1 | 1 of 1: `policy.nir` |" in text
    assert "| snnTorch | " not in text  # not installed


def test_a_case_that_cannot_be_written_is_refused_in_words(file, tmp_path):
    found = case(file, TOOL["rockpool"], FOR, tmp_path)
    assert found.path is None
    assert found.refused.startswith("--for rockpool: its neurons reset by 'subtract'")
    assert case(file, TOOL["rockpool"], PLAIN, tmp_path).path == file


def test_sinabs_and_samna_are_never_asked(file):
    assert TOOL["sinabs"].missing
    places = {"sinabs": Path(sys.executable)}
    rows = measure([file], places, Path("found.json"), print)
    assert all(row["opens"] is None for row in rows if row["peer"] == "sinabs")


def test_pythons_are_found(tmp_path):
    found = tmp_path / "norse" / "bin"
    found.mkdir(parents=True)
    (found / "python").write_text("")
    assert pythons(tmp_path) == {"norse": found / "python", OWN: Path(sys.executable)}


def test_a_python_without_the_tool_is_as_none():
    assert versions(TOOL["spikingjelly"], Path(sys.executable)) == {}


def test_a_process_that_ends_early_refuses_the_rest(monkeypatch):
    monkeypatch.setattr(cases, "_ask", lambda *_: '{"opens": true, "message": ""}\n')
    said = list(answers(TOOL["norse"], Path(sys.executable), [{}, {}]))
    assert [answer["opens"] for answer in said] == [True, False]
    assert "ended" in said[1]["message"]


def test_the_command_writes_a_page(lab, file):
    assert lab("interop", "policy.nir", "--folder", "none", "-o", "page.md")[0] == 0
    assert "policy.nir" in Path("page.md").read_text("utf-8")
    code, _, err = lab("interop", "policy.onnx", "-o", "page.md")
    assert (code, "no .nir file" in err) == (2, True)


def test_the_page_in_the_documentation_is_that_of_its_records():
    """Written by `python -m lab interop`, and not by hand."""
    root = Path(__file__).parents[3]
    text = (root / "results/interop.md").read_text("utf-8")
    rows = json.loads((root / "results/interop.json").read_text("utf-8"))
    command = next(line for line in text.splitlines() if line.startswith("python -m lab interop"))
    assert page(rows, command) == text


@pytest.mark.parametrize("content", [b"", b"[" * 50_000, b"[3]"])
def test_records_that_are_not_ours_are_refused(content, lab, file):
    Path("x.json").write_bytes(content)
    code, _, err = lab("interop", "policy.nir", "-o", "page.md", "--records", "x.json")
    assert (code, "--records x.json" in err) == (2, True)
    assert Path("x.json").read_bytes() == content
