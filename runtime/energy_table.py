"""The energy table: what events cost, who says so, and how far off that may be."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Uncertainty:
    """How far off the numbers of a table may be.

    low, high: the truth lies between these multiples of an estimate; 0 and infinity where nothing
        published bounds it.
    why: who says so, or why nobody can.
    """

    low: float
    high: float
    why: str

    def describe(self) -> str:
        """A few words to stand behind a number: `± 11.7 %`, `at least`."""
        if self.low == self.high == 1:
            return "exact"
        if math.isinf(self.high):
            return "at least" if self.low == 1 else "no bound known"
        if math.isclose(1 - self.low, self.high - 1):
            return f"± {100 * (self.high - 1):.3g} %"
        if self.low == 0:
            return "at most" if self.high == 1 else f"at most {self.high:.4g} times"
        return f"{self.low:.4g} to {self.high:.4g} times"


UNKNOWN = Uncertainty(0.0, math.inf, "nothing published bounds it")


@dataclass(frozen=True)
class EnergyTable:
    """Prices.

    name: as in TABLES.
    source: publication.
    provenance: how the numbers came about, and how sure they are.
    joules: [J] per event; of EVENTS, "mac" for networks without spikes, and "hop_x" and "hop_y" for
        what a Traffic counts.
    seconds: [s] per event, one after another.
    step: [s] per chip timestep, to synchronise cores, or because time is kept by a clock.
    uncertainty: of energies.
    time_uncertainty: of times.
    most: [J] per event where two sources disagree: `joules` has the lower figure, this the higher.
    """

    name: str
    source: str
    provenance: str
    joules: Mapping[str, float]
    seconds: Mapping[str, float] = field(default_factory=dict)
    step: float = 0.0
    uncertainty: Uncertainty = UNKNOWN
    time_uncertainty: Uncertainty = UNKNOWN
    most: Mapping[str, float] = field(default_factory=dict)

    @property
    def timed(self) -> bool:
        """Whether it says anything about time."""
        return bool(self.seconds) or self.step > 0


@dataclass(frozen=True)
class StaticPower:
    """What a chip draws while it does nothing: a line of its own, never part of a table's energy.

    name: by which it is called.
    source: publication.
    provenance: how sure the number is.
    watts: [W] of a whole chip.
    """

    name: str
    source: str
    provenance: str
    watts: float
