"""Results of an export, and the checks of a written file against its policy."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ConfigError

_RATE = 0.3  # spikes of an input in a timestep


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
class ExportResult:
    """A written file or folder.

    path: of it.
    files: names of the files in a folder; of a file alone, none.
    checks: comparisons with the policy.
    facts: properties of the export, as data.
    lines: for a terminal.
    remarks: notes for users of the file.
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

    def require_passed(self, policy: str, remedy: str = "") -> "ExportResult":
        """Return the export; ConfigError where the file does not compute what the policy does."""
        if failed := [check for check in self.checks if not check.passed]:
            said = f"{failed[0].name}, {failed[0].detail}{remedy}"
            raise ConfigError(f"{self.path} does not do what {policy} does: {said}")
        return self

    def record(self) -> dict[str, Any]:
        """Everything as plain data."""
        found: dict[str, Any] = {"path": str(self.path)}
        if self.files:
            found["files"] = list(self.files)
        if self.checks:
            found |= {"passed": self.passed, "checks": [vars(check) for check in self.checks]}
        return {**found, **self.facts}


def compare_integers(
    name: str,
    one: Mapping[str, NDArray[np.integer[Any]]],
    other: Mapping[str, NDArray[np.integer[Any]]],
) -> ParityCheck:
    """Compare arrays of integers, such as the spikes (B, T, N) of every layer of `one`."""
    compared = sum(each.size for each in one.values())
    differing = sum(int(np.count_nonzero(each != other[key])) for key, each in one.items())
    found = f"{differing:,} differ" if differing else "all equal"
    return ParityCheck(name, bool(compared) and not differing, f"{compared:,} compared, {found}")


def compare_floats(
    name: str, one: NDArray[np.floating[Any]], other: NDArray[np.floating[Any]], limit: float
) -> ParityCheck:
    """Compare arrays (B, act), which may differ by a limit."""
    apart = largest_difference(one, other)
    detail = f"{len(one):,} observations, largest difference {apart:.1e}, limit {limit:.0e}"
    return ParityCheck(name, apart <= limit, detail)


def largest_difference(one: NDArray[np.floating[Any]], other: NDArray[np.floating[Any]]) -> float:
    """Return the largest absolute difference; NaN where there is one, which is within no limit."""
    return float(np.abs(one - other).max())


def random_spikes(rng: np.random.Generator, *shape: int) -> NDArray[np.uint8]:
    """Independent input spikes of this shape, at a rate of 0.3 for each timestep."""
    return (rng.random(shape) < _RATE).astype(np.uint8)
