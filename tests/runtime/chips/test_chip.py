"""Every chip of the table keeps the same contract; a new one is tested by being there."""

import contextlib
import dataclasses

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.metrics.energy import TABLES
from tests.networks import chain, cuba, lif, popsan

NAMES = sorted(CHIPS)
# the others have no synaptic current, which a PopSAN needs
POLICIES = [name for name in NAMES if not isinstance(chip(name).arithmetic, IntegrateAndFire)]


def policy(name):
    """A policy that fits on every chip, with a reset that the chip has."""
    artifact = popsan(populations=4)
    reset = chip(name).resets[0]
    convention = dataclasses.replace(artifact.convention, reset=reset)
    return dataclasses.replace(artifact, convention=convention)


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


@pytest.mark.parametrize("name", POLICIES)
def test_a_policy_runs_on_every_chip(name):
    controller = SpikingController(policy(name), chip(name))
    controller.reset(0)
    action = controller.act(np.zeros(3))
    assert action.shape == (2,)
    assert (np.abs(action) <= 1).all()
    assert controller.ledger.total("sop") > 0


def suitable(name):
    """Networks of which every chip runs one, with the chip's first reset."""
    rng = np.random.default_rng(0)
    # one size of weights, and signs of axons
    weight = rng.integers(0, 2, (5, 8)) * np.where(np.arange(8) % 3 == 2, -1.0, 1.0)
    for neurons in (cuba(5), lif(5, tau=0.004, r=4.0), nir.IF(np.full(5, 1e3), np.full(5, 2.0))):
        nodes = nir.Linear(weight), neurons, nir.Linear(2 * np.eye(5)), neurons
        network = chain(*nodes, width=8, act=5)
        yield Artifact(network, None, Convention(1e-3, chip(name).resets[0]))


@pytest.mark.parametrize("name", NAMES)
def test_every_chip_compiles_and_emulates_a_small_network_that_suits_it(name):
    raster = (np.random.default_rng(1).random((2, 20, 8)) < 0.5).astype(np.uint8)
    ran = []
    for artifact in suitable(name):
        with contextlib.suppress(RuleError):
            program = compile_program(artifact, chip(name))
            ran.append(trace(program, raster)[program.output])
            np.testing.assert_array_equal(Machine(program, 2).infer(raster), ran[-1].spikes)
    assert ran
    assert all(found.spikes.any() for found in ran)


@pytest.mark.parametrize(
    ("mode", "bits", "step", "largest"),
    [("split", 8, 1, 255), ("mixed", 8, 2, 254), ("split", 4, 16, 240), ("mixed", 4, 32, 224)],
)
def test_fewer_bits_and_a_sign_widen_the_step_between_weights(mode, bits, step, largest):
    fixed = chip("loihi1", sign_mode=mode, weight_bits=bits).arithmetic
    assert (fixed.weight_step, fixed.weight_max) == (step, largest)
