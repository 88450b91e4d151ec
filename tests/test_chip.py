"""Every chip of the table keeps the same contract; a new one is tested by being there."""

import dataclasses

import numpy as np
import pytest

from runtime.chip import CHIPS, chip
from runtime.compile import compile
from runtime.controllers import SpikingController
from runtime.energy import TABLES
from runtime.errors import ChipError, RuleError
from runtime.machine import Machine
from tests.networks import popsan

NAMES = sorted(CHIPS)
COMPILED = [name for name in NAMES if chip(name).events is None]


@pytest.mark.parametrize("name", NAMES)
def test_a_chip_bears_the_name_of_the_table_and_a_summary(name):
    assert chip(name).name == name
    assert chip(name).summary


@pytest.mark.parametrize("name", NAMES)
def test_every_number_of_a_datasheet_has_a_source(name):
    datasheet = chip(name)
    described = {"name", "summary", "energy_tables", "sources", "limits"}
    needed = {field.name for field in dataclasses.fields(datasheet)} - described
    if datasheet.arithmetic:
        inside = {field.name for field in dataclasses.fields(datasheet.arithmetic)}
        needed = needed - {"arithmetic"} | inside
    assert needed == set(datasheet.sources)
    assert all(datasheet.sources.values())


@pytest.mark.parametrize("name", NAMES)
def test_energy_tables_of_a_chip_exist(name):
    assert set(chip(name).energy_tables) <= set(TABLES)


@pytest.mark.parametrize("name", COMPILED)
def test_a_policy_runs_on_every_chip(name):
    artifact = popsan()
    controller = SpikingController(artifact, chip(name), limits=False)
    controller.reset(0)
    action = controller.act(np.zeros(3))
    assert action.shape == (2,)
    assert (np.abs(action) <= 1).all()
    assert controller.ledger.total("sop") > 0


@pytest.mark.parametrize("name", COMPILED)
def test_a_machine_gives_the_same_bits_again(name):
    program = compile(popsan(), chip(name), limits=False)
    raster = (np.random.default_rng(0).random((2, 5, 30)) < 0.3).astype(np.uint8)
    first, again = (Machine(program, 2).infer(raster) for _ in range(2))
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize("name", sorted({*NAMES} - {*COMPILED}))
@pytest.mark.parametrize("reset", ["zero", "subtract"])
def test_a_chip_that_nothing_is_compiled_for_says_so(name, reset):
    artifact = popsan()
    convention = dataclasses.replace(artifact.convention, reset=reset)
    with pytest.raises(RuleError, match=name):
        compile(dataclasses.replace(artifact, convention=convention), chip(name))


@pytest.mark.parametrize("name", NAMES)
def test_a_datasheet_cannot_be_written_on(name):
    with pytest.raises(dataclasses.FrozenInstanceError):
        chip(name).delay = 3


def test_an_unknown_chip_is_refused_with_a_suggestion():
    with pytest.raises(ChipError, match=r"'loihi'; did you mean .*'loihi1'"):
        chip("loihi")


def test_an_unknown_option_is_refused_with_a_suggestion():
    with pytest.raises(ChipError, match=r"'weight_bit'; did you mean 'weight_bits'"):
        chip("loihi1", weight_bit=4)


def test_the_ideal_chip_has_no_options_of_an_arithmetic():
    with pytest.raises(ChipError, match="no option 'weight_bits'"):
        chip("ideal", weight_bits=4)


def test_an_option_replaces_a_field_and_leaves_the_table_alone():
    assert chip("loihi1", weight_bits=4, delay=0).fixed.weight_bits == 4
    assert chip("loihi1").fixed.weight_bits == 8


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("weight_bits", 7),
        ("sign_mode", "both"),
        ("step_rounding", "up"),
        ("exponents", "up"),
        ("refractory", 0),
    ],
)
def test_an_impossible_option_is_refused(option, value):
    with pytest.raises(ChipError, match=option):
        chip("loihi1", **{option: value})


def test_a_single_bit_cannot_hold_a_sign_and_a_weight():
    with pytest.raises(ChipError, match="nothing is left"):
        chip("loihi1", weight_bits=1, sign_mode="mixed")


@pytest.mark.parametrize(
    ("mode", "bits", "step", "largest"),
    [("split", 8, 1, 255), ("mixed", 8, 2, 254), ("split", 4, 16, 240), ("mixed", 4, 32, 224)],
)
def test_fewer_bits_and_a_sign_widen_the_step_between_weights(mode, bits, step, largest):
    fixed = chip("loihi1", sign_mode=mode, weight_bits=bits).fixed
    assert (fixed.weight_step, fixed.weight_max) == (step, largest)
