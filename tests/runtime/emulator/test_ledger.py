"""What is counted, on networks small enough to count by hand."""

from dataclasses import replace

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.ledger import EVENTS, LedgerBuilder
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError
from tests.networks import popsan
from tests.programs import layer, rasters

CHIP = chip("loihi1")


def program(weights, start=1, datasheet=CHIP, **options):
    """Axons onto neurons that forget their current and keep their membrane."""
    weight = np.array(weights, np.int16)
    neurons = layer(
        datasheet.arithmetic,
        "neurons",
        weight.T,
        (Synapses("input", weight, delay=1),),
        decays=(4095, 0),
        start=start,
        **{"threshold": 1000 << 6, **options},
    )
    return Program(datasheet, Convention(1e-3), "input", len(weight), (neurons,), "neurons", None)


def counted(network, raster):
    machine = Machine(network)
    machine.infer(np.array([raster], np.uint8))
    return {event: machine.ledger.total(event) for event in EVENTS}


def test_one_input_spike_costs_its_fan_out_in_sops():
    # axon 0 reaches two of three neurons, axon 1 one, axon 2 none
    network = program([[5, 0, 7], [0, -3, 0], [0, 0, 0]])
    assert counted(network, [[1, 0, 0]])["sop"] == 2
    assert counted(network, [[0, 1, 0]])["sop"] == 1
    assert counted(network, [[0, 0, 1]])["sop"] == 0
    both = counted(network, [[1, 1, 1], [1, 0, 0]])
    assert (both["spike_in"], both["sop"], both["message"]) == (4, 5, 4)


def test_a_bias_axon_costs_its_fan_out_and_a_message_in_every_timestep():
    network = program([[5, 5, 5]])
    biased = replace(network.layers[0], bias=np.array([4, 0, -4]))
    events = counted(replace(network, layers=(biased,)), [[0], [0], [1]])
    assert events["bias_sop"] == 3 * 2
    assert events["sop"] == 3
    assert events["message"] == 3 + 1
    assert events["spike_in"] == 1


def test_a_neuron_is_updated_when_it_has_a_current_or_a_membrane():
    # the spike of row 1 arrives in row 1 of the window, and the membrane stays from then on;
    # nothing is connected to the second neuron; one chip timestep passes before the window starts
    events = counted(program([[5, 0]]), [[0], [1], [0], [0]])
    assert events["neuron_update"] == 3
    assert events["neuron_idle"] == 2 * (4 + 1) - 3


def test_a_voltage_bias_keeps_neurons_busy():
    events = counted(program([[5, 0]], bias=1), [[0], [0]])
    assert (events["neuron_update"], events["neuron_idle"]) == (4, 2)


def test_output_spikes_are_sent_to_the_host():
    # 255 + 255 > 300, in the second timestep
    events = counted(program([[255]], threshold=300 << 6), [[1], [1]])
    assert events["spike_out"] == 1
    assert events["message"] == 2 + 1


def test_saturations_are_counted():
    narrow = chip("loihi1", current=Register(16, "wrap"), membrane=Register(17, "clip"))
    network = program([[-255] * 2] * 4, datasheet=narrow)
    # 2 * 255 * 64 = 32640 fits 15 bits and sign, 3 * 255 * 64 does not and becomes positive
    assert counted(network, [[1, 1, 0, 0]])["saturation"] == 0
    assert counted(network, [[1, 1, 1, 0]])["saturation"] == 2
    # -32640 twice fits 16 bits and sign, thrice does not
    assert counted(network, [[1, 1, 0, 0]] * 2)["saturation"] == 0
    assert counted(network, [[1, 1, 0, 0]] * 3)["saturation"] == 2


def test_rows_are_inferences_and_totals_are_their_sum():
    network = compile_program(popsan(), chip("loihi1"), clock="gated")
    runs = rasters(network, 2, 5, 0.3, seed=0, inferences=3)
    ledgers = {}
    for rows in ("each", "copies", "total", "none"):
        machine = Machine(network, 2, ledger=rows)
        for raster in runs:
            machine.infer(raster)
            ledgers[rows] = machine.ledger
    assert ledgers["each"].counts.shape == (6, 3, len(EVENTS))
    assert ledgers["total"].counts.shape == (1, 3, len(EVENTS))
    np.testing.assert_array_equal(ledgers["each"].counts.sum(axis=0), ledgers["total"].counts[0])
    each = ledgers["each"].counts.reshape(3, 2, 3, len(EVENTS))
    np.testing.assert_array_equal(each.sum(axis=0), ledgers["copies"].counts)
    for rows in ("each", "copies", "total"):
        ledger = ledgers[rows]
        assert (ledger.inferences, ledger.timesteps, ledger.steps) == (6, 30, 6 * (5 + 3))
    assert ledgers["none"].inferences == 0
    assert ledgers["none"].per_inference("sop") == 0


def test_spikes_that_share_a_timestep_leave_the_sparsity_unknown():
    policy = popsan()
    subtractive = replace(policy, convention=replace(policy.convention, reset="subtract"))
    xylo = compile_program(subtractive, chip("xylo-a2", read="any"), limits=False)
    machine = Machine(xylo)
    machine.infer(np.full((1, 20, xylo.width), 15, np.uint8))
    ledger = machine.ledger
    # more spikes than places, of which 1 - spikes / places would be below 0
    assert ledger.total("spike_out") > 20 * sum(ledger.neurons)
    assert ledger.sparsity is None


def test_streaming_writes_a_row_per_chip_timestep():
    machine = Machine(program([[5, 0]]))
    for spikes in ([1], [0], [0]):
        machine.step(np.array([spikes], np.uint8))
    ledger = machine.ledger
    assert ledger.counts.shape == (3, 1, len(EVENTS))
    assert ledger.counts[:, 0, EVENTS.index("sop")].tolist() == [1, 0, 0]
    # the layer waits in the first timestep
    assert ledger.counts[:, 0, EVENTS.index("neuron_update")].tolist() == [0, 1, 1]
    assert ledger.counts[:, 0, EVENTS.index("neuron_idle")].tolist() == [2, 1, 1]


def test_unknown_rows_are_refused():
    with pytest.raises(ConfigError, match="ledger 'some'"):
        LedgerBuilder(program([[5]]), "some")
