import pytest

from spikedeploy.trainers.sparse.sparse import phases
from tests.trainers.sparse.toy import settings

# 12 dense updates in two rounds, 12 to 20 operations, 12 to 10, 8 of polish
DENSE, AGAIN, LEVEL, LAST, POLISH = range(5)


def test_phases_follow_one_another():
    found = phases(settings())
    assert [(each.begin, each.end, each.last) for each in found] == [
        (0, 6, None), (6, 12, None), (12, 24, 20.0), (24, 36, 10.0), (36, 44, 10.0),
    ]  # fmt: skip


def test_operations_fall_along_a_quadratic_ramp_to_the_goal():
    level = phases(settings(prune_until=0.5))[LEVEL]
    assert phases(settings())[DENSE].goal(3, 100.0) is None
    assert level.goal(12, 120.0) == 120
    assert level.goal(15, 120.0) == pytest.approx(20 + 100 / 4)
    assert level.goal(18, 120.0) == level.goal(23, 120.0) == 20
    assert level.goal(12, 15.0) == 20  # already below
    assert [t for t in range(12, 24) if level.prunes(t)] == list(range(12, 19))
    assert not any(phases(settings())[AGAIN].prunes(t) for t in range(6, 12))


def test_without_a_ramp_the_goal_holds_at_once():
    level = phases(settings(prune_until=0.0))[LEVEL]
    assert level.goal(12, 120.0) == 20
    assert [t for t in range(12, 24) if level.prunes(t)] == [12]


def test_the_learning_rate_falls_by_half_a_cosine():
    config = settings()
    found = phases(config)
    highest = [config.learning_rate] * 2 + [config.level_rate] * 2 + [config.polish_rate]
    shares = [0.3, 0.05, 0.1, 0.1, 0.05]
    for phase, high, share in zip(found, highest, shares, strict=True):
        low = high * share
        assert phase.rate(phase.begin) == pytest.approx(high)
        assert phase.rate((phase.begin + phase.end) // 2) == pytest.approx((high + low) / 2)
        assert phase.rate(phase.end) == pytest.approx(low)


def test_levels_are_derived_from_the_budget():
    assert settings(levels=()).rounds == (30, 20, 15, 12, 10)
    assert settings(levels=(5.0, 40.0, 12.0)).rounds == (40, 12, 10)
