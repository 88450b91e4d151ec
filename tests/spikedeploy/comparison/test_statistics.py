"""The statistics of a comparison, against values worked out by hand."""

import numpy as np
import pytest

from spikedeploy.comparison.statistics import (
    FEWEST,
    bootstrap,
    iqm,
    paired_difference,
    risk,
    share,
    stratified_bootstrap,
)

TWENTIETHS = np.random.default_rng(7).normal(size=137).tolist()


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.mark.parametrize(
    ("of", "values", "found"),
    [
        (iqm, [8, 1, 3, 4, 100, 6, 5, -50], 4.5),  # two dropped at each end: of 3, 4, 5, 6
        (iqm, [1, 2, 6], 3),  # of fewer than four the mean
        (iqm, [3400.0] * 19 + [100.0], 3400),  # one fall moves the mean alone
        (risk, np.arange(100.0)[::-1], 2),  # of 0, 1, 2, 3, 4
        (risk, np.arange(39.0), 0),
        (risk, [7.0, 5.0], 5),
        # RewardScore.compute of NeuroBench's branch 2025_GC
        (risk, TWENTIETHS, np.mean(sorted(TWENTIETHS)[: int(137 * 0.05)])),
    ],
)
def test_the_middle_half_and_the_worst_twentieth_have_means(of, values, found):
    assert of(values) == pytest.approx(found)


def test_the_interval_of_equal_values_is_a_point(rng):
    estimate = bootstrap([5.0] * 6, rng)
    assert (estimate.mean, estimate.ci95) == (5, (5, 5))


def test_the_interval_covers_the_true_mean_about_95_times_in_100(rng):
    hits = 0
    for _ in range(200):
        low, high = bootstrap(rng.normal(3, 2, size=60), rng).ci95
        hits += low <= 3 <= high
    assert 176 <= hits <= 200  # 95 % of 200, four standard deviations either way


def test_of_fewer_values_than_five_even_the_range_holds_the_mean_too_rarely(rng):
    samples = rng.normal(size=(20_000, FEWEST))
    for n, covered in ((2, 0.5), (3, 0.75), (4, 0.875), (FEWEST, 0.9375)):
        first = samples[:, :n]
        hit = np.mean((first.min(1) < 0) & (first.max(1) > 0))
        assert hit == pytest.approx(covered, abs=0.012)
    for sample in samples[:3]:
        low, high = bootstrap(sample, rng).ci95
        assert sample.min() < low < high < sample.max()
        whole = sample[:3].min(), sample[:3].max()
        assert bootstrap(sample[:3], rng).ci95 == pytest.approx(whole)


def test_pairing_removes_what_the_seeds_share(rng):
    luck = rng.normal(0, 100, size=50)
    better = paired_difference(luck + 5, luck, rng)
    assert better.mean == pytest.approx(5)
    assert better.ci95 == pytest.approx((5, 5))
    with pytest.raises(ValueError, match=r"\(3,\) and \(2,\)"):
        paired_difference([1, 2, 3], [1, 2], rng)


def test_the_interval_of_a_share_is_wilsons():
    # Wilson 1927 for 81 of 263, as Newcombe 1998, Table I has it
    estimate = share([True] * 81 + [False] * 182)
    assert estimate.mean == 81 / 263
    assert estimate.ci95 == (pytest.approx(0.2553, abs=1e-4), pytest.approx(0.3662, abs=1e-4))
    # successes alone do not make it certain
    assert share([True] * 100).ci95 == (pytest.approx(0.963, abs=1e-3), 1)


def test_mean_iqm_and_risk_of_trainings_are_those_of_all_their_episodes(rng):
    returns = rng.normal(3000, 100, size=(3, 40))
    found = stratified_bootstrap(returns, rng)
    assert found.mean.mean == returns.mean()
    assert found.iqm.mean == iqm(returns.ravel())
    assert found.risk.mean == risk(returns.ravel())
    for each in (found.mean, found.iqm, found.risk):
        assert each.ci95[0] < each.mean < each.ci95[1]


def test_with_one_training_the_interval_is_that_over_its_episodes():
    returns = np.random.default_rng(3).normal(size=50)
    one = stratified_bootstrap([returns], np.random.default_rng(1)).mean
    assert one.ci95 == pytest.approx(bootstrap(returns, np.random.default_rng(2)).ci95, abs=0.02)


def test_trainings_that_differ_widen_intervals_and_episodes_that_they_share_do_not(rng):
    alike, apart = np.full((3, 40), 5.0), np.repeat([[4.0], [5.0], [6.0]], 40, axis=1)
    for each in vars(stratified_bootstrap(alike, rng)).values():
        assert each.ci95 == (5, 5)
    found = stratified_bootstrap(apart, rng)
    assert found.mean.ci95 == found.risk.ci95 == (4, 6)
    # what is hard about an episode is the same for five trainings that are otherwise equal
    hard = rng.normal(size=60)
    one, five = (stratified_bootstrap([hard] * count, rng).mean.ci95 for count in (1, 5))
    assert five == pytest.approx(one, abs=0.03)


def test_the_interval_over_trainings_covers_the_true_mean_about_as_often_as_it_says(
    rng, monkeypatch
):
    monkeypatch.setattr("spikedeploy.comparison.statistics._RESAMPLES", 1000)
    hits = 0
    for _ in range(60):
        skill, hard = rng.normal(0, 1, (12, 1)), rng.normal(0, 1, (1, 30))
        low, high = stratified_bootstrap(skill + hard + rng.normal(0, 1, (12, 30)), rng).mean.ci95
        hits += low <= 0 <= high
    assert 49 <= hits <= 60  # 95 % of 60, and less for few trainings: four standard deviations


def test_an_interval_of_five_values_is_narrow(rng, monkeypatch):
    """As results/lineup.md says: that of five normal values holds their mean in 84 % of cases."""
    monkeypatch.setattr("spikedeploy.comparison.statistics._RESAMPLES", 1000)
    found = [bootstrap(rng.normal(size=5), rng).ci95 for _ in range(1500)]
    assert np.mean([low <= 0 <= high for low, high in found]) == pytest.approx(0.84, abs=0.03)
