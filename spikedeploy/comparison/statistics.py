"""Statistics of few episodes and fewer trainings: means, intervals, paired differences.

Returns of a controller are skewed by rare falls, so a mean needs its interval and an interquartile
mean beside it (Agarwal et al. 2021, section 4.3), and the worst episodes a number of their own, the
risk. Two policies on the same seeds share terrain and pushes, so their *paired* difference has a
far smaller variance than the difference of their means.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

_RESAMPLES = 10_000
_TOGETHER = 500  # resamples of whole tables at once
LEVEL = 0.95
_WORST = 0.05  # of the episodes, whose mean is the risk
# Values below which no interval is printed. That of a bootstrap lies within the range of its n
# values (of 2 or 3 it is the range), which holds the median of what they are drawn from in
# 1 - 2^(1 - n) of all samples: 50 % at 2, 75 % at 3, 87.5 % at 4, 93.8 % at 5.
FEWEST = 5
Z = 1.959964  # standard deviations that hold LEVEL of a normal distribution


@dataclass(frozen=True)
class Estimate:
    """A mean with its interval.

    mean: [unit of the values]
    ci95: (low, high), 95 % by the percentile bootstrap where nothing else is said [same unit]
    """

    mean: float
    ci95: tuple[float, float]

    def as_json(self) -> dict[str, object]:
        """Plain numbers for a report."""
        return asdict(self)

    def text(self, form: str) -> str:
        """`3,438 [3,436, 3,441]`, each number in a format such as `,.0f`."""
        low, high = self.ci95
        return f"{self.mean:{form}} [{low:{form}}, {high:{form}}]"

    def mark(self, bound: float) -> str:
        """✓ where the whole interval reaches the bound, ✗ where none of it does, else ≈."""
        low, high = self.ci95
        return "✓" if low >= bound else "✗" if high < bound else "≈"


@dataclass(frozen=True)
class ReturnEstimates:
    """Returns of episodes: all, the middle half and the worst, each with its interval.

    mean: mean of all returns
    iqm: interquartile mean
    risk: mean of the worst 5 %
    """

    mean: Estimate
    iqm: Estimate
    risk: Estimate


def iqm(values: ArrayLike) -> float:
    """The interquartile mean: the mean without the lowest and the highest quarter."""
    return float(_middle(np.sort(np.asarray(values, np.float64), axis=None)))


def risk(values: ArrayLike) -> float:
    """The mean of the worst 5 %, of at least one value (NeuroBench, RewardScore: risk)."""
    return float(_worst(np.sort(np.asarray(values, np.float64), axis=None)))


def _middle(ordered: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean (...,) of the middle half of (..., n) in order."""
    size = ordered.shape[-1]
    return np.asarray(ordered[..., size // 4 : size - size // 4].mean(-1))


def _worst(ordered: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean (...,) of the lowest 5 % of (..., n) in order."""
    return np.asarray(ordered[..., : max(1, int(_WORST * ordered.shape[-1]))].mean(-1))


def bootstrap(values: ArrayLike, rng: np.random.Generator) -> Estimate:
    """The mean of `values` (n,) and the interval of means of resamples with replacement."""
    sample = np.asarray(values, dtype=np.float64)
    picks = rng.integers(sample.size, size=(_RESAMPLES, sample.size))
    return Estimate(float(sample.mean()), interval(sample[picks].mean(axis=1)))


def stratified_bootstrap(values: ArrayLike, rng: np.random.Generator) -> ReturnEstimates:
    """Mean, IQM and risk of all values (S, n) of S trainings in the same n episodes.

    The stratified bootstrap of Agarwal et al. 2021: a resample draws trainings, then episodes, the
    same for all of its trainings, as they share what is hard about an episode. With one training
    the intervals cover episodes alone.
    """
    each = np.asarray(values, np.float64)
    trainings, episodes = each.shape
    found = []
    for drawn, picks in draws(trainings, episodes, rng):
        ordered = np.sort(each[drawn, picks].reshape(len(drawn), -1), axis=1)
        found.append((ordered.mean(-1), _middle(ordered), _worst(ordered)))
    sample = float(each.mean()), iqm(each), risk(each)
    resampled = map(np.concatenate, zip(*found, strict=True))
    pairs = zip(sample, resampled, strict=True)
    return ReturnEstimates(*(Estimate(value, interval(many)) for value, many in pairs))


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


def draws(
    trainings: int, episodes: int, rng: np.random.Generator
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Resamples of trainings (R, S, 1), and of episodes (R, 1, n) that they share; R at once."""
    for _ in range(_RESAMPLES // _TOGETHER):
        drawn = rng.integers(trainings, size=(_TOGETHER, trainings, 1))
        yield drawn, rng.integers(episodes, size=(_TOGETHER, 1, episodes))


def interval(resampled: NDArray[np.float64]) -> tuple[float, float]:
    """The middle 95 % of what resamples gave; those that gave no number are left out."""
    tail = (1 - LEVEL) / 2
    low, high = np.nanquantile(resampled, (tail, 1 - tail))
    return float(low), float(high)
