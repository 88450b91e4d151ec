"""Ratios with intervals over trainings, episodes and groups."""

import numpy as np
import pytest

from lab.experiments.ratios import grouped_ratio, ratio_of
from spikedeploy.comparison.statistics import nested_ratio

REFERENCE = np.random.default_rng(0).uniform(1, 9, size=20)


def test_a_ratio_of_medians_is_that_of_the_middle_values():
    estimate = ratio_of(np.median, [2, 100, 1], [4, 5, 3])
    assert estimate.mean == 2 / 4
    assert estimate.ci95 == (1 / 5, 100 / 3)


@pytest.mark.parametrize(
    ("values", "reference", "mean", "interval"),
    [
        (0.9 * np.stack([REFERENCE] * 2), REFERENCE, 0.9, (0.9, 0.9)),  # the same episodes of both
        ([[5.0] * 50] * 3, [10.0] * 50, 0.5, (0.5, 0.5)),
        ([[4.0] * 50, [5.0] * 50, [6.0] * 50], [10.0] * 50, 0.5, (0.4, 0.6)),  # trainings differ
        # half of the resamples of two trainings have both, a quarter twice the same
        ([[6.0, 6.0]] * 2, [[2.0, 2.0], [4.0, 4.0]], 2.0, (1.5, 3.0)),
    ],
)
def test_a_nested_ratio_draws_trainings_of_both_and_the_same_episodes(
    values, reference, mean, interval
):
    estimate = nested_ratio(values, reference)
    assert estimate.mean == pytest.approx(mean)
    assert estimate.ci95 == pytest.approx(interval)


def test_a_ratio_to_nothing_is_no_number():
    estimate = nested_ratio([[0.0, 1.0]], [0.0, 0.0])
    assert np.isnan([estimate.mean, *estimate.ci95]).all()
    assert np.isnan(grouped_ratio([1.0, 2.0], [0.0, 0.0], [0, 1]).mean)


def test_an_interval_over_few_groups_is_wider_than_one_over_their_episodes():
    # three chips, of which one is far worse: its ten episodes are not ten witnesses
    groups = np.repeat([0, 1, 2], 10)
    values, one = np.where(groups == 0, 0.2, 1.0), np.ones(30)
    low, high = grouped_ratio(values, one, groups).ci95
    alone_low, alone_high = grouped_ratio(values, one, range(30)).ci95
    assert (low, high) == pytest.approx((0.2, 1.0))
    assert high - low > alone_high - alone_low
    same = grouped_ratio(0.5 * REFERENCE, REFERENCE, np.arange(20) % 2)
    assert (same.mean, *same.ci95) == pytest.approx((0.5, 0.5, 0.5))


def test_groups_may_differ_in_size_and_weigh_by_their_episodes():
    estimate = grouped_ratio([1.0, 1.0, 1.0, 0.0], [1.0] * 4, [0, 0, 0, 1])
    assert estimate.mean == 0.75
    assert estimate.ci95 == (0, 1)
