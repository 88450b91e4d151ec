import pytest

from spikedeploy.trainers.sparse.phases import Ended, expected_updates, planned, searched, target
from tests.trainers.sparse.toy import settings

# 12 dense updates in two rounds, 12 to 20 operations, 12 to 10, 8 of polish
DENSE, AGAIN, LEVEL, LAST, POLISH = range(5)


def test_phases_follow_one_another():
    found = planned(settings())
    assert [(each.begin, each.end, each.last) for each in found] == [
        (0, 6, None), (6, 12, None), (12, 24, 20.0), (24, 36, 10.0), (36, 44, 10.0),
    ]  # fmt: skip


def test_operations_fall_along_a_quadratic_ramp_to_the_goal():
    level = planned(settings(prune_until=0.5))[LEVEL]
    assert planned(settings())[DENSE].goal(3, 100.0) is None
    assert level.goal(12, 120.0) == 120
    assert level.goal(15, 120.0) == pytest.approx(20 + 100 / 4)
    assert level.goal(18, 120.0) == level.goal(23, 120.0) == 20
    assert level.goal(12, 15.0) == 20  # already below
    assert [t for t in range(12, 24) if level.prunes(t)] == list(range(12, 19))
    assert not any(planned(settings())[AGAIN].prunes(t) for t in range(6, 12))


def test_without_a_ramp_the_goal_holds_at_once():
    level = planned(settings(prune_until=0.0))[LEVEL]
    assert level.goal(12, 120.0) == 20
    assert [t for t in range(12, 24) if level.prunes(t)] == [12]


def test_the_learning_rate_falls_by_half_a_cosine():
    config = settings()
    found = planned(config)
    highest = [config.learning_rate] * 2 + [config.level_rate] * 2 + [config.polish_rate]
    shares = [0.3, 0.05, 0.1, 0.1, 0.05]
    for phase, high, share in zip(found, highest, shares, strict=True):
        low = high * share
        assert phase.rate(phase.begin) == pytest.approx(high)
        assert phase.rate((phase.begin + phase.end) // 2) == pytest.approx((high + low) / 2)
        assert phase.rate(phase.end) == pytest.approx(low)


def test_levels_are_derived_from_the_budget():
    assert settings(levels=()).levels_in_order == (30, 20, 15, 12, 10)
    assert settings(levels=(5.0, 40.0, 12.0)).levels_in_order == (40, 12, 10)


def searching(**changes):
    every = {"search": True, "budget": 0, "dense_rounds": 4, "dense_updates": 24, "patience": 2}
    return settings(**{**every, "shrink": 0.5, "polish": 1, "keep": 0.9, **changes})


def goals(config, *ended):
    return [phase.last for phase in searched(config, ended)]


def dense(*shares, operations=100.0):
    return [Ended(None, operations, share) for share in shares]


def test_a_search_is_dense_until_validation_stops_to_improve():
    config = searching()
    assert goals(config) == [None]
    assert goals(config, *dense(0.2, 0.4)) == [None] * 3
    assert goals(config, *dense(0.2, 0.4, 0.5)) == [None] * 4
    assert goals(config, *dense(0.5, 0.4, 0.5)) == [None] * 3 + [50]
    assert goals(config, *dense(0.2, 0.4, 0.5, 0.7)) == [None] * 4 + [50]


def test_it_prunes_on_while_the_share_is_kept_and_tries_a_level_once_more():
    config, before = searching(), dense(1.1, 1.0, 1.0)
    kept, lost = Ended(50.0, 50.2, 0.95), Ended(25.0, 25.0, 0.85)
    assert goals(config, *before, kept)[-2:] == [50, 25]
    assert goals(config, *before, kept, lost)[-3:] == [50, 25, 25]
    assert searched(config, [*before, kept, lost])[-1].polish
    # a level may miss by chance; after two in a row it is over
    below = Ended(12.5, 12.5, 0.85)
    assert goals(config, *before, kept, lost, lost)[-1] == 12.5
    assert goals(config, *before, kept, lost, lost, below)[-1] == 12.5
    assert len(goals(config, *before, kept, lost, lost, below, below)) == 8
    found = Ended(12.5, 12.5, 0.95)
    assert goals(config, *before, kept, lost, lost, found)[-1] == 6.25
    once = Ended(6.25, 6.25, 0.1)
    assert goals(config, *before, kept, lost, lost, found, once, once)[-1] == 3.125
    assert goals(config, *before, kept, lost, Ended(25.0, 25.0, 0.92))[-1] == 12.5
    few = Ended(5.0, 5.0, 1.0)
    assert len(goals(config, *before, few)) == 4  # nothing is left to prune


def test_a_weak_dense_student_is_measured_against_itself():
    config = searching()
    assert target(config, dense(0.6, 0.5, 0.55)) == 0.6
    assert target(config, dense(1.2)) == target(config, dense(0.95)) == 0.9


def test_with_a_budget_it_prunes_down_to_it_and_polishes_there():
    config, before = searching(budget=20), dense(0.9, 0.9, 0.9)
    ended = [*before, Ended(50.0, 50.0, 0.1), Ended(25.0, 25.0, 0.1)]
    assert goals(config, *ended)[3:] == [50, 25, 20]
    there = Ended(20.0, 20.0, 0.1)
    assert goals(config, *ended, there)[-1] == 20
    assert searched(config, [*ended, there])[-1].polish
    assert len(goals(config, *ended, there, there)) == 7
    # a budget that the dense student keeps takes no updates on the way
    assert goals(config, *dense(0.9, 0.9, 0.9, operations=15.0))[3:] == [20]


def test_the_updates_of_a_search_are_expected_before_and_behind_its_dense_rounds():
    config = searching()
    assert expected_updates(config, ()) >= 24
    before = dense(1.0, 1.0, 1.0)
    assert expected_updates(config, before) >= searched(config, before)[-1].end
