"""Ratios with intervals over trainings, episodes and groups."""

import numpy as np
import pytest

from lab.experiments.ratios import grouped_ratio, nested_ratio, ratio_of


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_a_ratio_of_medians_is_that_of_the_middle_values():
    estimate = ratio_of(np.median, [2, 100, 1], [4, 5, 3])
    assert estimate.mean == 2 / 4
    assert estimate.ci95[0] == 1 / 5
    assert estimate.ci95[1] == 100 / 3


def test_a_nested_ratio_is_of_the_means_over_trainings_and_episodes(rng):
    estimate = nested_ratio([[1, 2, 3], [3, 4, 5]], [4, 5, 6])
    assert estimate.mean == pytest.approx(3 / 5)
    low, high = estimate.ci95
    assert low < 3 / 5 < high


def test_a_nested_ratio_draws_the_same_episodes_of_both(rng):
    reference = rng.uniform(1, 9, size=20)
    estimate = nested_ratio(0.9 * np.stack([reference, reference]), reference)
    assert estimate.ci95 == pytest.approx((0.9, 0.9))


def test_a_nested_interval_covers_the_spread_of_trainings(rng):
    alike, apart = np.array([[5.0] * 50] * 3), np.array([[4.0] * 50, [5.0] * 50, [6.0] * 50])
    reference = [10.0] * 50
    assert nested_ratio(alike, reference).ci95 == pytest.approx((0.5, 0.5))
    assert nested_ratio(apart, reference).ci95 == pytest.approx((0.4, 0.6))


def test_a_nested_ratio_draws_trainings_of_the_reference_too(rng):
    """Half of the resamples of two trainings have both, a quarter twice the same."""
    estimate = nested_ratio([[6.0, 6.0], [6.0, 6.0]], [[2.0, 2.0], [4.0, 4.0]])
    assert estimate.mean == pytest.approx(2.0)
    assert estimate.ci95 == pytest.approx((1.5, 3.0))


def test_a_nested_ratio_to_nothing_is_no_number(rng):
    estimate = nested_ratio([[0.0, 1.0]], [0.0, 0.0])
    assert np.isnan([estimate.mean, *estimate.ci95]).all()


def test_a_grouped_ratio_of_what_loses_the_same_share_everywhere_is_a_point(rng):
    reference = np.array([10.0, 20.0, 30.0, 40.0])
    estimate = grouped_ratio(0.5 * reference, reference, [0, 1, 0, 1])
    assert estimate.mean == 0.5
    assert estimate.ci95 == pytest.approx((0.5, 0.5))


def test_an_interval_over_few_groups_is_wider_than_one_over_their_episodes(rng):
    # three chips, of which one is far worse: its ten episodes are not ten witnesses
    groups = np.repeat([0, 1, 2], 10)
    values = np.where(groups == 0, 0.2, 1.0)
    one = np.ones(30)
    low, high = grouped_ratio(values, one, groups).ci95
    alone_low, alone_high = grouped_ratio(values, one, range(30)).ci95
    assert (low, high) == pytest.approx((0.2, 1.0))
    assert high - low > alone_high - alone_low


def test_groups_may_differ_in_size_and_weigh_by_their_episodes(rng):
    estimate = grouped_ratio([1.0, 1.0, 1.0, 0.0], [1.0] * 4, [0, 0, 0, 1])
    assert estimate.mean == 0.75
    assert estimate.ci95 == (0, 1)


def test_a_grouped_ratio_to_nothing_is_no_number(rng):
    assert np.isnan(grouped_ratio([1.0, 2.0], [0.0, 0.0], [0, 1]).mean)
