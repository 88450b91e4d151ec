"""The terms of an energy add up to it, have the prices that are said, and hide nothing."""

import numpy as np
import pytest

from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.metrics import energy as prices
from spikedeploy.runtime.metrics.energy import (
    ON_CHIP,
    TABLES,
    TERMS,
    chip_terms,
    energy,
    priced_terms,
    unpriced_terms,
)

COUNTS = {
    "sop": 1013.0, "graded_sop": 13.0, "bias_sop": 57.0, "neuron_update": 211.0,
    "neuron_idle": 97.0, "message": 71.0, "spike_out": 31.0, "spike_in": 40.0, "saturation": 3.0,
}  # fmt: skip


def ledger(counts):
    rows = np.zeros((1, 1, len(EVENTS)), np.int64)
    for event, number in counts.items():
        rows[0, 0, EVENTS.index(event)] = number
    return Ledger(("lif",), (100,), rows, 1, 5, 5)


def pico(joules):
    return pytest.approx(joules * 1e-12)


@pytest.mark.parametrize("name", TABLES)
def test_the_terms_of_a_chip_add_up_to_its_energy(name):
    table = TABLES[name]
    whole = energy(ledger(COUNTS), table)
    assert sum(chip_terms(COUNTS, table).values()) == pytest.approx(whole, rel=1e-12)
    assert sum(priced_terms(COUNTS, table).values()) == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize("name", TABLES)
def test_every_term_that_happens_has_a_price_or_is_named(name):
    table = TABLES[name]
    said = {*priced_terms(COUNTS, table), *unpriced_terms(COUNTS, table), *table.included}
    assert said >= set(ON_CHIP)
    assert said <= set(TERMS)
    assert not set(priced_terms(COUNTS, table)) & set(unpriced_terms(COUNTS, table))
    assert all(joules > 0 for joules in priced_terms(COUNTS, table).values())


def test_what_does_not_happen_is_not_unknown():
    quiet = {"sop": 10.0, "neuron_update": 3.0}
    int8 = TABLES["horowitz45-int8"]
    assert unpriced_terms(quiet, int8) == ()
    assert unpriced_terms({**quiet, "message": 1.0}, int8) == ("messages",)
    assert priced_terms(quiet, int8)["idle"] == 0


def test_graded_operations_are_multiply_accumulates():
    found = chip_terms(COUNTS, TABLES["horowitz45-int8"])
    assert found["operations"] == pico(1000 * 1.35 + 13 * 1.55)
    assert found["updates"] == pico(211 * 26.5)


def test_a_neuron_update_of_the_int8_table_has_one_price_everywhere():
    # two multiplications, three additions, four accesses of 32 of 64 bits
    assert TABLES["horowitz45-int8"].joules["neuron_update"] == pico(2 * 3.1 + 3 * 0.1 + 4 * 5)


def test_the_host_is_priced_by_additions_and_accesses():
    assert prices.reading_energy(20) == pico(20 * 2.5)
    # as in the pareto experiment: read, subtract, compare, read the level; add and write an event
    once = prices.delta_encoder(20, 5)
    assert once == pico(20 * (2.5 + 0.1 + 0.1 + 2.5) + 5 * (0.1 + 2.5))
    # levels are compared in every timestep, observations read once
    assert prices.delta_encoder(20, 5, 3) - once == pico(20 * 2 * 2.7)
    # read and scaled once; in each timestep added, the accumulator read and written
    assert prices.rate_encoder(20, 16) == pico(20 * (2.5 + 3.1 + 0.1 + 16 * 5.1))
    assert prices.host_readout(100, 10, 4) == pico(104 * 1.35 + 10 * 1.55)


def test_resets_have_a_price_where_arithmetic_has_one():
    assert prices.reset_energy(10, TABLES["horowitz45-int8"]) == pico(50)
    assert prices.reset_energy(10, TABLES["davies2018"]) is None
    assert prices.reset_energy(0, TABLES["davies2018"]) == 0
