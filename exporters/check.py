"""What an export returns, and its checks: what was compared, on which spikes, the counters."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ConfigError

_RATE = 0.3  # spikes of an input in a timestep
_BATCH = 250  # observations; each takes a few kilobytes of spikes in a PopSAN


@dataclass(frozen=True)
class ParityCheck:
    """A line of a parity report.

    name: what was compared.
    passed: whether both agree.
    detail: the numbers.
    """

    name: str
    passed: bool
    detail: str


@dataclass(frozen=True)
class Exported:
    """A written file or folder.

    path: of it.
    files: names of the files in a folder; of a file alone, none.
    checks: comparisons with the policy.
    facts: what there is to know of it, as data.
    lines: for a terminal.
    remarks: what whoever opens it has to know.
    """

    path: Path
    files: tuple[str, ...] = ()
    checks: tuple[ParityCheck, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """True if every check passed."""
        return all(each.passed for each in self.checks)

    def require_passed(self, policy: str, remedy: str = "") -> "Exported":
        """Return it; ConfigError where the file does not do what the policy does."""
        if failed := [check for check in self.checks if not check.passed]:
            said = f"{failed[0].name}, {failed[0].detail}{remedy}"
            raise ConfigError(f"{self.path} does not do what {policy} does: {said}")
        return self

    def record(self) -> dict[str, Any]:
        """All of it as data."""
        found: dict[str, Any] = {"path": str(self.path)}
        if self.files:
            found["files"] = list(self.files)
        if self.checks:
            found |= {"passed": self.passed, "checks": [vars(check) for check in self.checks]}
        return {**found, **self.facts}


@dataclass
class MismatchCounter:
    """Counts of compared integers, such as spikes, and of those that differ."""

    compared: int = 0
    differing: int = 0

    def add(
        self, one: Mapping[str, NDArray[np.integer]], other: Mapping[str, NDArray[np.integer]]
    ) -> None:
        """Compare the rasters (B, T, N) of every layer of `one` with those in `other`."""
        for name, raster in one.items():
            self.compared += raster.size
            self.differing += int(np.count_nonzero(raster != other[name]))

    def __str__(self) -> str:
        found = f"{self.differing:,} differ" if self.differing else "all equal"
        return f"{self.compared:,} compared, {found}"


@dataclass
class LargestDifference:
    """The largest absolute difference so far."""

    largest: float = 0.0

    def add(self, one: NDArray[np.floating], other: NDArray[np.floating]) -> None:
        """Compare two arrays of actions (B, act)."""
        # np.max passes NaN on, so that a NaN is a difference
        self.largest = float(np.max([self.largest, np.abs(one - other).max()]))

    def within(self, limit: float) -> bool:
        """Return True if no difference exceeds the limit."""
        return self.largest <= limit


def random_spikes(rng: np.random.Generator, *shape: int) -> NDArray[np.uint8]:
    """Independent input spikes of this shape, at a rate of 0.3 for each timestep."""
    return (rng.random(shape) < _RATE).astype(np.uint8)


def batches(observations: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield the observations in batches of BATCH."""
    for start in range(0, len(observations), _BATCH):
        yield observations[start : start + _BATCH]
