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
    joules: [J] per event: of EVENTS, "mac" for networks without spikes, "hop_x" and "hop_y" of
        MessageTraffic, "one_state_update" for a neuron without a current, where it costs less than
        "neuron_update", and "state_write" for setting one state of a neuron to 0. A "graded_sop"
        without a price of its own costs a "mac".
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


_PICO = 1e-12
_NANO = 1e-9


def _sop(price: float) -> dict[str, float]:
    """The price of a synaptic operation, biases' like the others."""
    return {"sop": price, "bias_sop": price}


_SERIAL = "one core, one event after another"
_ALL_IN = ("updates", "idle", "messages", "spikes")  # where one number stands for everything

_DAVIES2018 = EnergyTable(
    name="davies2018",
    source="Davies et al. 2018, IEEE Micro 38(1), Table 2",
    provenance="pre-silicon SPICE minimum at 0.75 V; messages within a tile; the table itself is "
    "read in transcriptions that agree",
    joules={
        **_sop(23.6 * _PICO),
        "neuron_update": 81 * _PICO,
        "neuron_idle": 52 * _PICO,
        "message": 1.7 * _PICO,
        "hop_x": 3.0 * _PICO,
        "hop_y": 4.0 * _PICO,
    },
    seconds={
        **_sop(3.5 * _NANO),
        "neuron_update": 8.4 * _NANO,
        "neuron_idle": 5.3 * _NANO,
        "message": 2.1 * _NANO,
    },
    step=113 * _NANO,
    uncertainty=Uncertainty(
        1.0,
        math.inf,
        "the minimum of a synaptic operation, before there was silicon; neurons have no minimum "
        "here: by sanafe's fit to silicon they cost less",
    ),
    least=frozenset({"sop", "bias_sop"}),
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
        **_sop(35.5 * _PICO),
        "neuron_update": (51.2 + 21.6) * _PICO,
        "neuron_idle": 51.2 * _PICO,
        "spike_out": 69.3 * _PICO,
        "message": 111 * _PICO,
        "hop_x": 3.0 * _PICO,
        "hop_y": 4.2 * _PICO,
    },
    seconds={
        **_sop(3.8 * _NANO),
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
    joules={**_SANAFE.joules, **_sop(33.6 * _PICO)},
    seconds={**_SANAFE.seconds, **_sop(4.7 * _NANO)},
)

_SANAFE_CONV = replace(
    _SANAFE,
    name="sanafe-conv",
    provenance=_SANAFE.provenance.replace("dense", "convolutional"),
    joules={**_SANAFE.joules, **_sop(24.0 * _PICO)},
    seconds={**_SANAFE.seconds, **_sop(3.1 * _NANO)},
)

_TRUENORTH = EnergyTable(
    name="truenorth",
    source="Merolla et al. 2014, Science 345, 668, as others quote it: 26 pJ per synaptic event",
    provenance="measured; the energy of the whole chip, static power included, divided by its "
    "synaptic events, at 20 Hz, 128 synapses, 0.775 V and 72 mW: nothing is to be added to it",
    joules=_sop(26 * _PICO),
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
    joules=_sop(12.7 * _PICO),
    uncertainty=Uncertainty(
        8.43 / 12.7, 54 / 12.7, "8.43 pJ, one SOP more, to 54 pJ, all at biological rates"
    ),
    included=_ALL_IN,
)

_RECKON = EnergyTable(
    name="reckon",
    source="the README of ReckOn: 5.3 pJ per SOP",
    provenance="measured, 28 nm, at 0.5 V",
    joules=_sop(5.3 * _PICO),
    included=_ALL_IN,
)

# software on a processor computes every neuron in every timestep, idle or not
_SPINNAKER2 = EnergyTable(
    name="spinnaker2",
    source="two energy estimators that do not cite where they have it from",
    provenance="secondary, of little confidence: 450 pJ in one and 1.5 nJ in the other (the "
    "prototype) per synaptic event; both have 2.19 nJ per neuron update",
    joules={
        **_sop(450 * _PICO),
        "neuron_update": 2.19 * _NANO,
        "neuron_idle": 2.19 * _NANO,
    },
    upper_joules=_sop(1.5 * _NANO),
    uncertainty=Uncertainty(1.0, 1.0, "both for a synaptic event, and neither has a source"),
)

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
    joules={
        "mac": _FLOAT_MULTIPLY + _FLOAT_ADD + sram(32),
        **_sop(_FLOAT_ADD + sram(32)),
        "neuron_update": 2 * _FLOAT_MULTIPLY + 3 * _FLOAT_ADD + 4 * sram(32),
        "state_write": sram(32),
    },
    uncertainty=Uncertainty(1.0, math.inf, f"{_SMALLEST}; {_DERIVED}"),
    least=frozenset({"mac", "sop", "bias_sop"}),
)

_HOROWITZ45_INT8 = replace(
    _HOROWITZ45,
    name="horowitz45-int8",
    provenance="8-bit weights, 32-bit sums in registers, one weight fetched from an 8 KB SRAM per "
    "operation, the best case; neuron updates derived as for horowitz45, with 32-bit integers",
    joules={
        "mac": _MULTIPLY8 + ADDITION + sram(8),
        **_sop(ADDITION + sram(8)),
        "neuron_update": 2 * MULTIPLICATION + 3 * ADDITION + 4 * sram(32),
        "state_write": sram(32),
    },
)


def _scattered(bits: int) -> EnergyTable:
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
        joules={
            "mac": _MULTIPLY8 + ADDITION + sram(8) + index + sram(8),
            **_sop(ADDITION + sram(8) + index + 2 * sram(bits)),
            "graded_sop": _MULTIPLY8 + ADDITION + sram(8) + index + 2 * sram(bits),
            "neuron_update": 2 * MULTIPLICATION + 2 * ADDITION + 4 * sram(bits),
            "one_state_update": MULTIPLICATION + 2 * sram(bits),
            "state_write": sram(bits),
        },
        uncertainty=Uncertainty(
            0.0,
            math.inf,
            "control and larger memories add to it, registers instead of an SRAM take off",
        ),
        least=frozenset(),
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
        _scattered(16),
        _scattered(32),
    )
}

# chip -> its published static powers; a chip that is not here has none
STATIC: dict[str, tuple[StaticPower, ...]] = {
    "loihi1": (
        StaticPower(
            name="frady2020",
            source="Frady et al. 2020: Pohoiki Springs",
            provenance="measured, the voltage not stated (secondary)",
            watts=0.104,
        ),
        StaticPower(
            name="popsan2020",
            source="Tang et al. 2020, arXiv 2010.09635, Table 2: idle power of a Nahuku 8",
            provenance="measured; whether by all networks or by one is not said",
            watts=1.084,
            share=1 / 8,
            whole="a board of eight chips, an eighth of it",
        ),
    ),
    "xylo-a2": (
        StaticPower(
            name="xylo2023",
            source="idle power of a Xylo Audio in SynSense's first report of it",
            provenance="measured; of 542 uW in all (secondary)",
            watts=219e-6,
        ),
    ),
    "xylo-a3": (
        StaticPower(
            name="xylo-notebook",
            source="Rockpool's notebook of the Xylo Audio 3 development kit: idle power of its "
            "logic",
            provenance="measured; input and output 35.7 uW and the audio front end 12.3 uW apart",
            watts=542.9e-6,
        ),
    ),
    "speck2f": (
        StaticPower(
            name="yao2024",
            source="Yao et al. 2024, Nature Communications: power of a Speck at rest",
            provenance="measured",
            watts=0.42e-3,
        ),
    ),
}
