"""Energies of the pareto experiment by hand, its baselines, its rounding, its counts."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from lab.experiments.pareto import networks, records, tables
from lab.experiments.pareto.costs import INT8, LEAN_UPDATE, energies, terms, total
from lab.experiments.pareto.fronts import Point, pairing, pairing_at, points
from lab.experiments.pareto.overview import cheapest
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.trainers.policies import PrunedMlpPolicy
from spikedeploy.trainers.sparse.pool import Walk
from tests.paths import ROOT

SPIKING = {
    "operations": 100.0, "bias_operations": 0.0, "neuron_updates": 10.0, "neuron_idle": 4.0,
    "messages": 6.0, "spikes_out": 2.0, "observations": 20.0, "events": 5.0, "constants": 3.0,
}  # fmt: skip
FLOAT = {"operations": 200.0, "observations": 20.0, "constants": 8.0}


def pico(joules):
    return {name: 1e12 * value for name, value in joules.items()}


def test_every_term_of_a_spiking_policy_is_what_the_page_says():
    assert pico(terms(SPIKING, INT8)) == pytest.approx(
        {
            "operations": 100 * 1.35,
            "updates": 10 * 26.5,
            "traffic": 0.0,
            # read the observation, subtract, compare, read the level; add and write an event
            "encoder": 20 * (2.5 + 0.1 + 0.1 + 2.5) + 5 * (0.1 + 2.5),
            "constants": 3 * 1.35,
        }
    )
    lean = pico(terms(SPIKING, INT8, lean=True))["updates"]
    assert lean == pytest.approx(10 * 10.5)
    assert pytest.approx(10.5e-12) == LEAN_UPDATE


def test_an_operation_of_a_graded_spike_costs_a_multiply_accumulate():
    graded = terms({**SPIKING, "graded_operations": 40.0}, INT8)
    assert pico(graded)["operations"] == pytest.approx(60 * 1.35 + 40 * 1.55)
    # tables without a price for it charge an operation
    assert terms({**SPIKING, "graded_operations": 40.0}, "davies2018") == terms(
        SPIKING, "davies2018"
    )


def test_chips_price_idle_neurons_and_messages_too():
    found = pico(terms(SPIKING, "davies2018"))
    assert found["operations"] == pytest.approx(100 * 23.6)
    assert found["updates"] == pytest.approx(10 * 81 + 4 * 52)
    assert found["traffic"] == pytest.approx(6 * 1.7)
    assert found["encoder"] == pico(terms(SPIKING, INT8))["encoder"]  # the host's, in all tables


def test_a_float_policy_reads_its_observations_and_has_no_encoder():
    assert pico(terms(FLOAT, INT8)) == pytest.approx(
        {
            "operations": 200 * 1.55, "updates": 0.0, "traffic": 0.0, "encoder": 20 * 2.5,
            "constants": 8 * 1.35,
        }
    )  # fmt: skip
    assert not any(name.startswith("davies2018") for name in energies(FLOAT))


def test_what_the_host_integrates_has_no_price():
    assert energies({**SPIKING, "on_host": 18.0}) == {}


def test_totals_add_up_their_terms():
    assert total(SPIKING, INT8, "operations") == pytest.approx(135e-12)
    assert total(SPIKING, INT8, "updates") == pytest.approx((135 + 265) * 1e-12)
    assert total(SPIKING, INT8, "all") == pytest.approx(sum(terms(SPIKING, INT8).values()))


def point(student, score, operations, level=100.0):
    costs = SPIKING if student.startswith("sparse") else FLOAT
    row = {**costs, "student": student, "operations": operations, "scores": [score, score]}
    return Point(student, level, "here", [row], [10.0, 10.0])


def test_a_baseline_is_the_cheapest_float_student_that_is_not_below():
    mine = point("sparse", 9.8, 50.0)
    found = [
        mine, point("small-mlp", 10.0, 300.0), point("small-linear", 9.9, 250.0),
        point("small-linear", 9.7, 100.0),
    ]  # fmt: skip
    pair = pairing(found, mine, "operations")
    assert pair.baseline is found[2]
    assert pair.ratio == pytest.approx(50 * 1.35 / (250 * 1.55))
    assert pairing(found, point("sparse", 10.1, 50.0), "operations").ratio is None


def test_the_overview_has_the_cheapest_of_the_good_levels_or_the_best_of_the_bad():
    levels = [point("sparse", 9.9, 80.0, 84), point("sparse", 9.8, 60.0, 66)]
    levels += [point("sparse", 9.0, 40.0, 50), point("small-mlp", 9.1, 90.0, 100)]
    levels += [point("small-mlp", 9.5, 150.0, 180)]
    assert [(p.student, p.level) for p in cheapest(levels)] == [("sparse", 66), ("small-mlp", 180)]


def test_bounds_are_the_same_for_spiking_and_float_points():
    found = [
        point("sparse", 9.9, 90.0), point("sparse", 9.6, 60.0), point("sparse-linear", 5.0, 1.0),
        point("small-mlp", 9.85, 300.0), point("small-mlp", 9.55, 70.0),
    ]  # fmt: skip
    strict, loose = (pairing_at(found, share, "operations") for share in (0.98, 0.95))
    assert (strict.point, strict.baseline) == (found[0], found[3])
    assert (loose.point, loose.baseline) == (found[1], found[4])
    assert pairing_at(found[2:], 0.95, "operations") is None
    assert pairing_at(found[:2], 0.95, "operations").ratio is None


def test_sentences_say_who_wins_and_which_term_decides():
    found = [point("sparse", 9.9, 50.0), point("small-mlp", 10.0, 100.0)]
    alone, updates, *_ = tables.sentences(found)
    assert alone == (
        "- ✓ Operations alone: for 98% of the teacher's score LIF at 100 (99.0%) costs 68 pJ, "
        "float MLP at 100 (100.0%) 155 pJ: 0.44 times; for 95% of the teacher's score LIF at 100 "
        "(99.0%) costs 68 pJ, float MLP at 100 (100.0%) 155 pJ: 0.44 times."
    )
    # 155 - 67.5 = 87.5 of the 265 pJ of updates
    assert updates.startswith("- ✗ With neuron updates")
    assert (
        "80% of the first is for the neuron updates; it would draw level if that cost 0.33"
        in updates
    )
    alone = point("sparse", 9.9, 50.0)
    assert "no float student is evaluated yet" in tables.sentences([alone])[0]
    worse = tables.sentences([alone, point("small-mlp", 9.6, 50.0)])[0]
    assert "LIF at 100 (99.0%) costs 68 pJ, no float student is good enough; for 95%" in worse
    nothing = tables.sentences([alone, point("small-mlp", 9.4, 50.0)])
    assert "no float student reaches the return of a spiking one" in nothing[0]


def test_weights_in_few_bits_fill_their_range_and_zeros_cost_nothing():
    policy = PrunedMlpPolicy(3, 1, hidden=())
    policy.matrices[0].weight.data = torch.tensor([[1.0, -0.5, 0.1]])
    rounded = networks.in_bits(policy, 2)  # -1, 0, 1
    assert rounded.matrices[0]().tolist() == [[1.0, -0.0, 0.0]]
    assert rounded.matrices[0].fan_out.tolist() == [1.0, 0.0, 0.0]
    policy.matrices[0].weight.data = torch.tensor([[7.0, -3.4, 0.2]])
    policy.matrices[0].mask.fill_(1.0)
    assert networks.in_bits(policy, 4).matrices[0]().tolist() == [[7.0, -3.0, 0.0]]


def test_robots_at_their_end_are_not_counted():
    counts = np.zeros((3 * 2, 1, len(EVENTS)), np.int64)  # three control steps of two robots
    counts[:, 0, EVENTS.index("sop")] = [1, 10, 1, 1000, 1, 1000]
    counts[:, 0, EVENTS.index("graded_sop")] = [0, 4, 0, 1000, 0, 1000]
    ledger = Ledger(("out",), (4,), counts, 6, 6, 6, readouts=("out",))
    layer = SimpleNamespace(name="out", synapses=(), size=4)
    # what no synapse reads has a step of infinity, and costs the encoder nothing
    encoder = DeltaEncoder(np.array([0.5, np.inf, 1.0]), most=2)
    program = SimpleNamespace(
        layers=(layer,), spiking=(), input="in", readout=None, outlets=(), host=()
    )
    running = SimpleNamespace(
        spiking=SimpleNamespace(ledger=ledger, program=program),
        artifact=SimpleNamespace(codec=SimpleNamespace(encoder=encoder)),
    )
    walks = [Walk(np.zeros((n, 1), np.float32), np.zeros((n, 0), np.float32)) for n in (3, 1)]
    found = networks._counted(running, walks)
    assert found["operations"] == (1 + 1 + 1 + 10) / 4
    assert found["graded_operations"] == 4 / 4
    assert found["sparsity"] is None
    assert found["observations"] == 2


def test_a_teacher_that_scores_nothing_leaves_no_share():
    beside = point("sparse", 1.0, 50.0)
    nothing = Point("sparse", 100.0, "here", beside.rows, [0.0, 0.0])
    assert math.isnan(nothing.of_teacher.mean)
    assert tables.of_teacher(nothing) == "–"


def test_a_baseline_with_reward_counts_and_is_named(tmp_path):
    def row(student, score, operations, **more):
        costs = SPIKING if student.startswith("sparse") else FLOAT
        return {
            **costs, "student": student, "operations": operations, "scores": [score, score],
            "level": 60.0, "place": "here", "part": "levels", **more,
        }  # fmt: skip

    rows = [
        {"student": "teacher", "scores": [10.0, 10.0]},
        row("sparse", 9.7, 90.0),
        row("sparse", 9.9, 80.0, trained_by="reward"),
        row("small-mlp", 9.6, 100.0, trained_by="imitation"),
        row("small-mlp", 9.9, 110.0, trained_by="reward"),
    ]
    found = points(records.read(records.write(rows, tmp_path / "rows.csv")))
    assert [each.label for each in found] == [
        "LIF", "LIF, with reward", "float MLP", "float MLP, with reward",
    ]  # fmt: skip
    best = pairing_at(found, 0.98, "operations")
    assert (best.point, best.baseline) == (found[1], found[3])
    assert "LIF, with reward at 60 (99.0%) costs" in tables.sentences(found)[0]


@pytest.mark.parametrize(
    "path", sorted((ROOT / "results/pareto").glob("*.csv")), ids=lambda p: p.stem
)
def test_published_energies_follow_from_the_published_counts(path):
    rows = records.read(path)
    for row in rows:
        for name, joules in energies(row).items():
            # both are rounded to ten digits
            assert row[name] == pytest.approx(joules, rel=1e-9)
    assert sum(bool(energies(row)) for row in rows) > 10
