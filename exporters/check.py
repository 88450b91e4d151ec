"""One check of an exported file, and the counting behind it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BATCH = 250  # observations at a time: spikes of a PopSAN are a few kilobytes for each


@dataclass(frozen=True)
class ParityCheck:
    """One line of a parity report.

    name: what was compared
    passed: whether it is as it should be
    detail: the numbers behind it
    """

    name: str
    passed: bool
    detail: str


@dataclass
class SpikeTally:
    """Spikes, or other whole numbers, compared so far, and those among them that differ."""

    compared: int = 0
    differing: int = 0

    def add(
        self, one: Mapping[str, NDArray[np.integer]], other: Mapping[str, NDArray[np.integer]]
    ) -> None:
        """Compare the rasters (B, T, N) of every layer of `one` with their namesakes."""
        for name, raster in one.items():
            self.compared += raster.size
            self.differing += int(np.count_nonzero(raster != other[name]))

    def __str__(self) -> str:
        found = f"{self.differing:,} differ" if self.differing else "all equal"
        return f"{self.compared:,} compared, {found}"


@dataclass
class Gap:
    """The largest difference of two numbers so far."""

    largest: float = 0.0

    def add(self, one: NDArray[np.floating], other: NDArray[np.floating]) -> None:
        """Compare two arrays of actions (B, act)."""
        # written so that a NaN is a gap and not overlooked
        self.largest = float(np.max([self.largest, np.abs(one - other).max()]))

    def within(self, limit: float) -> bool:
        """Whether no difference was larger than the limit."""
        return self.largest <= limit


def batches(observations: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield the observations, a few hundred at a time."""
    for start in range(0, len(observations), BATCH):
        yield observations[start : start + BATCH]
