"""Every golden trace can be recorded again: its tool has a generator, which runs where it can."""

import json
import subprocess
import sys
from importlib.util import find_spec

import pytest

from lab.peers.record_traces import (
    count,
    differences,
    golden_traces,
    merge,
    tool,
)
from tests.paths import ROOT

TRACES = golden_traces()
# tools that run beside the current NumPy, and the packages that they need
HERE = {"xylosim": "xylosim", "nengo_loihi": "nengo_loihi", "sanafe": "sanafe"}


def recorded(*words):
    """The generators' run in a process of its own: tools warn, and print past Python."""
    command = [sys.executable, "-m", "lab", "record-traces", *map(str, words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("path", TRACES, ids=lambda path: path.stem)
def test_every_golden_trace_has_a_generator(path):
    name = tool(json.loads(path.read_text("utf-8")))
    assert (ROOT / "lab/peers/traces" / f"{name}.py").is_file()


@pytest.mark.parametrize("name", HERE)
def test_a_golden_trace_recorded_again_is_the_same_in_every_number(name, tmp_path):
    if find_spec(HERE[name]) is None:
        pytest.skip(f"{name} is not installed; ./spike test --peers compares with it")
    done = recorded("--tool", name, "--out", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    written = sorted(tmp_path.glob("*.json"))
    assert len(written) == len([p for p in TRACES if tool(json.loads(p.read_text())) == name])
    for path in written:
        (golden,) = (p for p in TRACES if p.name == path.name)
        old, new = json.loads(golden.read_text()), json.loads(path.read_text())
        assert {**new, "source": ""} == {**old, "source": ""}
        assert name.partition("_")[0] in new["source"]


def test_differences_are_found_in_any_depth():
    old = {"a": [{"b": [1, 2]}, {"b": [3]}], "c": 4}
    assert list(differences(old, {"a": [{"b": [1, 2]}, {"b": [3]}]})) == []
    assert list(differences(old, {"a": [{"b": [1, 0]}, {"b": [3]}]})) == ["a 0 b 1 was 2, is 0"]
    assert list(differences(old, {"c": [4]})) == ["c was 4, is [4]"]
    assert list(differences(old, {"d": 4})) == ["d is not in the file"]
    assert list(differences(old, {"a": [{"b": [1, 2]}]}))
    assert merge(old, {"a": [{"b": [5]}, {"d": 6}]})["a"] == [{"b": [5]}, {"b": [3], "d": 6}]
    assert count({"a": [1, [2, 3]], "b": 4}) == 4
