"""Boards: their pins, constraints, top modules, and what of them a design takes."""

import json
import re
import subprocess

import pytest

from spikedeploy.exporters.verilog.boards import board, board_names
from spikedeploy.runtime.errors import ConfigError
from tests.board_designs import needs, needs_simulation, write_design

BOARDS = board_names()


# clock, received and transmitted, as the constraint files of the boards' makers have them
WIRES = {
    "icebreaker": ("35", "6", "9"),
    "upduino": ("20", "15", "14"),
    "icestick": ("21", "9", "8"),
    "ice40-hx8k": ("J3", "B10", "B12"),
    "ulx3s": ("G2", "M1", "L4"),
}


@pytest.mark.parametrize("name", BOARDS)
def test_pins_are_those_of_the_board_and_each_is_used_once(name):
    on = board(name)
    assert tuple(on.pins[each] for each in ("clk", "rx", "tx")) == WIRES[name]
    assert len(set(on.pins.values())) == len(on.pins)
    assert on.source
    # a line that nobody drives is at rest, and the divider meets the baud rate as UARTs need it
    assert re.search(r"-pullup yes rx |\"rx\" .* PULLMODE=UP;", on.constraints)
    assert on.divider >= 4
    assert abs(on.clock_hz / on.divider / on.baud - 1) < 0.01


@pytest.mark.parametrize("name", BOARDS)
def test_constraints_name_each_port_of_the_top_module_and_no_other(name, tmp_path):
    write_design(tmp_path, name)
    top = (tmp_path / "top.v").read_text()
    header = top[top.index("module top") : top.index(");")]
    ports = set(re.findall(r"(?:input|output)\s+wire (\w+)", header))
    pattern = r"^set_io (?:-pullup yes )?(\w+)|LOCATE COMP \"(\w+)\""
    found = re.findall(pattern, board(name).constraints, re.MULTILINE)
    assert {a or b for a, b in found} == ports
    assert f"{board(name).clock_hz / 1e6:g}" in board(name).constraints


def test_a_board_that_there_is_not_is_a_sentence():
    with pytest.raises(ConfigError, match=r"no board 'icebraker'. Did you mean 'icebreaker'\?"):
        board("icebraker")
    with pytest.raises(ConfigError, match="Known: icebreaker, upduino, icestick"):
        board("zzz")


@needs_simulation
@pytest.mark.parametrize("name", BOARDS)
def test_verilator_warns_of_nothing_in_the_design_of_a_board(name, tmp_path):
    write_design(tmp_path, name)
    words = "verilator --lint-only -Wall -Wno-DECLFILENAME --top-module top top.v uart.v link.v"
    core = "/* verilator lint_off WIDTH */\n" + (tmp_path / "policy_core.v").read_text()
    core = core.replace("parameter STATE_IN_SPRAM", "parameter /* verilator lint_off UNUSED */ S")
    (tmp_path / "policy_core.v").write_text(core.replace("S = 0", "STATE_IN_SPRAM = 0", 1))
    done = subprocess.run(
        [*words.split(), "policy_core.v"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[:2000]


def _netlist(folder):
    """Cells of the design after elaboration: nets by number, flip-flops and what drives them."""
    script = "read_verilog top.v uart.v link.v policy_core.v; hierarchy -top top; proc; flatten; "
    script += "tribuf; opt -full; check -assert; select -assert-none t:$dlatch* t:$adlatch*; "
    script += "write_json n.json"
    done = subprocess.run(
        ["yosys", "-q", "-p", script], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads((folder / "n.json").read_text())["modules"]["top"]


@needs("yosys")
@pytest.mark.parametrize("name", ["icebreaker", "upduino"])
def test_inputs_pass_two_flip_flops_and_there_is_no_latch_or_net_with_two_drivers(name, tmp_path):
    write_design(tmp_path, name)
    module = _netlist(tmp_path)
    cells = module["cells"].values()

    def readers(net):
        """Cells that read a net, but for inverters, whose outputs count in its place."""
        found = []
        for cell in cells:
            for port, nets in cell["connections"].items():
                if net in nets and cell["port_directions"][port] == "input":
                    if cell["type"] in ("$not", "$logic_not"):
                        found += readers(cell["connections"]["Y"][0])
                    else:
                        found.append((cell, port, nets.index(net)))
        return found

    inputs = {n: p for n, p in module["ports"].items() if p["direction"] == "input" and n != "clk"}
    assert set(inputs) >= {"rx"}
    for port in inputs.values():
        net = port["bits"][0]
        for _ in range(2):
            # of one flip-flop alone, as its next value: perhaps behind a synchronous reset
            flops = _next_flops(readers(net), readers)
            assert len(flops) == 1
            net = flops[0]


def _next_flops(reading, readers):
    """Outputs of the flip-flops that take a net, directly or past the choice of a reset."""
    found = []
    for cell, port, at in reading:
        if "dff" in cell["type"] and port == "D":
            found.append(cell["connections"]["Q"][at])
        elif cell["type"] == "$mux" and port in "AB":
            found += _next_flops(readers(cell["connections"]["Y"][at]), readers)
        else:
            found.append(None)
    return found
