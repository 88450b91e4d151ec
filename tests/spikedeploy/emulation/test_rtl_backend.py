"""Hardware in the place of the emulated chip: actions are its own, and every state is compared."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from spikedeploy.emulation.rtl_backend import RtlBackend, StateComparison
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError
from tests.emulated_hardware import EmulatedHardware
from tests.networks import event_driven, popsan

CHIP = replace(chip("loihi1"), clock="gated")


def driven(artifact, on=CHIP, wrong=None):
    """A controller on hardware, one on the emulated chip, and the comparison of the first."""
    emulated = SpikingController(artifact, on)
    comparison = StateComparison()
    hardware = EmulatedHardware(emulated.program, wrong)
    make = partial(RtlBackend, hardware=hardware, comparison=comparison)
    return SpikingController(artifact, on, backend=make), emulated, comparison


POLICIES = {
    "delta, states kept": lambda: event_driven(),
    "population, states reset": lambda: popsan(obs=3, act=2),
    "population, states kept": lambda: replace(
        popsan(obs=3, act=2), convention=Convention(1e-3, state="kept")
    ),
}


@pytest.mark.parametrize("name", POLICIES)
@pytest.mark.parametrize("clock", ["gated", "pipelined"])
def test_actions_and_counts_are_those_of_the_emulated_chip(name, clock):
    artifact = POLICIES[name]()
    on = replace(chip("loihi1"), clock=clock)
    controller, emulated, comparison = driven(artifact, on)
    rng = np.random.default_rng(0)
    for episode in range(2):
        controller.reset(episode)
        emulated.reset(episode)
        for row in rng.normal(size=(12, artifact.codec.encoder.observed)):
            assert controller.act(row).tobytes() == emulated.act(row).tobytes()
    assert (controller.ledger.counts == emulated.ledger.counts).all()
    assert comparison.differing == 0
    assert comparison.timesteps == 24 * artifact.codec.timesteps
    each = sum(3 * layer.size for layer in controller.program.layers)
    assert comparison.numbers > comparison.timesteps * each


def test_a_wrong_bit_is_found_and_named():
    artifact = event_driven()
    controller, _, comparison = driven(artifact, wrong=(3, 2))
    for row in np.random.default_rng(0).normal(size=(6, artifact.codec.encoder.observed)):
        controller.act(row)
    assert comparison.differing >= 1
    layer = controller.program.layers[0].name
    assert f"timestep 3: the membrane of neuron 2 of layer '{layer}' is" in comparison.first
    assert comparison.as_json()["first"] == comparison.first


def test_an_action_is_made_of_what_the_hardware_sends_and_not_of_the_emulated_chip():
    artifact = event_driven()
    program = SpikingController(artifact, CHIP).program
    output = sum(layer.size for layer in program.layers[:-1])
    controller, emulated, _ = driven(artifact, wrong=(0, output))
    row = np.ones(artifact.codec.encoder.observed)
    controller.act(row)
    emulated.act(row)
    sent, wanted = controller.network.membrane, emulated.network.membrane
    name = program.layers[-1].name
    assert sent[name][0, 0] == wanted[name][0, 0] ^ 1


def test_hardware_runs_one_network_and_whole_inferences():
    artifact = event_driven()
    controller, _, _ = driven(artifact)
    observed = artifact.codec.encoder.observed
    with pytest.raises(ConfigError, match="no way to run 2 networks at once"):
        controller.act_batch(np.zeros((2, observed)))
    spikes = np.zeros((1, controller.program.width), np.uint8)
    with pytest.raises(ConfigError, match="timestep by timestep"):
        controller.network.step(spikes)
