"""Intervals over trainings, for the tables of experiments."""

import math

import numpy as np
from numpy.typing import ArrayLike

from spikedeploy.comparison.statistics import LEVEL, Estimate, draws, interval


def t_interval(values: ArrayLike) -> Estimate:
    """The mean of `values` (n,), of n trainings, and the interval of Student's t (1908).

    A bootstrap of three trainings never leaves their range, so that it is too narrow; this one is
    4.3 standard errors to either side at 3, 2.8 at 5. It takes the values for normal. Of one value
    nothing follows: the interval has no bounds.
    """
    sample = np.asarray(values, np.float64)
    mean, n = float(sample.mean()), sample.size
    if n < 2:
        return Estimate(mean, (-math.inf, math.inf))
    half = _t_quantile(n - 1) * float(sample.std(ddof=1)) / math.sqrt(n)
    return Estimate(mean, (mean - half, mean + half))


def _t_quantile(freedom: int) -> float:
    """The bound that |t|, with so many degrees of freedom, stays below in 95 % of all cases."""
    # with t = sqrt(freedom) tan(angle) the density of the angle is ~ cos(angle)^(freedom - 1)
    angle = np.linspace(0, math.pi / 2, 100_001)
    density = np.cos((angle[1:] + angle[:-1]) / 2) ** (freedom - 1)
    below = np.concatenate([[0.0], np.cumsum(density)]) / density.sum()
    return math.sqrt(freedom) * math.tan(float(np.interp(LEVEL, below, angle)))


def nested_ratio(values: ArrayLike, reference: ArrayLike) -> Estimate:
    """Mean of values (S, n) of S trainings in n episodes / mean of a reference in the same.

    reference: (n,), or (R, n) of R trainings

    A resample draws trainings of both, then episodes, the same for all of them; the `mean` of the
    estimate is the ratio of the sample itself. NaN where the reference is 0.
    """
    rng = np.random.default_rng(0)
    each = np.asarray(values, np.float64)
    beside = np.atleast_2d(np.asarray(reference, np.float64))
    if not beside.any():
        return Estimate(math.nan, (math.nan, math.nan))
    trainings, episodes = each.shape
    ratios = []
    for drawn, picks in draws(trainings, episodes, rng):
        of = rng.integers(len(beside), size=(len(drawn), len(beside), 1))
        with np.errstate(divide="ignore", invalid="ignore"):  # rare successes, none drawn
            ratios.append(each[drawn, picks].mean((1, 2)) / beside[of, picks].mean((1, 2)))
    return Estimate(float(each.mean() / beside.mean()), interval(np.concatenate(ratios)))
