"""Energy and time are one dot product over the ledger, and one example is SANA-FE's."""

import json

import numpy as np
import pytest

from runtime.chip import chip
from runtime.convention import Convention
from runtime.energy import TABLES, energy, energy_table, latency, mac_energy
from runtime.errors import ConfigError
from runtime.ledger import EVENTS, Ledger
from runtime.machine import Machine
from runtime.program import Program, Synapses
from tests.programs import GOLDEN, layer


@pytest.fixture
def sanafe_run():
    """SANA-FE's example: 10 inputs, all to all onto 10 neurons that never spike, 5 timesteps."""
    datasheet = chip("loihi1")
    weight = np.ones((10, 10), np.int16)
    neurons = layer(
        datasheet.fixed,
        "lif",
        weight.T,
        (Synapses("input", weight, delay=1),),
        decays=(4095, 0),
        threshold=131071 << 6,
        start=1,
    )
    program = Program(datasheet, Convention(1e-3), "input", 10, (neurons,), "lif", None)
    machine = Machine(program)
    for spiking in (1, 0, 1, 0, 1):
        machine.step(np.full((1, 10), spiking, np.uint8))
    return machine.ledger


@pytest.fixture
def expected():
    path = GOLDEN / "sanafe_loihi_energy_example.json"
    return json.loads(path.read_text())["result"]


def joules(ledger, *events):
    prices = TABLES["sanafe"].joules
    return sum(ledger.total(event) * prices[event] for event in events)


def test_the_energy_of_sanafes_example_is_reproduced(sanafe_run, expected):
    per_run = energy(sanafe_run, TABLES["sanafe"]) * sanafe_run.inferences
    parts = expected["energy"]
    assert per_run == pytest.approx(parts["total"], rel=1e-9)
    assert joules(sanafe_run, "sop") == pytest.approx(parts["synapse"])
    assert joules(sanafe_run, "message") == pytest.approx(parts["network"])
    assert joules(sanafe_run, "neuron_update", "neuron_idle") == pytest.approx(parts["soma"])
    assert sanafe_run.total("sop") == expected["spikes(synops)"]
    assert sanafe_run.total("message") == expected["packets_sent"]


def test_the_time_of_sanafes_example_is_an_upper_bound_by_a_tenth(sanafe_run, expected):
    per_run = latency(sanafe_run, TABLES["sanafe"]) * sanafe_run.inferences
    assert 1.0 < per_run / expected["sim_time"] < 1.1


def ledger(inferences=1, timesteps=5, steps=8, **events):
    counts = np.zeros((inferences, 1, len(EVENTS)), np.int64)
    for event, number in events.items():
        counts[:, 0, EVENTS.index(event)] = number
    return Ledger(("lif",), (10,), counts, inferences, timesteps * inferences, steps * inferences)


def test_energy_is_per_inference():
    table = TABLES["davies2018"]
    assert energy(ledger(1, sop=1000), table) == pytest.approx(23.6e-9)
    assert energy(ledger(3, sop=1000), table) == pytest.approx(23.6e-9)


def test_active_and_inactive_neurons_have_their_own_prices():
    table = TABLES["davies2018"]
    assert energy(ledger(neuron_update=10, neuron_idle=10), table) == pytest.approx(1330e-12)


def test_latency_adds_events_and_synchronisation():
    # 100 * 3.5 ns + 8 * 113 ns
    assert latency(ledger(sop=100), TABLES["davies2018"]) == pytest.approx(1254e-9)


def test_networks_without_spikes_pay_for_their_weights_too():
    # float32: 4.6 pJ for the arithmetic, half a read of 10 pJ for the weight
    assert mac_energy(311_000, TABLES["horowitz45"]) == pytest.approx(311_000 * 9.6e-12)
    assert mac_energy(1000, TABLES["horowitz45-int8"]) == pytest.approx(1000 * 1.55e-12)


def test_a_synaptic_operation_costs_less_than_a_mac_in_the_same_technology():
    for name in ("horowitz45", "horowitz45-int8"):
        prices = TABLES[name].joules
        assert prices["sop"] < prices["mac"] < 3 * prices["sop"]


@pytest.mark.parametrize("name", sorted(TABLES))
def test_every_table_says_where_it_comes_from_and_prices_known_events(name):
    table = energy_table(name)
    assert table.name == name
    assert table.source
    assert table.provenance
    assert set(table.joules) | set(table.seconds) <= {*EVENTS, "mac"}
    assert all(price > 0 for price in [*table.joules.values(), *table.seconds.values()])


def test_an_unknown_table_is_refused_with_a_suggestion():
    with pytest.raises(ConfigError, match="'davies'; did you mean 'davies2018'"):
        energy_table("davies")


def test_a_table_without_macs_or_times_says_so():
    with pytest.raises(ConfigError, match="no price for multiply-accumulates"):
        mac_energy(1, TABLES["sanafe"])
    with pytest.raises(ConfigError, match="has no times"):
        latency(ledger(), TABLES["horowitz45"])
