"""Designs of boards that tests build: whole exports, and links around a core that counts."""

import shutil
import subprocess
import sys
from importlib import import_module
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest

from spikedeploy.exporters.rendering import render
from spikedeploy.exporters.verilog import board_files as written
from spikedeploy.exporters.verilog.boards import board
from spikedeploy.exporters.verilog.eda_tools import find_tool
from spikedeploy.exporters.verilog.image import core_image
from spikedeploy.exporters.verilog.to_verilog import core_files
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.convention import CLOCKS

PACKAGE = "spikedeploy.exporters.verilog"
TEMPLATES = files(PACKAGE) / "templates"


def _missing(*names):
    return [name for name in names if find_tool(name) is None]


def needs(*names):
    """Skip a test where one of the tools is missing."""
    missing = _missing(*names)
    return pytest.mark.skipif(bool(missing), reason=f"{', '.join(missing)}: not installed")


needs_simulation = needs("verilator", "g++", "make")

# answers each timestep with three words: tokens in it, their sum, and timesteps since 8001
COUNTING_CORE = """
module policy_core #(parameter STATE_IN_SPRAM = 0, parameter USE_DSP = 0) (
  input wire clk, input wire rst,
  input wire [15:0] s_axis_tdata, input wire s_axis_tvalid, output wire s_axis_tready,
  output reg [31:0] m_axis_tdata, output wire m_axis_tvalid, input wire m_axis_tready,
  output wire m_axis_tlast
);
  reg [1:0] word;  // 3: takes tokens
  reg [31:0] count, sum, steps;
  reg [5:0] wait_for;
  assign s_axis_tready = word == 2'd3 && wait_for == 0;
  assign m_axis_tvalid = word != 2'd3 && wait_for == 0;
  assign m_axis_tlast = word == 2'd2;
  always @*
    case (word)
      2'd0: m_axis_tdata = count;
      2'd1: m_axis_tdata = sum;
      default: m_axis_tdata = steps;
    endcase
  always @(posedge clk)
    if (rst) begin
      word <= 2'd3;
      {count, sum, steps, wait_for} <= 0;
    end else if (wait_for != 0) wait_for <= wait_for - 1;
    else if (s_axis_tready && s_axis_tvalid) begin
      wait_for <= s_axis_tdata[5:0];
      if (s_axis_tdata == 16'h8001) steps <= 0;
      else if (s_axis_tdata == 16'h8000) begin
        word <= 0;
        steps <= steps + 1;
        wait_for <= 50;
      end else begin
        count <= count + 1;
        sum <= sum + {16'd0, s_axis_tdata};
      end
    end else if (m_axis_tvalid && m_axis_tready) begin
      word <= word + 1'b1;
      wait_for <= 3;
      if (m_axis_tlast) {count, sum} <= 0;
    end
endmodule
"""


def _modules(*names):
    """Scripts of an export, as modules."""
    places = [str(TEMPLATES), str(TEMPLATES.parent.parent / "kit")]
    sys.path[:0] = places
    try:
        return SimpleNamespace(**{name: import_module(name) for name in names})
    finally:
        for place in places:
            sys.path.remove(place)
        for name in ("host", "host_codec"):  # a kit has a host.py of its own
            sys.modules.pop(name, None)


def scripts():
    """Scripts of an export that its tools run."""
    return _modules("decompiled", "link", "pins")


def host_module():
    """host.py of an export."""
    return _modules("host").host


def design(on, words=3):
    """Text of the top module of a board, and of what simulates its pins."""
    use = SimpleNamespace(states_in_large_ram=False, buffer_in_large_ram=False)
    values = {"board": on, "ports": on.ports, "link": written.Buffer(words), "use": use}
    values["origin"] = "a test"
    return {name: render(PACKAGE, name, **values) for name in ("top.v", "pins_main.cpp")}


def write_design(folder, name, core=COUNTING_CORE):
    """The files of a board's design around a core."""
    texts = design(board(name)) | {"policy_core.v": core}
    for each in ("uart.v", "link.v"):
        texts[each] = (TEMPLATES / each).read_text()
    for each, text in texts.items():
        (folder / each).write_text(text)


def make(folder, *words):
    """Run make in a folder; its output. AssertionError with it where it fails."""
    done = subprocess.run(
        [shutil.which("make"), *words], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-3000:]
    return done.stdout


def image_of(artifact, on="loihi1"):
    """The image of a policy, whose layers are updated when they are told to."""
    from dataclasses import replace

    told = replace(chip(on), clocks=CLOCKS)
    program = compile_program(artifact, told, clock=own_clock(artifact.convention))
    return core_image(program, artifact.codec)


def walk(codec, steps=40, seed=0):
    """Observations (S, obs) that drift, some of them beyond the clip of the normaliser."""
    rng = np.random.default_rng(seed)
    rows = np.cumsum(0.3 * rng.normal(size=(steps, codec.encoder.observed)), axis=0)
    rows[rng.random(rows.shape) < 0.01] *= 100
    return rows * codec.normaliser.std + codec.normaliser.mean


def export(artifact, name, folder, on="loihi1", steps=40):
    """An export of a policy for a board, written; its image."""
    image = image_of(artifact, on)
    texts = core_files(image, "a test") | written.board_files(
        image, artifact.codec, board(name), "a test", walk(artifact.codec, steps)
    )
    for each, text in texts.items():
        (folder / each).write_text(text)
    return image
