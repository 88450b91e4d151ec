"""Ratios of means and medians, with bootstrap intervals over values or groups of episodes."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spikedeploy.comparison.statistics import (
    _RESAMPLES,
    _TOGETHER,
    Estimate,
    _interval,
)


def ratio_of(
    middle: Callable[..., NDArray[np.float64]], values: ArrayLike, reference: ArrayLike
) -> Estimate:
    """np.mean or np.median of `values` (n,) over that of `reference` (m,), resampled each.

    The `mean` of the estimate is that ratio.
    """
    rng = np.random.default_rng(0)
    left, right = np.asarray(values, np.float64), np.asarray(reference, np.float64)
    tops, bottoms = (
        middle(each[rng.integers(each.size, size=(_RESAMPLES, each.size))], axis=1)
        for each in (left, right)
    )
    usable = bottoms > 0
    return Estimate(float(middle(left) / middle(right)), _interval(tops[usable] / bottoms[usable]))


def grouped_ratio(values: ArrayLike, reference: ArrayLike, groups: ArrayLike) -> Estimate:
    """Mean of values (n,) / mean of a reference (n,) in the same episodes, with its interval.

    groups  (n,) of each episode: a resample draws groups, then pairs within each, so that an
            interval covers what a group has in common; where each pair is a group, only pairs

    The `mean` of the estimate is the ratio of the sample itself. NaN where the reference is 0.
    """
    rng = np.random.default_rng(0)
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
    return Estimate(float(left.mean() / right.mean()), _interval(np.concatenate(ratios)))
