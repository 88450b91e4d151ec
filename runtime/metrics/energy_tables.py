"""Energy tables: published prices of events with source and uncertainty; static power of chips.

All numbers stand in energy_tables.toml. A chip without a table has no published energy per
operation: Loihi 2 (none found), Xylo and Speck (whole tasks only), Spiker+ (only the power of a
whole FPGA).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from spikedeploy.runtime.files import read_toml


@dataclass(frozen=True)
class Uncertainty:
    """Distance of the estimates of a table from the truth.

    low, high: the truth lies between these multiples of an estimate; 0 and infinity where nothing
        published bounds it.
    why: where the bounds come from, or why there are none.
    """

    low: float
    high: float
    why: str

    def describe(self) -> str:
        """A few words to print after a number, such as `± 11.7 %` or `at least`."""
        if self.low == self.high == 1:
            return "exact"
        if math.isinf(self.high):
            return "at least" if self.low == 1 else "no bound known"
        if math.isclose(1 - self.low, self.high - 1):
            return f"± {100 * (self.high - 1):.3g} %"
        if self.low == 0:
            return "at most" if self.high == 1 else f"at most {self.high:.4g} times"
        return f"{self.low:.4g} to {self.high:.4g} times"


_UNKNOWN = Uncertainty(0.0, math.inf, "nothing published bounds it")


@dataclass(frozen=True)
class EnergyTable:
    """Energies and times of events.

    name: as in TABLES.
    source: publication.
    provenance: how the numbers were obtained, and how certain they are.
    joules: [J] per event: of EVENTS, "mac" for networks without spikes, "hop_x" and "hop_y"
        between tiles of a network on chip, "one_state_update" for a neuron without a current, where
        it costs less than "neuron_update", and "state_write" for setting a neuron's state to 0. A
        "graded_sop" without a price of its own costs a "mac".
    seconds: [s] per event, one after another.
    step: [s] per chip timestep, for the synchronisation of cores or the period of a clock.
    uncertainty: of energies.
    time_uncertainty: of times.
    upper_joules: [J] per event where two sources disagree; `joules` holds the lower figure.
    included: terms of an energy that are part of another price, and so have none of their own.
    least: events whose price is the smallest that the source's process allows. An estimate is a
        lower bound where all that it adds up is among them; empty where `uncertainty` says it all.
    """

    name: str
    source: str = ""
    provenance: str = ""
    joules: Mapping[str, float] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    step: float = 0.0
    uncertainty: Uncertainty = _UNKNOWN
    time_uncertainty: Uncertainty = _UNKNOWN
    upper_joules: Mapping[str, float] = field(default_factory=dict)
    included: tuple[str, ...] = ()
    least: frozenset[str] = frozenset()

    @property
    def timed(self) -> bool:
        """True if it has any times."""
        return bool(self.seconds) or self.step > 0

    def describe(self) -> str:
        """Source and certainty in one line, to print with its numbers."""
        certain = f"{self.certainty} ({self.uncertainty.why})"
        return f"{self.source}: {self.provenance}. Energies: {certain}"

    @property
    def certainty(self) -> str:
        """The uncertainty of the energies, in a few words."""
        if self.least:
            # biases' operations are priced like the others
            events = " and ".join(sorted(self.least - {"bias_sop"}))
            return f"{self.uncertainty.describe()}, of {events} alone"
        return "between two figures" if self.upper_joules else self.uncertainty.describe()


@dataclass(frozen=True)
class StaticPower:
    """Power that a chip draws while idle; reported by itself, never added to a table's energy.

    name: of the measurement.
    source: publication.
    provenance: how certain the number is.
    watts: [W] of the whole that was measured: a chip, or a board of several.
    share: part of it that one network is charged; assumed.
    whole: what was measured, and why that share.
    """

    name: str
    source: str
    provenance: str
    watts: float
    share: float = 1.0
    whole: str = "one chip, all of it"


_PICO, _NANO = 1e-12, 1e-9
_PUBLISHED = read_toml(Path(__file__).with_suffix(".toml"))


def _prices(given: Mapping[str, Any], unit: float) -> dict[str, float]:
    """Prices of events in J or s; those of biases' operations are those of the others."""
    found = dict[str, float]()
    for event, price in given.items():
        parts = price if isinstance(price, list) else [price]
        found[event] = sum(part * unit for part in parts)
        if event == "sop":
            found["bias_sop"] = found["sop"]
    return found


def _read_table(name: str) -> EnergyTable:
    """The table in the file, and what it does not state from the one that it is `like`."""
    given = dict(_PUBLISHED["tables"][name])
    like = _read_table(given.pop("like")) if "like" in given else EnergyTable("")
    for key, unit in (("joules", _PICO), ("upper_joules", _PICO), ("seconds", _NANO)):
        own = _prices(given.get(key, {}), unit)
        given[key] = own | {n: p for n, p in getattr(like, key).items() if n not in own}
    for key in {"uncertainty", "time_uncertainty"} & given.keys():
        given[key] = Uncertainty(*given[key])
    given["step"] = given["step"] * _NANO if "step" in given else like.step
    given["included"] = tuple(given.get("included", like.included))
    given["least"] = frozenset(given.get("least", like.least))
    return replace(like, name=name, **given)


TABLES: dict[str, EnergyTable] = {name: _read_table(name) for name in _PUBLISHED["tables"]}

# chip -> its published static powers; a chip that is not here has none
STATIC: dict[str, tuple[StaticPower, ...]] = {
    name: tuple(StaticPower(**each) for each in powers)
    for name, powers in _PUBLISHED["static"].items()
}
