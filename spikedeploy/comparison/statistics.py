"""Statistics of few episodes: interquartile mean, bootstrap intervals, paired differences.

Returns of a controller are skewed by rare falls, so a mean needs its interval and an interquartile
mean beside it (Agarwal et al. 2021, section 4.3). Two policies on the same seeds share terrain and
pushes, so their *paired* difference has a far smaller variance than the difference of their means.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

_RESAMPLES = 10_000
_TOGETHER = 500  # resamples of whole tables at once
_LEVEL = 0.95
Z = 1.959964  # standard deviations that hold LEVEL of a normal distribution


@dataclass(frozen=True)
class Estimate:
    """A mean with its interval.

    mean    [unit of the values]
    ci95    (low, high) of the 95 % percentile bootstrap [unit of the values]
    """

    mean: float
    ci95: tuple[float, float]

    def as_json(self) -> dict[str, object]:
        """Plain numbers for a report."""
        return asdict(self)


def iqm(values: ArrayLike) -> float:
    """The interquartile mean: the mean without the lowest and the highest quarter."""
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    cut = ordered.size // 4
    return float(ordered[cut : ordered.size - cut].mean())


def bootstrap(values: ArrayLike, rng: np.random.Generator) -> Estimate:
    """The mean of `values` (n,) and the interval of means of resamples with replacement."""
    sample = np.asarray(values, dtype=np.float64)
    means = _resampled_means(sample, rng)
    tail = (1 - _LEVEL) / 2
    low, high = np.quantile(means, (tail, 1 - tail))
    return Estimate(float(sample.mean()), (float(low), float(high)))


def share(events: ArrayLike) -> Estimate:
    """The share of `events` (n,) that happened, with its Wilson interval (Wilson 1927).

    A bootstrap of 100 successes in 100 would have an interval of width 0.
    """
    happened = np.asarray(events, dtype=np.float64)
    n, p = happened.size, float(happened.mean())
    # (p + z^2/2n +- z sqrt(p (1 - p)/n + z^2/4n^2)) / (1 + z^2/n)
    middle = (p + Z**2 / (2 * n)) / (1 + Z**2 / n)
    half = Z * float(np.sqrt(p * (1 - p) / n + Z**2 / (4 * n**2))) / (1 + Z**2 / n)
    return Estimate(p, (max(0.0, middle - half), min(1.0, middle + half)))


def paired_difference(
    values: ArrayLike, reference: ArrayLike, rng: np.random.Generator
) -> Estimate:
    """The mean of values - reference, pair by pair (n,) each, with its bootstrap interval."""
    left, right = np.asarray(values, np.float64), np.asarray(reference, np.float64)
    if left.shape != right.shape:
        raise ValueError(f"pairs need equal shapes, found {left.shape} and {right.shape}")
    return bootstrap(left - right, rng)


def ratio_of_medians(values: ArrayLike, reference: ArrayLike, rng: np.random.Generator) -> Estimate:
    """Median of `values` (n,) / median of `reference` (m,), and its bootstrap interval.

    The `mean` of the estimate is that ratio.
    """
    left, right = np.asarray(values, np.float64), np.asarray(reference, np.float64)
    tops, bottoms = (
        np.median(each[rng.integers(each.size, size=(_RESAMPLES, each.size))], axis=1)
        for each in (left, right)
    )
    tail = (1 - _LEVEL) / 2
    low, high = np.quantile(tops / bottoms, (tail, 1 - tail))
    return Estimate(float(np.median(left) / np.median(right)), (float(low), float(high)))


def nested_ratio(values: ArrayLike, reference: ArrayLike, rng: np.random.Generator) -> Estimate:
    """Mean of values (S, n) of S trainings in n episodes / mean of a reference (n,) in the same.

    A resample draws trainings, then for each of them episodes, of it and of the reference; the
    `mean` of the estimate is the ratio of the sample itself. NaN where the reference is 0.
    """
    each, beside = np.asarray(values, np.float64), np.asarray(reference, np.float64)
    if not beside.any():
        return Estimate(math.nan, (math.nan, math.nan))
    trainings, episodes = each.shape
    ratios = []
    for _ in range(_RESAMPLES // _TOGETHER):
        drawn = rng.integers(trainings, size=(_TOGETHER, trainings, 1))
        picks = rng.integers(episodes, size=(_TOGETHER, trainings, episodes))
        with np.errstate(divide="ignore", invalid="ignore"):  # rare successes, none drawn
            ratios.append(each[drawn, picks].mean((1, 2)) / beside[picks].mean((1, 2)))
    tail = (1 - _LEVEL) / 2
    low, high = np.nanquantile(np.concatenate(ratios), (tail, 1 - tail))
    return Estimate(float(each.mean() / beside.mean()), (float(low), float(high)))


def grouped_ratio(
    values: ArrayLike, reference: ArrayLike, groups: ArrayLike, rng: np.random.Generator
) -> Estimate:
    """Mean of values (n,) / mean of a reference (n,) in the same episodes, with its interval.

    groups  (n,) of each episode: a resample draws groups, then pairs within each, so that an
            interval covers what a group has in common; where each pair is a group, only pairs

    The `mean` of the estimate is the ratio of the sample itself. NaN where the reference is 0.
    """
    left, right = np.asarray(values, np.float64), np.asarray(reference, np.float64)
    if not right.any():
        return Estimate(math.nan, (math.nan, math.nan))
    _, of, sizes = np.unique(np.asarray(groups), return_inverse=True, return_counts=True)
    members = np.zeros((sizes.size, sizes.max()), np.int64)
    for group in range(sizes.size):
        members[group, : sizes[group]] = np.flatnonzero(of == group)
    ratios = []
    for _ in range(_RESAMPLES // _TOGETHER):
        drawn = rng.integers(sizes.size, size=(_TOGETHER, sizes.size))
        share = rng.random((_TOGETHER, sizes.size, sizes.max()))
        picks = members[drawn[..., None], (share * sizes[drawn][..., None]).astype(np.int64)]
        counts = np.arange(sizes.max()) < sizes[drawn][..., None]
        top, bottom = ((each[picks] * counts).sum((1, 2)) for each in (left, right))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios.append(top / bottom)
    tail = (1 - _LEVEL) / 2
    low, high = np.nanquantile(np.concatenate(ratios), (tail, 1 - tail))
    return Estimate(float(left.mean() / right.mean()), (float(low), float(high)))


def _resampled_means(sample: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    picks = rng.integers(sample.size, size=(_RESAMPLES, sample.size))
    means: NDArray[np.float64] = sample[picks].mean(axis=1)
    return means
