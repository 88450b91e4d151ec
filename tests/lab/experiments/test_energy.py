"""results/energy.csv is a plain recomputation of the counts, and what the script writes today."""

import csv

import pytest

from lab.experiments.energy import Energies, Pair, operations_ratio
from tests.paths import ROOT

RESULTS = ROOT / "results"

# [pJ] Horowitz 2014 at 45 nm: 10 an access of 64 bits, so 1.25 a weight, an index or an input of 8
# bits, 2.5 and 5 a sum of 16 and 32; 0.2 a product and 0.1 an addition
SOP = {"none": 1.25 + 0.1, "16": 1.25 + 1.25 + 5 + 0.1, "32": 1.25 + 1.25 + 10 + 0.1}
MAC = {"none": 1.25 + 0.3, "16": 3 * 1.25 + 0.3, "32": 3 * 1.25 + 0.3}
# an update with two states, and with one: products of 3.1, additions of 0.1, accesses of states
OWN = {
    "none": (2 * 3.1 + 3 * 0.1 + 4 * 5, 2 * 3.1 + 3 * 0.1 + 4 * 5),
    "16": (2 * 3.1 + 2 * 0.1 + 4 * 2.5, 3.1 + 2 * 2.5),
    "32": (2 * 3.1 + 2 * 0.1 + 4 * 5, 3.1 + 2 * 5),
}
TIMES = {"sanafe": (51.2 + 21.6) / 35.5, "davies2018": 81 / 23.6, "horowitz45-int8": 26.5 / 1.35}
TEXTS = ("task", "spiking", "baseline", "accumulator_bits", "encoder", "clock", "update_price_of")
FREE = {"gated": 1, "pipelined": 1, "free": 3}

PAIR = Pair(
    task="task", spiking="a", baseline="b", score=1.0, baseline_score=1.0,
    seeds=1, baseline_seeds=1,
    sops=100.0, updates=10.0, one_state=4.0, events=5.0, observations=20.0, constants=3.0,
    macs=200.0, baseline_observations=20.0, baseline_constants=8.0,
)  # fmt: skip


def published():
    with (RESULTS / "energy.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_csv_is_a_plain_recomputation_of_the_counts():
    seen = 0
    for row in published():
        n = {key: float(text) for key, text in row.items() if key not in TEXTS}
        sums, where, clock = row["accumulator_bits"], row["encoder"], row["clock"]
        whole, alone_ = OWN[sums]
        if row["update_price_of"] == "own":
            updates = (n["updates"] - n["one_state"]) * whole + n["one_state"] * alone_
        else:
            updates = n["updates"] * TIMES[row["update_price_of"]] * SOP[sums]
        read, other = n["observations"], n["baseline_observations"]
        encoder, reading = {
            "host": (0, 0),
            # read, subtract, compare, read the level; an event adds to the level and writes it
            "chip": (read * (2.5 + 0.1 + 0.1 + 2.5) + n["events"] * (0.1 + 2.5), other * 2.5),
            "software": (70 * (5 * read + 3 * n["events"]), 70 * 3 * other),
        }[where]
        spiking = n["sops"] * SOP[sums] + FREE[clock] * updates + encoder + n["constants"] * 1.35
        baseline = n["macs"] * MAC[sums] + reading + n["baseline_constants"] * 1.35
        assert 1e12 * n["spiking_j"] == pytest.approx(spiking, rel=1e-8)
        assert 1e12 * n["float_j"] == pytest.approx(baseline, rel=1e-8)
        assert n["ratio"] == pytest.approx(spiking / baseline, rel=1e-8)
        # at the price of an update that the row names, both cost the same
        flip = n["flips_at_update_over_sop"] * SOP[sums] * n["updates"] * FREE[clock]
        assert spiking - FREE[clock] * updates + flip == pytest.approx(baseline, rel=1e-6)
        seen += 1
    assert seen == 7 * 3 * 3 * 3 * 4


def test_an_own_update_of_the_readouts_has_one_state():
    energies = Energies(PAIR, "16", "host", "gated")
    # 6 of 16.4 pJ and 4 of 8.1; 100 SOPs of 7.6 pJ, 3 constants
    own = energies.update_over_sop("own")
    assert 1e12 * energies.spiking(own) == pytest.approx(6 * 16.4 + 4 * 8.1 + 760 + 3 * 1.35)
    assert energies.ratio(energies.flips_at) == pytest.approx(1)


def test_a_free_clock_updates_three_times_and_a_pipelined_one_once():
    once, twice, free = (
        Energies(PAIR, "none", "chip", clock) for clock in ("gated", "pipelined", "free")
    )
    assert once.spiking(2) == twice.spiking(2)
    assert 1e12 * (free.spiking(2) - once.spiking(2)) == pytest.approx(2 * 10 * 2 * 1.35)


def test_operations_alone_are_a_ratio_of_two_products():
    assert operations_ratio(PAIR, "none") == pytest.approx(100 * 1.35 / (200 * 1.55))
    assert operations_ratio(PAIR, "32") == pytest.approx(100 * 12.6 / (200 * 4.05))
    # without the read of an input of 8 bits
    assert operations_ratio(PAIR, "16", in_registers=True) == pytest.approx(100 * 7.6 / (200 * 2.8))
