"""Every chip of the table keeps the same contract; a new one is tested by being there."""

import dataclasses

import pytest

from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.metrics.energy_tables import TABLES

NAMES = sorted(CHIPS)


@pytest.mark.parametrize("name", NAMES)
def test_a_chip_has_the_name_of_the_table_a_summary_evidence_and_known_energy_tables(name):
    assert chip(name).name == name
    assert chip(name).summary
    assert chip(name).evidence
    assert set(chip(name).energy_tables) <= set(TABLES)


@pytest.mark.parametrize("name", NAMES)
def test_every_number_of_a_datasheet_has_a_source(name):
    datasheet = chip(name)
    described = {"name", "summary", "energy_tables", "sources", "evidence", "limits", "clock"}
    needed = {field.name for field in dataclasses.fields(datasheet)} - described
    if inside := {field.name for field in dataclasses.fields(datasheet.arithmetic)}:
        needed = needed - {"arithmetic"} | inside
    assert needed == set(datasheet.sources)
    assert all(datasheet.sources.values())


@pytest.mark.parametrize(
    ("mode", "bits", "step", "largest"),
    [("split", 8, 1, 255), ("mixed", 8, 2, 254), ("split", 4, 16, 240), ("mixed", 4, 32, 224)],
)
def test_fewer_bits_and_a_sign_widen_the_step_between_weights(mode, bits, step, largest):
    fixed = chip("loihi1", sign_mode=mode, weight_bits=bits).arithmetic
    assert (fixed.weight_step, fixed.weight_max) == (step, largest)
