"""Break-even lines: at the line both networks cost the same, worked out by hand."""

import pytest

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metrics.energy import (
    BREAK_EVEN_TABLES,
    TABLES,
    break_even_rate,
    break_even_sops,
)

INT8 = TABLES["horowitz45-int8"]


def test_the_tables_are_those_that_price_both_kinds():
    int8 = "horowitz45-int8"
    assert ("horowitz45", int8, f"{int8}-acc16", f"{int8}-acc32") == BREAK_EVEN_TABLES
    with pytest.raises(ConfigError, match="no price for both"):
        break_even_rate(TABLES["davies2018"], 5)


def test_a_rate_is_the_ratio_of_the_prices_over_the_timesteps():
    # 1.55 pJ / (5 x 1.35 pJ)
    assert break_even_rate(INT8, 5) == pytest.approx(1.55 / 1.35 / 5)
    # half of the inputs skipped
    assert break_even_rate(INT8, 5, activity=0.5) == pytest.approx(0.5 * 1.55 / 1.35 / 5)


@pytest.mark.parametrize("timesteps", [1, 5, 16])
@pytest.mark.parametrize("activity", [1.0, 0.3])
def test_at_the_rate_two_layers_of_one_shape_cost_the_same(timesteps, activity):
    fan_in, neurons = 400, 30
    rate = break_even_rate(INT8, timesteps, fan_in, activity)
    prices = INT8.joules
    spiking = timesteps * neurons * (rate * fan_in * prices["sop"] + prices["neuron_update"])
    assert spiking == pytest.approx(activity * neurons * fan_in * prices["mac"])


def test_updates_alone_can_cost_more_than_a_float_network():
    # 16 x 26.5 pJ for each neuron, against 32 x 1.55 pJ
    assert break_even_rate(INT8, 16, 32) < 0
    assert break_even_rate(INT8, 16) > 0


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
    table = TABLES[f"horowitz45-int8{sums}"]
    assert break_even_rate(table, 1, least, active) >= 0.05 - 1e-9
    assert break_even_rate(table, 1, least - 1, active) < 0.05


def test_spikes_as_frequent_as_a_third_of_the_inputs_never_pay_with_sums_of_32_bits():
    assert break_even_rate(TABLES["horowitz45-int8-acc32"], 1, 10**9, 0.1) < 0.05
