"""Energy tables: published prices of events with source and uncertainty; static power of chips.

What is published stands in energy_tables.toml, what is derived from Horowitz 2014 here. A chip
without a table has no published energy per operation: Loihi 2 (none found), Xylo and Speck (whole
tasks only), Spiker+ (only the power of a whole FPGA).
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
    source: str
    provenance: str
    joules: Mapping[str, float]
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
_UNITS = {"joules": _PICO, "upper_joules": _PICO, "seconds": _NANO}
_PUBLISHED = read_toml(Path(__file__).with_suffix(".toml"))


def _prices(given: Mapping[str, Any], unit: float = 1.0) -> dict[str, float]:
    """Prices of events in J or s; those of biases' operations are those of the others."""
    found = dict[str, float]()
    for event, price in given.items():
        found[event] = (sum(price) if isinstance(price, list) else price) * unit
        if event == "sop":
            found["bias_sop"] = found["sop"]
    return found


def _read_table(name: str) -> EnergyTable:
    given = dict(_PUBLISHED["tables"][name])
    like = _read_table(given.pop("like")) if "like" in given else EnergyTable("", "", "", {})
    for field_name, unit in _UNITS.items():
        given[field_name] = {
            **getattr(like, field_name),
            **_prices(given.get(field_name, {}), unit),
        }
    for field_name in ("uncertainty", "time_uncertainty"):
        if field_name in given:
            given[field_name] = Uncertainty(*given[field_name])
    if "step" in given:
        given["step"] *= _NANO
    for field_name, kind in (("included", tuple), ("least", frozenset)):
        given[field_name] = kind(given.get(field_name, getattr(like, field_name)))
    return replace(like, name=name, **given)


# Horowitz 2014, ISSCC, 45 nm and 0.9 V [J]: arithmetic, and 10 pJ an access of 64 bits of an 8 KB
# SRAM, of which a word of fewer bits pays its share
ADDITION, MULTIPLICATION = 0.1 * _PICO, 3.1 * _PICO  # 32-bit integers; a comparison subtracts
_MULTIPLY8 = 0.2 * _PICO
_FLOAT_ADD, _FLOAT_MULTIPLY = 0.9 * _PICO, 3.7 * _PICO


def sram(bits: int) -> float:
    """Energy [J] of reading or writing a word in an SRAM of 8 KB (Horowitz 2014: 10 pJ a 64)."""
    return 10 * _PICO * bits / 64


_SMALLEST = "arithmetic and the smallest memory; control and larger memories add to it"
_DERIVED = "neuron updates are derived, and narrower states cost less"

_HOROWITZ45 = EnergyTable(
    name="horowitz45",
    source="Horowitz 2014, ISSCC: 45 nm, 0.9 V",
    provenance="arithmetic in float32 and one weight fetched from an 8 KB SRAM per operation, the "
    "best case; sums in registers; neuron updates derived: two multiplications, three additions, "
    "four accesses",
    joules=_prices(
        {
            "mac": _FLOAT_MULTIPLY + _FLOAT_ADD + sram(32),
            "sop": _FLOAT_ADD + sram(32),
            "neuron_update": 2 * _FLOAT_MULTIPLY + 3 * _FLOAT_ADD + 4 * sram(32),
            "state_write": sram(32),
        }
    ),
    uncertainty=Uncertainty(1.0, math.inf, f"{_SMALLEST}; {_DERIVED}"),
    least=frozenset({"mac", "sop", "bias_sop"}),
)

_HOROWITZ45_INT8 = replace(
    _HOROWITZ45,
    name="horowitz45-int8",
    provenance="8-bit weights, 32-bit sums in registers, one weight fetched from an 8 KB SRAM per "
    "operation, the best case; neuron updates derived as for horowitz45, with 32-bit integers",
    joules=_prices(
        {
            "mac": _MULTIPLY8 + ADDITION + sram(8),
            "sop": ADDITION + sram(8),
            "neuron_update": 2 * MULTIPLICATION + 3 * ADDITION + 4 * sram(32),
            "state_write": sram(32),
        }
    ),
)


def _scattered_memory_table(bits: int) -> EnergyTable:
    """The table horowitz45-int8 of pruned networks, with what each operation finds by an index.

    A spike's list names neurons, whose sums are in memory: the weight, its index, and the sum read
    and written. A float unit's list names inputs, and its sum stays in a register: the weight, its
    index, and the input read. The sum is the current of a neuron, or the membrane of one without a
    current, so an update has one addition less than in horowitz45-int8.

    bits: of the sums, and of all states of neurons.
    """
    index = sram(8)  # of one among 256 neurons, or inputs
    return replace(
        _HOROWITZ45_INT8,
        name=f"horowitz45-int8-acc{bits}",
        provenance=f"as horowitz45-int8, for pruned networks: an 8-bit index of each weight; a "
        f"synaptic operation reads and writes a sum of {bits} bits, a multiply-accumulate reads "
        f"its input of 8 bits and keeps its sum in a register; states of {bits} bits; all in an "
        "8 KB SRAM",
        joules=_prices(
            {
                "mac": _MULTIPLY8 + ADDITION + sram(8) + index + sram(8),
                "sop": ADDITION + sram(8) + index + 2 * sram(bits),
                "graded_sop": _MULTIPLY8 + ADDITION + sram(8) + index + 2 * sram(bits),
                "neuron_update": 2 * MULTIPLICATION + 2 * ADDITION + 4 * sram(bits),
                "one_state_update": MULTIPLICATION + 2 * sram(bits),
                "state_write": sram(bits),
            }
        ),
        uncertainty=Uncertainty(
            0.0,
            math.inf,
            "control and larger memories add to it, registers instead of an SRAM take off",
        ),
        least=frozenset(),
    )


TABLES: dict[str, EnergyTable] = {
    **{name: _read_table(name) for name in _PUBLISHED["tables"]},
    **{
        t.name: t
        for t in (
            _HOROWITZ45,
            _HOROWITZ45_INT8,
            _scattered_memory_table(16),
            _scattered_memory_table(32),
        )
    },
}

# chip -> its published static powers; a chip that is not here has none
STATIC: dict[str, tuple[StaticPower, ...]] = {
    name: tuple(StaticPower(**each) for each in powers)
    for name, powers in _PUBLISHED["static"].items()
}
