"""The table of chips in the documentation is what the command prints."""

import json
from dataclasses import fields

import pytest

from spikedeploy.reports.datasheets import chip_table
from spikedeploy.runtime.chips.chip import CHIPS, chip
from tests.paths import ROOT

PAGE = ROOT / "docs" / "chips.md"


def shown(of):
    """The row of a chip, head -> cell."""
    table = chip_table([of])
    return dict(zip(table.columns, table.rows[0], strict=True))


def test_the_documentation_has_the_table_that_the_command_prints(command):
    code, out, err = command("chips", "--markdown")
    assert (code, err) == (0, "")
    assert out == chip_table([chip(name) for name in CHIPS]).markdown() + "\n"
    assert f"\n\n{out}\n" in PAGE.read_text("utf-8")


@pytest.mark.parametrize(
    ("used", "weights", "membrane"),
    [
        (chip("loihi1"), "8 bits and sign", "24 bits, clips"),
        (chip("loihi1:weight_bits=4,sign_mode=mixed"), "4 bits with the sign", "24 bits, clips"),
        (chip("int:membrane=12-wrap"), "8 bits with the sign, free", "12 bits, wraps, free"),
        (chip("odin"), "3 bits and the axon's sign", "8 bits unsigned, saturates"),
        (chip("truenorth"), "9 bits with the sign, 4 a neuron", "20 bits, saturates"),
        (chip("spinnaker2"), "8 bits with the sign", "float32"),
        (chip("spinnaker2-lif"), "5 bits with the sign", "float32"),
    ],
)
def test_a_row_says_what_the_datasheet_says(used, weights, membrane):
    row = shown(used)
    assert (row["weights"], row["membrane"]) == (weights, membrane)


@pytest.mark.parametrize("name", ["loihi1", "odin", "xylo-a2", "speck2f"])
def test_machines_get_every_field_of_every_datasheet_with_its_value(name, command):
    sheet = chip(name)
    listed = next(e for e in json.loads(command("chips", "--json")[1]) if e["name"] == name)
    names = {f.name for of in (sheet, sheet.arithmetic) for f in fields(of)}
    elsewhere = {"arithmetic", "evidence"}  # neurons, weights, membrane; compared_with
    assert names <= {*listed["fields"], *listed, *elsewhere}
    assert listed["fields"]["delay_max"] == sheet.delay_max
    assert listed["fields"]["clocks"] == list(sheet.clocks)
    assert json.loads(command("chips", name, "--json")[1]) == listed
    assert f" {', '.join(sheet.clocks)} | " in command("chips", "--markdown")[1]
