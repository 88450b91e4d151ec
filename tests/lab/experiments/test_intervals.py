"""Intervals over trainings, against the table of Student's t."""

import numpy as np
import pytest

from lab.experiments.intervals import t_interval


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.mark.parametrize(
    ("n", "errors"),  # the table of Student's t, 97.5 %, n - 1 degrees of freedom
    [(2, 12.706205), (3, 4.302653), (5, 2.776445), (10, 2.262157), (101, 1.983972)],
)
def test_an_interval_over_trainings_is_so_many_standard_errors_wide(rng, n, errors):
    values = rng.normal(7, 2, size=n)
    estimate = t_interval(values)
    half = errors * values.std(ddof=1) / np.sqrt(n)
    assert estimate.mean == pytest.approx(values.mean())
    low, high = values.mean() - half, values.mean() + half
    assert estimate.ci95 == pytest.approx((low, high), abs=1e-5)


def test_the_interval_over_three_trainings_covers_where_a_bootstrap_does_not(rng):
    samples = rng.normal(3, 2, size=(400, 3))
    hits = sum(low <= 3 <= high for low, high in (t_interval(each).ci95 for each in samples))
    assert 362 <= hits <= 397  # 95 % of 400, four standard deviations either way
    assert t_interval([0.98]).ci95 == (-np.inf, np.inf)  # one training says nothing of others
