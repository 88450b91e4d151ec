"""Energy and time: what the events of a ledger cost, by tables of which each says its source.

None of the tables knows of static power, of getting observations in and actions out, or of
distances between cores: they are for comparing networks, not for choosing batteries.
"""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass

from runtime.errors import ConfigError
from runtime.ledger import EVENTS, Ledger

PICO = 1e-12
NANO = 1e-9


@dataclass(frozen=True)
class EnergyTable:
    """Prices.

    name: as in TABLES.
    source: publication.
    provenance: how the numbers came about, and how sure they are.
    joules: [J] per event; of EVENTS, and "mac" for networks without spikes.
    seconds: [s] per event, one after another.
    step: [s] per chip timestep, to synchronise cores.
    """

    name: str
    source: str
    provenance: str
    joules: Mapping[str, float]
    seconds: Mapping[str, float]
    step: float = 0.0


DAVIES2018 = EnergyTable(
    name="davies2018",
    source="Davies et al. 2018, IEEE Micro 38(1), Table 2",
    provenance="pre-silicon SPICE minimum at 0.75 V; messages within a tile",
    joules={
        "sop": 23.6 * PICO,
        "bias_sop": 23.6 * PICO,
        "neuron_update": 81 * PICO,
        "neuron_idle": 52 * PICO,
        "message": 1.7 * PICO,
    },
    seconds={
        "sop": 3.5 * NANO,
        "bias_sop": 3.5 * NANO,
        "neuron_update": 8.4 * NANO,
        "neuron_idle": 5.3 * NANO,
        "message": 2.1 * NANO,
    },
    step=113 * NANO,
)

# a neuron is accessed in every timestep, updated when it is not idle, and pays again for a spike
SANAFE = EnergyTable(
    name="sanafe",
    source="SANA-FE, arch/loihi.yaml (Boyle et al. 2025)",
    provenance="fit to Nahuku silicon, model error <= 11.7 % in energy and 24.3 % in time; "
    "dense synapses, no hops, one tile",
    joules={
        "sop": 35.5 * PICO,
        "bias_sop": 35.5 * PICO,
        "neuron_update": (51.2 + 21.6) * PICO,
        "neuron_idle": 51.2 * PICO,
        "spike_out": 69.3 * PICO,
        "message": 111 * PICO,
    },
    seconds={
        "sop": 3.8 * NANO,
        "bias_sop": 3.8 * NANO,
        "neuron_update": (6.0 + 3.7) * NANO,
        "neuron_idle": 6.0 * NANO,
        "spike_out": 30 * NANO,
        "message": (5.1 + 16) * NANO,
    },
    step=600 * NANO,
)

# a multiplication and an addition in float32, and 4 of the 8 bytes of a read of 10 pJ
HOROWITZ45 = EnergyTable(
    name="horowitz45",
    source="Horowitz 2014, ISSCC: 45 nm, 0.9 V",
    provenance="arithmetic in float32 and one weight fetched from an 8 KB SRAM per operation, the "
    "best case; neuron updates derived: two multiplications, three additions, four accesses",
    joules={
        "mac": (3.7 + 0.9 + 10 / 2) * PICO,
        "sop": (0.9 + 10 / 2) * PICO,
        "bias_sop": (0.9 + 10 / 2) * PICO,
        "neuron_update": (2 * 3.7 + 3 * 0.9 + 4 * 10 / 2) * PICO,
    },
    seconds={},
)

HOROWITZ45_INT8 = EnergyTable(
    name="horowitz45-int8",
    source="Horowitz 2014, ISSCC: 45 nm, 0.9 V",
    provenance="8-bit weights, 32-bit sums, one weight fetched from an 8 KB SRAM per operation, "
    "the best case; neuron updates derived as for horowitz45, with 32-bit integers",
    joules={
        "mac": (0.2 + 0.1 + 10 / 8) * PICO,
        "sop": (0.1 + 10 / 8) * PICO,
        "bias_sop": (0.1 + 10 / 8) * PICO,
        "neuron_update": (2 * 3.1 + 3 * 0.1 + 4 * 10 / 2) * PICO,
    },
    seconds={},
)

TABLES: dict[str, EnergyTable] = {
    table.name: table for table in (DAVIES2018, SANAFE, HOROWITZ45, HOROWITZ45_INT8)
}


def energy_table(name: str) -> EnergyTable:
    """The table called `name`."""
    if name not in TABLES:
        close = difflib.get_close_matches(name, TABLES, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise ConfigError(f"there is no energy table {name!r}{hint}. Known: {', '.join(TABLES)}.")
    return TABLES[name]


def energy(ledger: Ledger, table: EnergyTable) -> float:
    """[J] per inference."""
    # E = sum over events of count * price
    return sum(ledger.per_inference(event) * table.joules.get(event, 0.0) for event in EVENTS)


def mac_energy(macs: float, table: EnergyTable) -> float:
    """[J] of one inference of a network without spikes, with so many multiply-accumulates."""
    if "mac" not in table.joules:
        raise ConfigError(
            f"energy table {table.name!r} has no price for multiply-accumulates. "
            f"Choose one of {', '.join(n for n, t in TABLES.items() if 'mac' in t.joules)}."
        )
    return macs * table.joules["mac"]


def latency(ledger: Ledger, table: EnergyTable) -> float:
    """[s] per inference, as if one core did everything, one event after another.

    An upper bound for a network of one core: SANA-FE, which overlaps messages with synapses, comes
    out 8 % lower on its own example. Networks on many cores run as many times faster at best.
    """
    if not table.seconds:
        raise ConfigError(f"energy table {table.name!r} has no times. Choose davies2018 or sanafe.")
    serial = sum(ledger.per_inference(e) * table.seconds.get(e, 0.0) for e in EVENTS)
    return serial + table.step * ledger.steps / max(ledger.inferences, 1)
