"""Calibration: what is chosen on a recording holds on that recording."""

import numpy as np
import pytest

from spikedeploy.runtime.analysis.calibration import tune_to_float, with_calibrated_headroom
from spikedeploy.runtime.analysis.drift import drift
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import UNTUNED, Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import RuleError
from tests.networks import popsan
from tests.runtime.families.test_headroom import crowd


def some(axons, of=600, timesteps=6):
    raster = np.zeros((1, timesteps, of), np.uint8)
    raster[:, :, :axons] = 1
    return raster


def weight_of(quantisation):
    program = compile_program(crowd(), chip("loihi1"), quantisation)
    return int(program.layers[0].synapses[0].weight[0, 0])


@pytest.mark.parametrize("granularity", ["layer", "channel"])
def test_with_calibrated_headroom_the_ledger_counts_no_saturation(granularity):
    found = with_calibrated_headroom(crowd(), chip("loihi1"), some(600), Quantisation(granularity))
    machine = Machine(compile_program(crowd(), chip("loihi1"), found))
    machine.infer(some(600))
    assert machine.ledger.total("saturation") == 0
    # lava lets the accumulator pass: 2**23 / (600 * 64) = 218.4 of the current, and 2% to be found
    assert 214 <= weight_of(found) <= 218


def test_headroom_is_taken_only_where_the_recording_needs_it():
    found = with_calibrated_headroom(crowd(), chip("loihi1"), some(500))
    # 500 * 255 * 64 = 8,160,000 < 2**23
    assert weight_of(found) == 255
    assert found == Quantisation()


def test_tuning_brings_every_layer_nearer_or_leaves_it():
    artifact, low = popsan(), chip("loihi1", weight_bits=3)
    rng = np.random.default_rng(0)
    raster = (rng.random((20, 5, 30)) < 0.3).astype(np.uint8)
    found = tune_to_float(artifact, low, raster, Quantisation(rounding="truncate"))
    before = drift(artifact, low, raster, Quantisation(rounding="truncate"))
    after = drift(artifact, low, raster, found)
    assert after.layers[0].distance < 0.9 * before.layers[0].distance
    assert found.of("n2") != UNTUNED
    assert "'n2': reach" in found.describe()


def test_a_chip_of_another_arithmetic_is_not_calibrated():
    with pytest.raises(RuleError, match="ideal: calibration chooses scales"):
        tune_to_float(crowd(), chip("ideal"), some(1))
