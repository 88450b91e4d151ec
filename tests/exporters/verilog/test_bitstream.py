"""From Verilog to a bitstream and back: each step computes the emulator's words."""

import re
import subprocess
from runpy import run_path

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.runtime.artifact.artifact import load
from tests.board_designs import TEMPLATES, export, make, needs, needs_simulation, scripts
from tests.networks import event_driven

needs_flow = needs(
    "yosys", "nextpnr-ice40", "icepack", "iceunpack", "icebox_vlog", "verilator", "g++", "make"
)
summary = run_path(str(TEMPLATES / "report.py"))["summary"]
declared = scripts().decompiled.declare_once


def test_ports_of_a_decompiled_module_are_declared_once():
    text = """
module top (input clk, output tx, input rx);

wire n1, clk, rx;
reg n2 = 0, tx = 1;
wire rx;

assign n1 = rx;
endmodule
"""
    assert declared(text).split("\n\n")[0].strip() == (
        "module top (input clk, output reg tx = 1, input rx);"
    )
    assert "\nwire n1;\nreg n2 = 0;\n" in declared(text)


@pytest.mark.fpga
@needs_simulation
def test_the_folder_of_an_export_has_no_warning_and_equals_the_emulator(tmp_path):
    export(event_driven(timesteps=2), "upduino", tmp_path)
    said = make(tmp_path, "lint", "sim", "pins")
    assert len(re.findall("^equal: ", said, re.MULTILINE)) == 2
    assert len(re.findall("^PASS: ", said, re.MULTILINE)) == 2


def briefly(folder, *words):
    """Run make in a folder, quietly."""
    words = ["make", "-s", *words]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)


@needs("iverilog", "make")
def test_the_bench_passes_with_and_without_stalls_and_has_to_do_both(tmp_path):
    export(event_driven(), "icebreaker", tmp_path)
    done = briefly(tmp_path, "icarus")
    assert done.returncode == 0, done.stderr
    first, passed, second, too = done.stdout.splitlines()
    assert (first, second) == ("without stalls:", "with random stalls:")
    assert passed.startswith("PASS: ")
    assert too.startswith("PASS: ")
    assert int(passed.split()[-2]) < int(too.split()[-2])  # clocks
    bench = (tmp_path / "bench.v").read_text()
    for fault in ("wrong == 0 && noise == 0", "wrong == 0 && noise != 0"):
        assert "if (wrong == 0)" in bench
        (tmp_path / "bench.v").write_text(bench.replace("if (wrong == 0)", f"if ({fault})"))
        done = briefly(tmp_path, "icarus")
        assert done.returncode != 0
        assert "FAIL: " in done.stdout


def test_the_frequency_of_a_build_is_that_of_its_slowest_clock():
    report = {
        "fmax": {"a": {"achieved": 30.0}, "b": {"achieved": 20.0}},
        "utilization": {"ICESTORM_LC": {"used": 5}},
    }
    assert summary(report, 3) == {"seed": 3, "mhz": 20.0, "cells": 5}


@pytest.mark.fpga
@needs_flow
@pytest.mark.parametrize(
    ("name", "on"), [("hexapod/sparse", "icebreaker"), ("kart-steer/sparse", "icestick")]
)
def test_netlist_and_bitstream_of_a_shipped_policy_equal_the_emulator(name, on, tmp_path):
    export(load(zoo.path(name)), on, tmp_path, steps=100)
    said = make(tmp_path, "netlist", "bitcheck", "STEPS=100")
    assert said.count("equal: 100 timesteps") == 2


@pytest.mark.fpga
@needs_flow
def test_the_netlist_equals_the_emulator_where_states_are_in_large_ram(tmp_path):
    export(load(zoo.path("hexapod-command/sparse")), "icebreaker", tmp_path, steps=60)
    assert "equal: 60 timesteps" in make(tmp_path, "netlist", "STEPS=60")
    make(tmp_path, "bit")
    done = subprocess.run(
        ["make", "bitcheck"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "icebox_vlog makes no Verilog of the large RAM" in done.stderr


@pytest.mark.fpga
@needs_flow
def test_a_changed_constant_of_the_bitstream_is_found(tmp_path):
    """The comparison has to differ where the design does."""
    export(event_driven(), "icebreaker", tmp_path)
    words = (tmp_path / "synapses.hex").read_text().splitlines()
    changed = [f"{int(word, 16) ^ 1:0{len(word)}x}" for word in words]
    (tmp_path / "synapses.hex").write_text("\n".join(changed) + "\n")
    with pytest.raises(AssertionError, match="differs: timestep"):
        make(tmp_path, "bitcheck")
    assert np.all([word != other for word, other in zip(words, changed, strict=True)])


@pytest.mark.fpga
@needs("yosys", "nextpnr-ecp5", "ecppack", "make")
def test_an_ecp5_is_built(tmp_path):
    export(event_driven(), "ulx3s", tmp_path)
    assert re.search(r"seed 1: \d+\.\d MHz; \d+ cells", make(tmp_path, "bit"))
    assert (tmp_path / "policy.bit").stat().st_size > 1000
