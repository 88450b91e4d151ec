"""The map of kart-eye in its smallest size, with untrained policies; its prices and its rule."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from lab.experiments.eye_costs import (
    ACCOUNTINGS,
    TERMS,
    border,
    latency,
    occupied,
    places_of,
    power,
    predict,
    terms,
)
from lab.experiments.eye_map import MAP, NOT_PRUNED, EyeMapDesign, hold
from lab.experiments.eye_map_page import EQUAL, errors, maps
from lab.experiments.pages import grouped
from lab.experiments.runner import run_experiment
from lab.experiments.vision import (
    CountedFloatController,
    Execution,
    chip_of,
    drive,
    make_controller,
    own_way,
    wait_longer,
)
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.policies import FloatVisionPolicy, SpikingVisionPolicy
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.config import SparseConfig

SMALL = {"channels": [2], "kernels": [3], "strides": [4], "hidden": [4], "gru": 4}
NO_ZEROS = "zero-skipping"
IF = {"recurrent": False, "skip": False, "neuron": "if", "clock": "gated"}
POLICIES = {
    "kart-eye-cnn": lambda: FloatVisionPolicy(1024, 7, **SMALL),
    "kart-eye-snn": lambda: SpikingVisionPolicy(1024, 7, (2, 16, 32), 1, [2], [3], [4], 6),
    "kart-eye-if": lambda: SpikingVisionPolicy(
        1024, 7, (2, 16, 32), 1, [2], [3], [4], 6, **IF
    ),
}  # fmt: skip


def untrained_run(folder, recipe, seed=0, **options):
    torch.manual_seed(seed)
    run = RunFolder(folder / f"{recipe}-s{seed}-{len(list(folder.glob('*')))}")
    (run.path / "checkpoints").mkdir(parents=True)
    made = [f"env.options.{name}={value}" for name, value in options.items()]
    run.write_config(resolve(SparseConfig, recipe, overrides=made, seed=seed))
    run.save("best", POLICIES[recipe](), {})
    return run


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    runs = tmp_path_factory.mktemp("map") / "runs"
    for recipe in POLICIES:
        untrained_run(runs, recipe, forks=1)
    return EyeMapDesign(runs=str(runs), episodes=2, limit=12, quick=True)


@pytest.fixture(scope="module")
def results(design, ran):
    folder = Path(design.runs).parent / "results"
    outcome = run_experiment(design, (), 1, folder)
    assert (outcome.done, outcome.of, outcome.failed) == (12, 12, {})
    return folder


def test_every_policy_is_driven_in_every_cell_by_every_way_or_chip(design, results):
    driven = [row for part in design.parts() for row in part.found]
    chips = 2 + 2  # two of LIF neurons, and one of the others, with a gate as well
    rarely = [way for way in MAP["ways"] if "every" in way]  # of what is transferred
    assert len(driven) == 4 * (len(MAP["ways"]) + chips) - 2 * len(rarely)
    assert {row["rate"] for row in driven if row["way"] in rarely} == {960}
    assert {(row["rate"], row["quiet"]) for row in driven} == set(design.cells)
    assert all(row["trained_rate"] == 60 for row in driven)


def test_the_page_compares_each_chip_with_the_best_float_network(design, results):
    text = (results / "kart-eye-map.md").read_text(encoding="utf-8")
    for accounting in ACCOUNTINGS.values():
        assert f"### {accounting.title}" in text
    assert (results / "kart-eye-map.png").stat().st_size > 10_000
    rows = list(design.all_rows())
    for found in maps(rows):
        for cell in (cell for row in found.cells for cell in row if cell is not None):
            at_rate = [row for row in rows if row["rate"] == cell.rate]
            finished = {
                key: np.mean([row["finished"] for row in of if row["quiet"] in (0, 0.5)])
                for key, of in grouped(at_rate, "policy", "way")
            }
            there = [row for row in at_rate if row["quiet"] == cell.quiet]
            floats = [row for row in there if not row["spiking"]]
            reference = NO_ZEROS if cell.rate == 60 else f"{NO_ZEROS} at 60 Hz"
            usual = max(finished[r["policy"], r["way"]] for r in floats if r["way"] == reference)
            equal = [row for row in floats if finished[row["policy"], row["way"]] >= usual - EQUAL]
            chips = [
                r for r in there if r["spiking"] and chip_of(r["way"]) == cell.accounting.place
            ]
            able = [r for r in chips if finished[r["policy"], r["way"]] >= usual - EQUAL]
            as_good = [row for row in able if own_way(row["way"]) == row["way"]]
            assert cell.is_equal == bool(as_good)
            assert (cell.later is not None) == bool(able)
            (spiking,) = cell.spiking.rows
            assert spiking in (as_good or chips)
            as_late = max(latency(spiking), 1 / cell.rate) + 0.1 / cell.rate
            no_later = [row for row in equal if latency(row) <= as_late]
            mine, least, all_mine, cheapest = (
                min(power(row, found.accounting) for row in rows)
                for rows in (as_good or [spiking], no_later, able or [spiking], equal)
            )
            assert cell.ratio == pytest.approx(mine / least)
            as_soon = [r for r in equal if latency(r) <= latency(spiking) + 0.1 / cell.rate]
            soonest = min((power(row, found.accounting) for row in as_soon), default=math.inf)
            assert (cell.prompt_ratio or 0.0) == pytest.approx(mine / soonest)
            gathers = replace(found.accounting, gathers=True)
            in_registers = min(power(row, gathers) for row in no_later)
            assert cell.register_ratio == pytest.approx(mine / in_registers)
            if able:
                assert cell.later_ratio == pytest.approx(all_mine / cheapest)


def test_a_cell_is_undecided_where_courses_leave_it_open(design, results):
    cells = (c for found in maps(list(design.all_rows())) for row in found.cells for c in row)
    cell = replace(next(c for c in cells if c is not None), is_equal=True)
    draws = 2_000
    for ratios, verdict in (
        ([0.8, 0.9] * (draws // 2), "spiking"),
        ([1.1, 1.2] * (draws // 2), "float"),
        ([0.9, 1.1] * (draws // 2), "undecided"),
        ([0.8] * (draws * 9 // 10), "undecided"),  # in the others no spiking policy is equal
    ):
        assert replace(cell, resampled=np.array(ratios)).verdict == verdict
    assert replace(cell, is_equal=False).verdict == "no spiking policy"


def test_what_runs_at_the_rate_of_its_training_costs_the_same_at_any_control_rate(design, results):
    rows = {(r["policy"], r["way"], r["rate"], r["quiet"]): r for r in design.all_rows()}
    held = [key for key in rows if own_way(key[1]) != key[1]]
    assert {key[2] for key in held} == {240, 960}
    for policy, way, rate, quiet in held:
        row, slow = rows[policy, way, rate, quiet], rows[policy, own_way(way), 60, quiet]
        assert latency(row) == pytest.approx(latency(slow))
        for accounting in ACCOUNTINGS.values():
            assert power(row, accounting) == pytest.approx(power(slow, accounting))


def test_a_float_network_held_by_derivation_is_that_which_runs_in_every_fourth_step():
    """But for the pictures, of which the camera has as many at 60 Hz as at 240 Hz."""
    torch.manual_seed(0)
    policy, options = POLICIES["kart-eye-cnn"](), {"forks": 1}
    slow = drive(options, make_controller(policy, 2, NO_ZEROS), 2, 60)[0]
    made = drive(
        options | {"rate": 240}, CountedFloatController(policy, 2, Execution(every=4), 4), 2, 240
    )[0]
    about = {"rate": 60, "way": NO_ZEROS, "late": [0, 0]}
    held = hold(slow | about, 240)
    assert made["steps"] == pytest.approx(held["steps"], abs=8)  # whole control steps
    assert made["runs"] == pytest.approx(held["runs"], rel=0.02)
    # it runs first when a quarter of a control step has been seen
    assert made["macs"] == pytest.approx(held["macs"], rel=0.1)
    assert made["events"] == pytest.approx(held["events"], rel=0.1)


def test_a_gate_leaves_out_what_comes_at_rest():
    torch.manual_seed(0)
    options = {"quiet": 0.5, "forks": 1}
    spiking, floats = POLICIES["kart-eye-if"](), POLICIES["kart-eye-cnn"]()
    for policy, way, gated, count in (
        (spiking, "speck2f", "speck2f gated by 16 events", "neuron_update"),
        (floats, NO_ZEROS, "gated by 16 events", "runs"),
    ):
        found = [drive(options, make_controller(policy, 2, w), 2, 150)[0] for w in (way, gated)]
        assert found[1]["still"][count] < 0.2 * found[0]["still"][count]
        assert found[1][count] < found[0][count]
        assert found[1]["events"] > 0


def test_the_rule_starts_from_counts_at_the_rate_of_the_training(design):
    rows = [
        row for row in design.all_rows() if not row["spiking"] or own_way(row["way"]) == row["way"]
    ]
    faster = [
        {**row, "policy": f"{row['policy']} at 960 Hz", "trained_rate": 960, "macs": 1.0}
        for row in rows
        if row["rate"] == 960
    ]
    (each, *_), (with_faster, *_) = maps(rows), maps([*rows, *faster])
    cell, other = each.cells[-1][0], with_faster.cells[-1][0]
    assert len(other.others) == 2 * len(cell.others)
    # of cells whose counts it has there are no errors
    assert len(errors(with_faster)) == len(errors(each))
    assert other.rival.key[0] == "kart-eye-cnn at 960 Hz"
    # its counts, and not those of its like at 60 Hz, are those that the rule has
    assert other.predicted > 1.5 * cell.predicted


def test_what_is_there_is_not_made_again(design, results, ran):
    before = len(ran)
    outcome = run_experiment(design, (), 1, results)
    assert len(ran) == before
    assert outcome.done == outcome.of


def test_trainings_drive_at_their_rate_and_at_higher_ones(tmp_path):
    untrained_run(tmp_path, "kart-eye-cnn", forks=1)
    untrained_run(tmp_path, "kart-eye-cnn", forks=1, rate=240)

    def driven(made):
        return {
            (each.name, row.of["options"]["rate"], row.of["options"]["rate"] // each.rate)
            for part in made.parts()
            for row in part.rows()
            for each in row.make.args[:1]
        }

    some = {
        ("kart-eye-cnn", 60, 1),
        ("kart-eye-cnn", 240, 4),
        ("kart-eye-cnn at 240 Hz", 240, 1),
    }
    assert driven(EyeMapDesign(runs=str(tmp_path))) == some  # at 960 Hz those that are listed
    named = [str(run) for run in tmp_path.iterdir()]
    highest = {("kart-eye-cnn", 960, 16), ("kart-eye-cnn at 240 Hz", 960, 4)}
    assert driven(EyeMapDesign(runs=str(tmp_path), policies=named)) == some | highest


def test_pruned_policies_are_driven_and_those_pruned_most_in_all_ways(tmp_path):
    run = untrained_run(tmp_path, "kart-eye-cnn", forks=1)
    for level in ("ops-40000", "ops-60000", NOT_PRUNED):
        run.save(level, POLICIES["kart-eye-cnn"](), {})
    ways = {each.level: each.ways(60) for each in EyeMapDesign(runs=str(tmp_path)).checkpoints()}
    rarely = ["zero-skipping"]
    assert ways == {"ops-40000": MAP["ways"][:-2], "ops-60000": rarely, NOT_PRUNED: rarely}


def test_a_policy_has_the_level_of_the_one_that_its_training_started_from(tmp_path):
    first = untrained_run(tmp_path, "kart-eye-cnn", forks=1)
    for level in ("ops-40000", NOT_PRUNED):
        first.save(level, POLICIES["kart-eye-cnn"](), {})
    second = untrained_run(tmp_path, "kart-eye-cnn", forks=1, rate=240)
    config = second.config(SparseConfig).model_copy(
        update={"start": f"elsewhere/{first.path.name}"}
    )
    second.write_config(config)
    second.save(NOT_PRUNED, POLICIES["kart-eye-cnn"](), {})
    names = {each.name for each in EyeMapDesign(runs=str(tmp_path)).checkpoints()}
    pruned = "kart-eye-cnn ops-40000"
    assert names == {"kart-eye-cnn", pruned, f"{pruned} at 240 Hz"}


def test_a_map_without_policies_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="no run folder of kart-eye"):
        EyeMapDesign(runs=str(tmp_path)).check(tmp_path)


class Straight:
    """Straight on through the first gate and into the wall; counts steps and events."""

    def __init__(self, karts):
        self.totals = {"runs": np.zeros(karts), "events": np.zeros(karts)}

    def act(self, counts):
        self.totals["runs"] += 1
        self.totals["events"] += counts.sum(1)
        return np.full(len(counts), 3)


def test_longer_waits_follow_from_shorter_ones():
    def driven(quiet):
        return {"quiet": quiet} | drive({"quiet": quiet, "forks": 1}, Straight(3), 3)[0]

    found, wanted = wait_longer(driven(0.5), 0.8), driven(0.8)
    assert found["steps"] == pytest.approx(wanted["steps"], abs=6)  # whole control steps
    assert found["steps"] > 1.5 * driven(0.5)["steps"]
    assert found["runs"] == pytest.approx(1.0)
    assert found["events"] == pytest.approx(wanted["events"], rel=0.05)


# prices


def counted(**changes):
    names = (
        "macs first_macs changed_macs conv_macs dense_macs first_dense_macs cells sent "
        "compared behind_weights memory_weights units first_units gates events sop graded_sop "
        "bias_sop neuron_update one_state_update neuron_idle touched spike_in spike_out "
        "message constants"
    )
    zeros = dict.fromkeys(names.split(), 0.0)
    about = {"rate": 100, "span": 0.01, "runs": 1.0, "late": [2, 3], "way": "zero-skipping"}
    about["behind_weights"] = 1e4
    return {**zeros, "spiking": False, **about, **changes}


ARRAY = 0.3 + 1.25 / 16 + 5 / 16  # [pJ] a multiplication in an array


@pytest.mark.parametrize(
    ("changed", "first", "dense", "pico"),
    [
        (70, 500, 1000, 100 * 1.55),  # zeros left out
        (10, 500, 1000, 70 * 1.55 + 2 * 2 * 2.5),  # only what changed, onto sums that are kept
        (70, 35, 60, 40 * 1.55 + 60 * ARRAY),  # all of them in an array
        (70, 35, 1000, 60 * 1.55 + 35 * ARRAY),  # those of the first layer in an array
        (10, 50, 70, 10 * 1.55 + 2 * 2 * 2.5 + 20 * ARRAY + 40 * 1.55),  # those behind it
        (70, 0, 0, 100 * 1.55),  # no convolution
    ],
)
def test_multiplications_of_each_layer_are_done_by_the_cheapest_circuit(
    changed, first, dense, pico
):
    row = counted(
        macs=100, first_macs=40, changed_macs=changed, first_units=2,
        conv_macs=60 if dense else 0, dense_macs=dense, first_dense_macs=first,
    )  # fmt: skip
    found = terms(row, ACCOUNTINGS["int"])["operations"]
    assert found == pytest.approx(100e-12 * pico)


@pytest.mark.parametrize(
    ("compared", "pico"),
    [
        (0, 60 * 7.8 + 30 * 7.8 + 10 * 4.05),  # what reads the memory in registers
        (0.1, 60 * 7.8 + 40 * 7.8),  # a delta network sends less than all of its memory
        (0, 60 * 7.8 + 41 * 4.05),  # all layers behind the convolutions in registers
    ],
)
def test_layers_behind_the_convolutions_may_keep_their_sums_in_registers(compared, pico):
    behind = 41 if pico < 700 else 90
    row = counted(
        macs=100, first_macs=60, changed_macs=1e4, first_dense_macs=1e4, conv_macs=60,
        dense_macs=1e4, memory_weights=10, behind_weights=behind, compared=compared,
    )  # fmt: skip
    found = terms(row, ACCOUNTINGS["speck"])["operations"]
    assert found == pytest.approx(100e-12 * pico)


def test_a_float_network_costs_what_its_terms_say():
    row = counted(macs=100, changed_macs=1e4, cells=10, events=20, sent=7, units=3, gates=2)
    # [pJ] Horowitz 2014: 1.25 a byte, 0.1 an addition, 3.1 a product, 2.5 an access of 16 bits
    expected = {
        "operations": 155, "updates": 2 * (5 * 2.5 + 3 * 3.1 + 0.5), "traffic": 7 * 2.5,
        "histogram": 20 * 2.6 + 10 * 7.5, "constants": 3 * 1.35, "comparisons": 0,
    }  # fmt: skip
    found = terms(row, ACCOUNTINGS["int"])
    assert found.keys() == set(TERMS)
    for name, pico in expected.items():
        assert found[name] == pytest.approx(100e-12 * pico), name


def test_what_is_scattered_into_memory_costs_as_much_of_both_kinds():
    row = counted(macs=100, first_macs=40, changed_macs=1e4)
    spiking = counted(spiking=True, sop=100)
    of_float, of_spikes = (terms(r, ACCOUNTINGS["speck"])["operations"] for r in (row, spiking))
    assert of_float - of_spikes == pytest.approx(100e-12 * 100 * 0.2)  # a product of 8 bits


def test_a_delta_network_pays_for_units_whose_inputs_changed():
    found = terms(counted(compared=10, sent=4, units=50), ACCOUNTINGS["int"])["comparisons"]
    # their sums read and written, two subtractions and a read each; what is sent is stored
    assert found == pytest.approx(100e-12 * (10 * (5 + 0.2 + 2.5) + 4 * 2.6))


def test_a_chip_pays_for_all_neurons_or_for_those_that_are_touched():
    row = counted(spiking=True, sop=100, neuron_update=40, one_state_update=30, touched=10)
    found = {name: terms(row, each) for name, each in ACCOUNTINGS.items()}
    assert found["int"]["updates"] == pytest.approx(100e-12 * (10 * 16.5 + 30 * 8.3))
    assert found["speck"]["updates"] == pytest.approx(100e-12 * 40 * 5.2)
    assert found["speck-touched"]["updates"] == pytest.approx(100e-12 * 10 * 5.2)
    # silicon's update over its synaptic operation
    ratio = (51.2 + 21.6) / 35.5
    assert found["loihi1"]["updates"] == pytest.approx(100e-12 * 40 * 1.35 * ratio)
    assert found["loihi1"]["operations"] == found["int"]["operations"]


def test_an_event_waits_for_a_control_step_for_layers_or_until_the_network_runs():
    assert latency(counted(spiking=True)) == pytest.approx(0.025)
    assert latency(counted(wait=1.5)) == pytest.approx(0.02)


# the rule


@pytest.mark.parametrize(("rate", "runs"), [(4, 4), (200, 1 / (0.064 + 0.0025)), (4000, 15.5)])
def test_a_network_that_events_trigger_runs_as_often_as_a_simulation_says(rate, runs):
    """1,000 events a second; it runs as soon as 64 have come and the control step is over."""
    row = counted(way="triggered by 64 events", events=20, cells=19, macs=9, rate=50, runs=0.9)
    found = predict(row, row | {"events": 0}, rate, 1000.0, 0.02)["runs"] * rate
    since, ran = 0, 0
    arriving = np.random.default_rng(0).poisson(1000 / rate, 60 * rate)
    for events in arriving:
        since += events
        if since >= 64:
            since, ran = 0, ran + 1
    assert found == pytest.approx(runs, rel=0.01)
    assert found == pytest.approx(ran / 60, rel=0.25)


@pytest.mark.parametrize(("events", "places"), [(3.0, 1000.0), (500.0, 400.0), (1e4, 1e4)])
def test_places_are_found_from_events_and_the_places_that_they_fell_in(events, places):
    assert places_of(events, occupied(events, places)) == pytest.approx(places, rel=1e-4)


def test_occupied_places_are_those_of_random_draws():
    drawn = np.random.default_rng(0).integers(0, 50, (2000, 40))
    mean = np.mean([len(np.unique(row)) for row in drawn])
    assert occupied(40, 50) == pytest.approx(mean, rel=0.02)


@pytest.mark.parametrize("spiking", [False, True])
def test_the_rule_gives_back_the_counts_that_it_starts_from(spiking):
    row = counted(
        spiking=spiking, macs=100, first_macs=40, changed_macs=50, conv_macs=70, cells=9,
        events=10, sent=7, units=3, gates=2,
        sop=80, touched=60, spike_in=5, spike_out=4, message=6, neuron_update=90,
    )  # fmt: skip
    rest = row | {"events": 4, "cells": 3.6, "sop": 40, "sent": 5, "macs": 70, "first_macs": 16}
    rest |= {"changed_macs": 20, "conv_macs": 36}
    floats = ("macs", "first_macs", "changed_macs", "conv_macs", "sent")
    names = {"events", "cells", "rate", *(("sop",) if spiking else floats)}
    for start in (row, rest):
        again = predict(row, rest, row["rate"], start["events"] * row["rate"], row["span"])
        expected = {name: start[name] for name in names}
        assert {name: again[name] for name in names} == pytest.approx(expected)
    if spiking:
        once = predict(row, rest, row["rate"], row["events"] * row["rate"], row["span"])
        assert once["touched"] == pytest.approx(row["touched"])


def test_at_a_border_that_counts_give_in_closed_form_both_cost_the_same():
    """Cells with one event at most, no layers behind the first: r rest = e operations."""
    events, rate = 100.0, 10.0  # a second; of the counts
    chip = counted(
        spiking=True, rate=rate, events=10, cells=10 * (1 - 1e-9), sop=1000, touched=0,
    )  # fmt: skip
    net = counted(rate=rate, span=1e-9, events=10, cells=1e-6, first_macs=0, macs=50)
    by = replace(ACCOUNTINGS["int"], touched=True)
    # both add up the events, the float network sees none of them: e 100 sop + cells = r 50 mac
    wanted = events * (100 * 1.35 + 7.5) / (50 * 1.55)

    def ratio(at):
        rest = {"events": 0, "cells": 0, "sop": 0}
        mine = predict(chip, chip | rest, at, events, 1e-9)
        other = predict(net, net | {"events": 0, "cells": 0}, at, events, 1e-9)
        spent = [power(row, by) - row["rate"] * row["events"] * 2.6e-12 for row in (mine, other)]
        return spent[0] / spent[1]

    rates = list(np.geomspace(10, 1000, 400))
    assert border(rates, [ratio(at) for at in rates]) == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize(
    ("ratios", "at"),
    [
        ((2.0, 0.5, 0.1), 120.0),
        ((0.9, 0.5, 0.1), 0.0),
        ((0.5, 2.0, 0.5), 480.0),
        ((3.0, 2.0, 1.5), math.inf),
    ],
)
def test_a_border_lies_between_rates_by_their_logarithms(ratios, at):
    assert border((60, 240, 960), ratios) == pytest.approx(at)
