"""Sentences on whether spiking saves energy, worked out by hand."""

import pytest

from spikedeploy.reports.datasheets import static_table
from spikedeploy.reports.summary import energy_verdict, sentences_of

INT8 = "horowitz45-int8"


def row(**changes):
    return {
        "policy": "walker",
        "kind": "snn",
        "chip": "loihi1",
        "return_mean": 5.0,
        "sops_per_inference": 100.0,
        "neuron_updates_per_inference": 10.0,
        "synapses": 1_000.0,
        "training_seeds": 1,
        "returns": [5.0, 5.0],
        "macs_effective": None,
        "energy_per_inference_j": {INT8: 1e-9},
        "energy_total_j": {INT8: 3e-9},
        "energy_zero_skipping_j": {},
        "static_energy_j": {"popsan2020": 3e-3, "frady2020": 2e-3},
        **changes,
    }


def rival(**changes):
    float_ = {"policy": "small", "kind": "mlp", "chip": None, "macs_effective": 80.0}
    return row(**float_, energy_total_j={INT8: 1.5e-9}, static_energy_j={}, **changes)


def test_counts_stand_beside_published_borders_and_the_rule_with_updates():
    text = energy_verdict([row()])
    # 100 SOPs over 1,000 synapses
    assert "receives 0.1 spikes a control step, below published borders of 0.15 to 1.72" in text
    # (100 x 1.35 + 10 x 26.5) / (1,000 x 1.55) = 400 / 1,550
    assert (
        "takes 26% of the energy of a dense float network of its shape by horowitz45-int8" in text
    )
    # (100 x 12.6 + 10 x 26.4) / (1,000 x 4.05) = 1,524 / 4,050
    assert "and 38% with sums in memory (horowitz45-int8-acc32)" in text
    many = energy_verdict([row(neuron_updates_per_inference=100.0)])
    # (135 + 2,650) / 1,550
    assert "takes 180% of the energy of a dense float network" in many
    # each can be read alone, as the terminal lists them
    assert not any(each.startswith(("With them", "It ")) for each in sentences_of(text))


@pytest.mark.parametrize(
    ("sops", "place"),
    [(200.0, "within published borders, 0.15 to 1.38 and 1.72"), (2_000.0, "above published")],
)
def test_a_row_within_or_above_the_borders_is_said_to_be(sops, place):
    assert place in energy_verdict([row(sops_per_inference=sops)])


def test_all_terms_stand_beside_those_of_the_smallest_float_policy_that_is_as_good():
    text = energy_verdict([row(), rival()])
    said = "By horowitz45-int8 all its known terms are 3.00 nJ, 2.0 times the 1.50 nJ of small."
    assert said in text
    skipping = rival(energy_zero_skipping_j={INT8: 0.75e-9})  # 0.25 nJ less than dense
    assert "2.4 times the 1.25 nJ of small, which skips inputs of 0." in energy_verdict(
        [row(), skipping]
    )
    worse = rival(returns=[1.0, 1.0])
    assert "all its known terms" not in energy_verdict([row(), worse])


OWN = {"davies2018": 4e-9, "sanafe": 8e-9, INT8: 1e-9}


@pytest.mark.parametrize(
    ("chip", "totals", "said"),
    [  # 2 mJ over all terms: by each of the chip's own tables, and not by the common one
        (
            "loihi1:weight_bits=4",
            OWN,
            "0.5 million times all known terms of walker by davies2018 and 0.25 million times by "
            "sanafe.",
        ),
        ("loihi1", {"sanafe": 8e-9, INT8: 1e-9}, "0.25 million times all known terms of walker by "
         "sanafe."),
        # of those that --energy names, where the chip's own are not among them
        ("loihi1", {INT8: 1e-8}, "0.2 million times all known terms of walker by horowitz45-int8."),
        (
            "xylo-a2",
            {INT8: 1e-6},
            "2,000 times all known terms of walker by horowitz45-int8, as no prices of xylo-a2 are "
            "published.",
        ),
    ],
)  # fmt: skip
def test_static_power_is_divided_by_all_terms_at_the_chips_own_prices(chip, totals, said):
    powers = {"xylo2023": 2e-3} if chip == "xylo-a2" else {"popsan2020": 3e-3, "frady2020": 2e-3}
    text = energy_verdict([row(chip=chip, energy_total_j=totals, static_energy_j=powers)])
    assert text.endswith(f"2.00 mJ in a control step, {said}")
    assert chip == "xylo-a2" or "loihi1 idles at 0.10 W (Frady et al. 2020: Pohoiki" in text


def test_static_power_is_left_out_where_it_or_the_energy_is_not_known():
    assert "idles" not in energy_verdict([row(static_energy_j={})])
    assert "idles" not in energy_verdict([row(energy_total_j={INT8: None})])


def test_nothing_is_said_where_nothing_spikes_on_a_chip():
    assert energy_verdict([rival()]) == ""
    assert energy_verdict([row(chip="float")]) == ""


def test_the_rate_at_which_operations_take_as_much_as_idling_is_shown():
    table = static_table()
    first = dict(zip(table.columns, table.rows[0], strict=True))
    # 104 mW / 23.6 pJ
    assert (first["chip"], first["SOPs/s that take as much"]) == ("loihi1", "4.4e+09")
    # 1,000 x 3.5 ns / 20 ms
    assert first["duty cycle"] == "0.018 %"


def test_sentences_are_told_apart_and_names_of_papers_are_not():
    assert sentences_of("It is (Davies et al. 2018). So it is.") == [
        "It is (Davies et al. 2018).",
        "So it is.",
    ]
