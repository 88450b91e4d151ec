"""Energy tables: published prices of events with source and uncertainty; static power of chips.

A chip without a table has no published energy per operation: Loihi 2 (none found), Xylo and Speck
(whole tasks only), Spiker+ (only the power of a whole FPGA).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class Uncertainty:
    """How far the estimates of a table may be from the truth.

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
    joules: [J] per event: of EVENTS, "mac" for networks without spikes, and "hop_x" and "hop_y" of
        a Traffic.
    seconds: [s] per event, one after another.
    step: [s] per chip timestep, for the synchronisation of cores or the period of a clock.
    uncertainty: of energies.
    time_uncertainty: of times.
    upper_joules: [J] per event where two sources disagree; `joules` holds the lower figure.
    included: terms (energy_terms) that are part of another price, and so have none of their own.
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

    @property
    def timed(self) -> bool:
        """Whether it has any times."""
        return bool(self.seconds) or self.step > 0


@dataclass(frozen=True)
class StaticPower:
    """Power that a chip draws while idle; reported by itself, never added to a table's energy.

    name: of the measurement.
    source: publication.
    provenance: how certain the number is.
    watts: [W] of a whole chip.
    """

    name: str
    source: str
    provenance: str
    watts: float


_PICO = 1e-12
_NANO = 1e-9

_SERIAL = "one core, one event after another"
_ALL_IN = ("updates", "idle", "messages", "spikes")  # where one number stands for everything

_DAVIES2018 = EnergyTable(
    name="davies2018",
    source="Davies et al. 2018, IEEE Micro 38(1), Table 2",
    provenance="pre-silicon SPICE minimum at 0.75 V; messages within a tile; the table itself is "
    "read in transcriptions that agree",
    joules={
        "sop": 23.6 * _PICO,
        "bias_sop": 23.6 * _PICO,
        "neuron_update": 81 * _PICO,
        "neuron_idle": 52 * _PICO,
        "message": 1.7 * _PICO,
        "hop_x": 3.0 * _PICO,
        "hop_y": 4.0 * _PICO,
    },
    seconds={
        "sop": 3.5 * _NANO,
        "bias_sop": 3.5 * _NANO,
        "neuron_update": 8.4 * _NANO,
        "neuron_idle": 5.3 * _NANO,
        "message": 2.1 * _NANO,
    },
    step=113 * _NANO,
    uncertainty=Uncertainty(
        1.0, math.inf, "the minimum of a synaptic operation, before there was silicon"
    ),
    time_uncertainty=Uncertainty(
        0.0, math.inf, f"{_SERIAL}, at the longest time of an operation and the shortest barrier"
    ),
    included=("spikes",),  # a spike is its message
)

# every neuron is accessed in every timestep; an update and a spike cost extra
_SANAFE = EnergyTable(
    name="sanafe",
    source="SANA-FE 2.2.9, arch/loihi.yaml (Boyle et al. 2025)",
    provenance="fit to Nahuku silicon, model error on its authors' benchmarks <= 11.7 % in energy "
    "and 24.3 % in time; dense synapses; no hops without a layout, one tile",
    joules={
        "sop": 35.5 * _PICO,
        "bias_sop": 35.5 * _PICO,
        "neuron_update": (51.2 + 21.6) * _PICO,
        "neuron_idle": 51.2 * _PICO,
        "spike_out": 69.3 * _PICO,
        "message": 111 * _PICO,
        "hop_x": 3.0 * _PICO,
        "hop_y": 4.2 * _PICO,
    },
    seconds={
        "sop": 3.8 * _NANO,
        "bias_sop": 3.8 * _NANO,
        "neuron_update": (6.0 + 3.7) * _NANO,
        "neuron_idle": 6.0 * _NANO,
        "spike_out": 30 * _NANO,
        "message": (5.1 + 16) * _NANO,
    },
    step=600 * _NANO,
    uncertainty=Uncertainty(
        0.0, math.inf, "the error on its authors' benchmarks says nothing of other networks"
    ),
    time_uncertainty=Uncertainty(
        0.0,
        math.inf,
        f"{_SERIAL}: no more than their model on one tile, which is untested on other networks",
    ),
)

_SANAFE_SPARSE = replace(
    _SANAFE,
    name="sanafe-sparse",
    provenance=_SANAFE.provenance.replace("dense", "sparse"),
    joules={**_SANAFE.joules, "sop": 33.6 * _PICO, "bias_sop": 33.6 * _PICO},
    seconds={**_SANAFE.seconds, "sop": 4.7 * _NANO, "bias_sop": 4.7 * _NANO},
)

_SANAFE_CONV = replace(
    _SANAFE,
    name="sanafe-conv",
    provenance=_SANAFE.provenance.replace("dense", "convolutional"),
    joules={**_SANAFE.joules, "sop": 24.0 * _PICO, "bias_sop": 24.0 * _PICO},
    seconds={**_SANAFE.seconds, "sop": 3.1 * _NANO, "bias_sop": 3.1 * _NANO},
)

_TRUENORTH = EnergyTable(
    name="truenorth",
    source="Merolla et al. 2014, Science 345, 668, as others quote it: 26 pJ per synaptic event",
    provenance="measured; the energy of the whole chip, static power included, divided by its "
    "synaptic events, at 20 Hz, 128 synapses, 0.775 V and 72 mW: nothing is to be added to it",
    joules={"sop": 26 * _PICO, "bias_sop": 26 * _PICO},
    step=1e-3,
    uncertainty=Uncertainty(
        0.0, math.inf, "holds at the activity it was measured at: a quieter chip pays more an event"
    ),
    time_uncertainty=Uncertainty(1.0, 1.0, "a tick is 1 ms in real time, by design"),
    included=(*_ALL_IN, "resets"),
)

ODIN = EnergyTable(
    name="odin",
    source="Frenkel et al. 2018, IEEE TBioCAS, 10.1109/TBCAS.2018.2880425: 12.7 pJ per SOP",
    provenance="measured, 28 nm, the minimum at 0.55 V; the increment of one more SOP is 8.43 pJ, "
    "and at biological rates a SOP takes 54 pJ (both secondary)",
    joules={"sop": 12.7 * _PICO, "bias_sop": 12.7 * _PICO},
    uncertainty=Uncertainty(
        8.43 / 12.7, 54 / 12.7, "8.43 pJ, one SOP more, to 54 pJ, all at biological rates"
    ),
    included=_ALL_IN,
)

_RECKON = EnergyTable(
    name="reckon",
    source="the README of ReckOn: 5.3 pJ per SOP",
    provenance="measured, 28 nm, at 0.5 V",
    joules={"sop": 5.3 * _PICO, "bias_sop": 5.3 * _PICO},
    included=_ALL_IN,
)

# software on a processor computes every neuron in every timestep, idle or not
_SPINNAKER2 = EnergyTable(
    name="spinnaker2",
    source="two energy estimators that do not cite where they have it from",
    provenance="secondary, of little confidence: 450 pJ in one and 1.5 nJ in the other (the "
    "prototype) per synaptic event; both have 2.19 nJ per neuron update",
    joules={
        "sop": 450 * _PICO,
        "bias_sop": 450 * _PICO,
        "neuron_update": 2.19 * _NANO,
        "neuron_idle": 2.19 * _NANO,
    },
    upper_joules={"sop": 1.5 * _NANO, "bias_sop": 1.5 * _NANO},
    uncertainty=Uncertainty(1.0, 1.0, "both for a synaptic event, and neither has a source"),
)

# float32: 3.7 pJ a multiplication, 0.9 pJ an addition; 10 pJ a read of 8 bytes, of which 4 are used
_HOROWITZ45 = EnergyTable(
    name="horowitz45",
    source="Horowitz 2014, ISSCC: 45 nm, 0.9 V",
    provenance="arithmetic in float32 and one weight fetched from an 8 KB SRAM per operation, the "
    "best case; neuron updates derived: two multiplications, three additions, four accesses",
    joules={
        "mac": (3.7 + 0.9 + 10 / 2) * _PICO,
        "sop": (0.9 + 10 / 2) * _PICO,
        "bias_sop": (0.9 + 10 / 2) * _PICO,
        "neuron_update": (2 * 3.7 + 3 * 0.9 + 4 * 10 / 2) * _PICO,
    },
    uncertainty=Uncertainty(
        1.0, math.inf, "arithmetic and the smallest memory; control and larger memories add to it"
    ),
)

_HOROWITZ45_INT8 = replace(
    _HOROWITZ45,
    name="horowitz45-int8",
    provenance="8-bit weights, 32-bit sums, one weight fetched from an 8 KB SRAM per operation, "
    "the best case; neuron updates derived as for horowitz45, with 32-bit integers",
    joules={
        "mac": (0.2 + 0.1 + 10 / 8) * _PICO,
        "sop": (0.1 + 10 / 8) * _PICO,
        "bias_sop": (0.1 + 10 / 8) * _PICO,
        "neuron_update": (2 * 3.1 + 3 * 0.1 + 4 * 10 / 2) * _PICO,
    },
)

TABLES: dict[str, EnergyTable] = {
    table.name: table
    for table in (
        _DAVIES2018,
        _SANAFE,
        _SANAFE_SPARSE,
        _SANAFE_CONV,
        _TRUENORTH,
        ODIN,
        _RECKON,
        _SPINNAKER2,
        _HOROWITZ45,
        _HOROWITZ45_INT8,
    )
}

# chip -> its static power
STATIC: dict[str, StaticPower] = {
    "loihi1": StaticPower(
        name="frady2020",
        source="Frady et al. 2020: Pohoiki Springs",
        provenance="measured, the voltage not stated (secondary)",
        watts=0.104,
    ),
}
