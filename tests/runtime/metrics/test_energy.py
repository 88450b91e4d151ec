"""Energy and time: one dot product over the ledger, term by term; one example is SANA-FE's."""

import math

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metrics.energy import (
    BREAK_EVEN_TABLES,
    ON_CHIP,
    break_even_sops,
    delta_encoder,
    energy,
    energy_estimate,
    energy_table,
    host_readout,
    latency_estimate,
    mac_energy,
    mac_energy_estimate,
    priced_terms,
    rate_encoder,
    reading_energy,
    reset_energy,
    static_energy,
    unpriced_terms,
    xylo_clocks,
    xylo_time,
)
from spikedeploy.runtime.metrics.energy_tables import STATIC, TABLES, Uncertainty


def ledger(inferences=1, timesteps=5, steps=8, **events):
    counts = np.zeros((inferences, 1, len(EVENTS)), np.int64)
    for event, number in events.items():
        counts[:, 0, EVENTS.index(event)] = number
    return Ledger(("lif",), (10,), counts, inferences, timesteps * inferences, steps * inferences)


def test_energy_is_per_inference():
    table = TABLES["davies2018"]
    assert energy(ledger(1, sop=1000), table) == pytest.approx(23.6e-9)
    assert energy(ledger(3, sop=1000), table) == pytest.approx(23.6e-9)


def test_latency_adds_events_and_synchronisation():
    # 100 * 3.5 ns + 8 * 113 ns
    assert latency_estimate(ledger(sop=100), TABLES["davies2018"]).value == pytest.approx(1254e-9)


@pytest.mark.parametrize("name", sorted(TABLES))
def test_every_table_says_where_it_comes_from_and_prices_known_events(name):
    table = energy_table(name)
    assert table.name == name
    assert table.source
    assert table.provenance
    others = {"mac", "hop_x", "hop_y", "one_state_update", "state_write"}
    assert set(table.joules) | set(table.seconds) <= {*EVENTS, *others}
    assert table.least <= table.joules.keys()
    assert table.upper_joules.keys() <= table.joules.keys()
    assert all(table.upper_joules[event] > table.joules[event] for event in table.upper_joules)
    for uncertainty in (table.uncertainty, table.time_uncertainty):
        assert uncertainty.why
        assert uncertainty.low <= 1 <= uncertainty.high
    assert all(price > 0 for price in [*table.joules.values(), *table.seconds.values()])


def test_sums_in_memory_have_the_prices_of_their_accesses_and_of_an_index():
    # 10 pJ an access of 64 bits: 8 bits 1.25, 16 bits 2.5, 32 bits 5
    for bits, access in ((16, 2.5), (32, 5.0)):
        found = {n: 1e12 * j for n, j in TABLES[f"horowitz45-int8-acc{bits}"].joules.items()}
        # a weight, its index, the sum read and written, an addition: 7.6 and 12.6 pJ
        assert found["sop"] == pytest.approx(1.25 + 1.25 + 2 * access + 0.1)
        assert found["bias_sop"] == found["sop"]
        assert found["graded_sop"] == pytest.approx(found["sop"] + 0.2)
        # a weight, its index, the input; the sum stays in a register: 4.05 pJ
        assert found["mac"] == pytest.approx(1.25 + 1.25 + 1.25 + 0.2 + 0.1)
        # u = a u, v = b v + u + bias; u has its input already: 16.4 and 26.4 pJ
        assert found["neuron_update"] == pytest.approx(2 * 3.1 + 2 * 0.1 + 4 * access)
        # v = b v: 8.1 and 13.1 pJ
        assert found["one_state_update"] == pytest.approx(3.1 + 2 * access)
        assert found["state_write"] == pytest.approx(access)


def test_a_neuron_with_one_state_is_priced_as_such_where_a_table_does():
    rows = np.zeros((1, 2, len(EVENTS)), np.int64)
    rows[0, :, EVENTS.index("neuron_update")] = 10, 4
    found = Ledger(("lif", "readout"), (10, 4), rows, 1, 1, 1, one_state=("readout",))
    assert energy(found, TABLES["horowitz45-int8-acc16"]) == pytest.approx(
        (10 * 16.4 + 4 * 8.1) * 1e-12
    )
    assert energy(found, TABLES["horowitz45-int8"]) == pytest.approx(14 * 26.5e-12)


def test_a_bound_holds_where_every_price_is_the_least_of_its_process():
    for name in ("davies2018", "horowitz45", "horowitz45-int8"):
        alone = energy_estimate(ledger(sop=1000, bias_sop=2), TABLES[name])
        assert alone.low == alone.value > 0
        assert alone.high == math.inf
        updated = energy_estimate(ledger(sop=1000, neuron_update=1), TABLES[name])
        assert (updated.low, updated.high) == (0, math.inf)
    assert mac_energy_estimate(10, TABLES["horowitz45-int8"]).low == pytest.approx(15.5e-12)
    assert mac_energy_estimate(10, TABLES["horowitz45-int8-acc16"]).low == 0
    nothing = mac_energy_estimate(0, TABLES["horowitz45-int8"])
    assert (nothing.value, nothing.low, nothing.high) == (0, 0, math.inf)
    # silicon, as sanafe fits it, takes less for a neuron than davies2018 has
    davies, fitted = TABLES["davies2018"].joules, TABLES["sanafe"].joules
    assert all(fitted[each] < davies[each] for each in ("neuron_update", "neuron_idle"))


def test_where_sources_disagree_an_energy_is_an_interval():
    found = energy_estimate(ledger(sop=1000, neuron_update=10), TABLES["spinnaker2"])
    # 450 and 1500 pJ a synaptic event, 2.19 nJ an update in both
    assert (found.low, found.high) == pytest.approx((471.9e-9, 1521.9e-9))


def test_a_chip_with_a_clock_takes_a_tick_per_timestep():
    found = latency_estimate(ledger(steps=8, sop=1000), TABLES["truenorth"])
    assert (found.low, found.value, found.high) == pytest.approx((8e-3, 8e-3, 8e-3))


def test_static_power_is_a_line_of_its_own():
    # 104 mW for a millisecond; an eighth of a board's 1.084 W
    chip, board = STATIC["loihi1"]
    assert static_energy(1e-3, chip) == pytest.approx(104e-6)
    assert static_energy(1e-3, board) == pytest.approx(1.084e-3 / 8)
    assert all(power.source and power.whole for powers in STATIC.values() for power in powers)


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ((1, 1), "exact"),
        ((1, float("inf")), "at least"),
        ((0, 1), "at most"),
        ((0, 1.25), "at most 1.25 times"),
        ((0.9, 1.1), "± 10 %"),
        ((0.5, 3), "0.5 to 3 times"),
        ((0, float("inf")), "no bound known"),
    ],
)
def test_an_uncertainty_is_said_in_a_few_words(bounds, words):
    assert Uncertainty(*bounds, "why").describe() == words


def test_an_unknown_table_is_refused_with_a_suggestion():
    with pytest.raises(ConfigError, match="'davies'; did you mean 'davies2018'"):
        energy_table("davies")


def test_a_table_without_macs_or_times_says_so():
    with pytest.raises(ConfigError, match="no price for 'mac'"):
        mac_energy(1, TABLES["sanafe"])
    with pytest.raises(ConfigError, match="has no times"):
        latency_estimate(ledger(), TABLES["horowitz45"])


# terms of the chip and of the host

COUNTS = {
    "sop": 1013.0, "graded_sop": 13.0, "bias_sop": 57.0, "neuron_update": 211.0,
    "neuron_idle": 97.0, "message": 71.0, "spike_out": 31.0, "spike_in": 40.0, "saturation": 3.0,
}  # fmt: skip


def pico(joules):
    return pytest.approx(joules * 1e-12)


@pytest.mark.parametrize("name", TABLES)
def test_the_terms_of_a_chip_add_up_to_its_energy(name):
    table = TABLES[name]
    whole = energy(ledger(**COUNTS), table)
    assert sum(priced_terms(COUNTS, table).values()) == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize("name", TABLES)
def test_every_term_that_happens_has_a_price_or_is_named(name):
    table = TABLES[name]
    said = {*priced_terms(COUNTS, table), *unpriced_terms(COUNTS, table), *table.included}
    assert said >= set(ON_CHIP)
    assert said <= {*ON_CHIP, "resets"}
    assert not set(priced_terms(COUNTS, table)) & set(unpriced_terms(COUNTS, table))
    assert all(joules > 0 for joules in priced_terms(COUNTS, table).values())


def test_the_host_is_priced_by_additions_and_accesses():
    assert reading_energy(20) == pico(20 * 2.5)
    # as in the pareto experiment: read, subtract, compare, read the level; add and write an event
    once = delta_encoder(20, 5)
    assert once == pico(20 * (2.5 + 0.1 + 0.1 + 2.5) + 5 * (0.1 + 2.5))
    # levels are compared in every timestep, observations read once
    assert delta_encoder(20, 5, 3) - once == pico(20 * 2 * 2.7)
    # read and scaled once; in each timestep added, the accumulator read and written
    assert rate_encoder(20, 16) == pico(20 * (2.5 + 3.1 + 0.1 + 16 * 5.1))
    assert host_readout(100, 10, 4) == pico(104 * 1.35 + 10 * 1.55)
    assert reset_energy(10, TABLES["horowitz45-int8"]) == pico(50)
    assert (reset_energy(10, TABLES["davies2018"]), reset_energy(0, INT8)) == (None, 0)


# break-even lines: at the line both networks cost the same, worked out by hand

INT8 = TABLES["horowitz45-int8"]


def test_the_tables_are_those_that_price_both_kinds():
    int8 = "horowitz45-int8"
    assert ("horowitz45", int8, f"{int8}-acc16", f"{int8}-acc32") == BREAK_EVEN_TABLES


def test_at_the_operations_a_row_costs_what_the_other_costs():
    terms = {"operations": 100 * 1.35e-12, "updates": 200e-12, "encoder": 50e-12}
    sops = break_even_sops(terms, 100, 520e-12, INT8)
    assert sops * 1.35e-12 + 250e-12 == pytest.approx(520e-12)
    assert break_even_sops(terms, 100, sum(terms.values()), INT8) == pytest.approx(100)
    assert break_even_sops(terms, 100, 200e-12, INT8) < 0
    # a silent policy has the table's price, graded operations their own
    assert break_even_sops({"operations": 0.0}, 0, 1.35e-12, INT8) == pytest.approx(1)
    assert break_even_sops({"operations": 155e-12}, 100, 1.55e-12, INT8) == pytest.approx(1)


@pytest.mark.parametrize(
    ("sums", "active", "least"),
    # F (MAC d_a - SOP d_s) > update, d_s = 5 %, as docs/energy.md says
    [("", 0.5, 38), ("", 0.1, 303), ("-acc16", 0.5, 10), ("-acc16", 0.1, 656),
     ("-acc32", 0.5, 19)],
)  # fmt: skip
def test_a_layer_of_that_fan_in_is_the_first_that_costs_less_when_it_spikes(sums, active, least):
    prices = TABLES[f"horowitz45-int8{sums}"].joules
    of_a_synapse = active * prices["mac"] - 0.05 * prices["sop"]
    assert least * of_a_synapse >= prices["neuron_update"] * (1 - 1e-9)
    assert (least - 1) * of_a_synapse < prices["neuron_update"]


# Xylo's clocks, worked out by hand from rockpool's formula


def _layer(name, size, wires, aliases=()):
    synapses = tuple(Synapses(source, np.array(w, np.int64), 1) for source, w in wires)
    zero = np.zeros(size, np.int64)
    return Layer(name, synapses, zero, zero, zero + 10, zero[None], zero, 1.0, 0, aliases)


def _program(aliases=()):
    """Two inputs, four hidden neurons of which each reaches two others, and one output."""
    loop = np.array([[0, 1, 1, 0], [0, 0, 1, 1], [1, 0, 0, 1], [1, 1, 0, 0]])
    hidden = _layer("hidden", 4, [("input", np.ones((2, 4))), ("hidden", loop)], aliases)
    output = _layer("output", 1, [("hidden", np.ones((4, 1)))])
    convention = Convention(1e-3, reset="subtract", delay=1)
    return Program(chip("xylo-a2"), convention, "input", 2, (hidden, output), "output", None)


QUIET = {
    "input": np.zeros((1, 10, 2)),
    "hidden": np.zeros((1, 10, 4)),
    "output": np.zeros((1, 10, 1)),
}


def test_a_spike_takes_clocks_for_each_postsynaptic_neuron():
    busy = {**QUIET, "input": QUIET["input"].copy(), "hidden": QUIET["hidden"].copy()}
    busy["input"][0, :5] = 3  # half of the timesteps; that they are three is all the same
    busy["hidden"][0, ::4] = 1  # of 10 timesteps 3
    inputs = 2 * (3.5 * 0.5 * 4 + 1)
    synapses = 4 * (2 * 7 * 0.3 + 3)
    outputs = 4 * 0.3 * (1 + 1 * 8)
    neurons = 4 * (19 + 2 * 0.3 + 0.3)
    wanted = inputs + synapses + outputs + neurons + 12
    assert xylo_clocks(_program(), busy) == pytest.approx(wanted)


def test_aliases_take_clocks_too():
    # every neuron has an alias and is one: 2 + 3 + 1 clocks a neuron more, spikes or not
    everyone = ((1,), (2,), (3,), (0,))
    assert xylo_clocks(_program(everyone), QUIET) == 2 + 4 * (22 + 2 + 3 + 1) + 12


def test_time_is_clocks_over_the_clock_and_at_most_a_fifth_more():
    found = xylo_time(_program(), QUIET, clock=1e6)
    assert (found.value, found.low, found.high) == pytest.approx((1020e-6, 1020e-6, 1224e-6))
