"""Energies of policies that see by events, term by term, and a rule that predicts them.

A spiking policy is priced by one of the ACCOUNTINGS, and a float one by the same table beside it,
at 45 nm. Static power is no part of either.

operations   synaptic operations; or multiplications of weights, of each layer by the cheapest of
             four circuits: inputs that are not 0; in the first layer those that changed, onto sums
             that are kept; all inputs of a convolution (of those behind the first together), by an
             array that reads each of them for 16 channels and moves a sum in 16 multiplications;
             behind the convolutions all inputs of a unit, its sum in a register (of all layers, or
             of those alone that read the memory of a GRU, which is never 0)
updates      neurons that a chip updates, and those that it looks at; units of a GRU
traffic      messages and spikes, where a table prices them; activations that are written and read
histogram    events that are added up until the control step ends, and the cells that hold some
constants    biases, and what the host adds
comparisons  units of a delta network some of whose inputs changed: their kept sums, and what they
             send compared with what they sent

The rule, `predict`, takes the counts of a policy at one control rate, moving and mostly at rest,
and the events a second of another cell of the map. Events come at the rate of motion for the share
of time that this takes, and not at all else; what is counted at rest follows from both counts.

    occupied(n, M) = M (1 - exp(-n / M)), places of M in which one of n events falls
    a float network that runs f times a second sees occupied(e s, C) cells in the time s: its first
        layer takes so many operations a cell, the others what they take in motion and at rest; of
        its cells change those of the events that came and of as many that are past
    one that n events trigger runs min(f, 1 / (n / e + 1 / (2 f))) times a second, as a control step
        ends half a step after them, and not at all at rest, as one that is gated; one that runs in
        every k-th step f / k times
    a delta network: behind the first layer a random walk, whose changes since the last control step
        grow with the root of its time
    a spiking one: operations a second as at rest, and the others as cells with events a second;
        updates f N, or f occupied(a / f, N) where those alone are updated at which some of a
        operations a second arrive
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from lab.experiments.costs import ACC16, INT8, comparisons
from lab.experiments.training import Record
from lab.experiments.vision import WAYS
from spikedeploy.runtime.metrics.energy import (
    ACCESS,
    ADDITION,
    addition_energy,
    chip_terms,
)
from spikedeploy.runtime.metrics.energy_tables import (
    MULTIPLICATION,
    TABLES,
    EnergyTable,
    sram,
)

TERMS = ("operations", "updates", "traffic", "histogram", "constants", "comparisons")

_BYTE = sram(8)
# an event of a histogram: its count of 8 bits read and written, and an addition
EVENT = 2 * _BYTE + ADDITION
# a cell with events: its address of 16 bits written into a list and read, its count read, cleared
CELL = 2 * ACCESS + 2 * _BYTE
# a unit of a GRU: three functions from tables of 16 bits, three products, five additions, and the
# state of 16 bits read and written
GATES = 3 * ACCESS + 3 * MULTIPLICATION + 5 * ADDITION + 2 * ACCESS
# a multiplication of 8 bits in an array whose weights are in registers, whose inputs are read once
# for 16 of its columns, as each of 16 x 16 units takes part in each cycle, and whose sums (16 bits)
# are read and written once for 16 of its rows
IN_ARRAY = TABLES[INT8].joules["mac"] - _BYTE + _BYTE / 16 + 2 * ACCESS / 16

# neurons with states of 16 bits, as a GRU's are here: current and membrane, or a membrane alone
_STATES_OF_16_BITS = {
    "neuron_update": 2 * MULTIPLICATION + 3 * ADDITION + 4 * ACCESS,
    "one_state_update": MULTIPLICATION + 2 * ADDITION + 2 * ACCESS,
}
# integrate and fire: nothing leaks; a membrane is compared with its threshold and its floor
_INTEGRATE_AND_FIRE = dict.fromkeys(_STATES_OF_16_BITS, 2 * ADDITION + 2 * ACCESS)


@dataclass(frozen=True)
class Accounting:
    """What a spiking network is charged for.

    title    for people
    place    the chip whose counts it takes
    table    prices of operations, of float networks as well
    prices   those of the chip's events [J] that differ from them
    touched  whether those neurons alone are updated at which a spike arrives
    gathers  whether float networks add up in registers where the chip adds up in memory
    source   what the charge for updates is known from
    """

    title: str
    place: str
    table: str
    prices: Mapping[str, float]
    source: str
    touched: bool = False
    gathers: bool = False

    @property
    def on_chip(self) -> EnergyTable:
        """The table of the chip's events."""
        table = TABLES[self.table]
        return replace(table, joules={**table.joules, **self.prices})


def _ratios(table: str) -> dict[str, float]:
    """Prices of a chip's own table over that of its synaptic operation, as 8-bit integers have."""
    own = TABLES[table].joules
    return {name: j * TABLES[INT8].joules["sop"] / own["sop"] for name, j in own.items()}


ACCOUNTINGS = {
    "loihi1": Accounting(
        "Loihi's ratios of prices", "loihi1", INT8, _ratios("sanafe"),
        "sanafe, every price over that of a synaptic operation",
    ),
    "int": Accounting(
        "8-bit integers, sums in registers", "int", INT8, _STATES_OF_16_BITS, "derived",
    ),
    "int-memory": Accounting("8-bit integers, sums in memory", "int", ACC16, {}, "derived"),
    "speck": Accounting(
        "integrate and fire, all neurons", "speck2f", ACC16, _INTEGRATE_AND_FIRE, "derived",
    ),
    "speck-touched": Accounting(
        "integrate and fire, touched neurons", "speck2f", ACC16, _INTEGRATE_AND_FIRE,
        "derived: where nothing leaks and nothing drives a neuron, others stay as they are",
        touched=True,
    ),
}  # fmt: skip


def terms(row: Record, accounting: Accounting) -> dict[str, float]:
    """Power [W] of each term of a policy, from its counts of a control step."""
    found = _chip(row, accounting) if row["spiking"] else _float(row, accounting)
    return {name: row["rate"] * joules for name, joules in zip(TERMS, found, strict=True)}


def power(row: Record, accounting: Accounting) -> float:
    """All terms [W]."""
    return float(sum(terms(row, accounting).values()))


def _chip(row: Record, accounting: Accounting) -> tuple[float, ...]:
    each = chip_terms(row, accounting.on_chip)
    updates = each["updates"] + each["idle"]
    if accounting.touched:
        updates = row["touched"] * accounting.on_chip.joules["one_state_update"]
    # events are counted until the control step ends
    histogram = row["events"] * EVENT + row["cells"] * CELL
    constants = each["bias"] + addition_energy(row["constants"])
    sent = each["messages"] + each["spikes"]
    return each["operations"], updates, sent, histogram, constants, 0.0


def _float(row: Record, accounting: Accounting) -> tuple[float, ...]:
    # a multiplication that is scattered into sums in memory costs what one by a graded spike does
    scatters = accounting.table == ACC16 and not accounting.gathers
    each = TABLES[accounting.table].joules["graded_sop" if scatters else "mac"]
    compared = row["compared"]
    return (
        _multiplications(row, each, TABLES[accounting.table].joules["mac"]),
        row["gates"] * GATES,
        row["sent"] * 2 * _BYTE,
        row["events"] * EVENT + row["cells"] * CELL,
        addition_energy(row["units"]),
        comparisons(compared, row["sent"]) if compared else 0.0,
    )


def _multiplications(row: Record, each: float, gathered: float) -> float:
    """Energy [J] of a float network's multiplications, of each layer by the cheapest circuit.

    each: of one whose inputs that are not 0 are scattered
    gathered: of one of all inputs of a unit, whose sum stays in a register
    """
    first_dense = row["first_dense_macs"]  # 0 where the first layer is no convolution
    first = min(
        row["first_macs"] * each,
        row["changed_macs"] * each + row["first_units"] * 2 * ACCESS,
        first_dense * IN_ARRAY if first_dense else math.inf,
    )
    convolved = max(row["conv_macs"], row["first_macs"])  # and the first layer, whatever it is
    others = min(
        (convolved - row["first_macs"]) * each, (row["dense_macs"] - first_dense) * IN_ARRAY
    )
    behind, of_memory = row["macs"] - convolved, row["memory_weights"]
    last = min(behind * each, row["behind_weights"] * gathered)
    if not row["compared"]:  # a delta network sends less than all of its memory
        last = min(last, (behind - of_memory) * each + of_memory * gathered)
    return float(first + others + last)


def latency(row: Record) -> float:
    """Mean time [s] from an event in motion to an action that follows from it, computing apart.

    The event waits until its control step ends, for further ones until a network runs, and for
    those in which layers of spiking ones hand it on.
    """
    later = row["late"][0] if row["spiking"] else 0
    return float((later + row.get("wait", 0.0) + 0.5) / row["rate"])


def computing_time(row: Record, table: str = "sanafe") -> float:
    """Time [s] in which one core of Loihi computes a control step, one event after another."""
    prices = TABLES[table]
    return prices.step + float(sum(row[name] * each for name, each in prices.seconds.items()))


# the rule


def occupied(events: float, places: float) -> float:
    """Places in which one or more of so many events fall, if each place is as likely."""
    return -places * math.expm1(-events / places) if places else 0.0


def places_of(events: float, found: float) -> float:
    """How many places there are, where so many events were found in so many of them."""
    if found <= 0 or events <= found * (1 + 1e-9):
        return 1e12 if found else 0.0  # each has fallen in a place of its own
    low, high = found, 1e12
    while high / low > 1 + 1e-9:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if occupied(events, middle) < found else (low, middle)
    return high


def predict(row: Record, rest: Record, rate: float, events: float, span: float) -> Record:
    """Counts of a control step at another rate and with so many events a second, from two rows.

    row     of the policy, at the rate it was trained for and without quiet; its way may be to run
            in some control steps where the counts are of one that runs in each
    rest    of the same, with most quiet
    rate    control rate [Hz]
    events  of the camera a second, those of noise included
    span    time [s] whose events a float network sees, at least
    """
    moving = min(1.0, events / (row["events"] * row["rate"]))
    still = _still(row, rest)
    if row["spiking"]:
        each = [_chip_at(row, still, rate, share) for share in (1.0, 0.0)]
    else:
        each = [_float_at(row, still, rate, span, share) for share in (1.0, 0.0)]
    mixed = {name: moving * n + (1 - moving) * each[1][name] for name, n in each[0].items()}
    return row | mixed | {"rate": rate}


_COUNTED = (
    "events", "cells", "macs", "first_macs", "changed_macs", "conv_macs", "sent", "sop",
    "graded_sop", "spike_out", "spike_in", "compared",
)  # fmt: skip
_UPDATES = ("neuron_update", "one_state_update")  # fewer at rest where input is gated


def _still(row: Record, rest: Record) -> Record:
    """Counts of a control step at rest, of which `rest` has a share, and motion the other."""
    moving = min(1.0, rest["events"] / row["events"])
    if moving > 1 - 1e-9:
        return row | dict.fromkeys(_COUNTED, 0.0)
    names = (*_COUNTED, *_UPDATES)
    found = {n: (rest[n] - moving * row[n]) / (1 - moving) for n in names if n in row}
    return row | {name: max(each, 0.0) for name, each in found.items()}


def _chip_at(row: Record, still: Record, rate: float, moving: float) -> Record:
    """Counts of a spiking policy at a rate, in motion (1) or at rest (0)."""
    slower = row["rate"] / rate  # a second has so many control steps less
    events = moving * row["events"] * slower
    cells = occupied(events, places_of(row["events"], row["cells"]))
    found = {"events": events, "cells": cells}
    found |= {name: (row if moving else still)[name] for name in _UPDATES}
    for name in ("sop", "graded_sop", "spike_out", "spike_in"):
        by_events = max(row[name] - still[name], 0.0) * cells / row["cells"]
        found[name] = by_events + min(still[name], row[name]) * slower
    # packets of spikes follow them, those of readouts to the host are sent in each step
    found["message"] = row["message"] - row["spike_in"] + found["spike_in"]
    found["touched"] = occupied(found["sop"], places_of(row["sop"], row["touched"]))
    return found


def _float_at(row: Record, still: Record, rate: float, span: float, moving: float) -> Record:
    """Counts of a float network at a rate, in motion (1) or at rest (0)."""
    way = WAYS[row["way"]]
    events = moving * row["events"] * row["rate"]  # a second
    runs, usual, seen = rate, row["span"], span
    if way.trigger:
        runs = min(rate, 1 / (way.trigger / events + 1 / (2 * rate))) if events else 0.0
        usual = max(usual, 1 / (row["runs"] * row["rate"]))
        seen = max(span, 1 / runs) if runs else 0.0
    each = {name: row[name] / row["runs"] for name in _PER_RUN}
    places = places_of(row["events"] * row["rate"] * usual, each["cells"])
    now = occupied(events * seen, places)
    behind, sent, compared = each["macs"] - each["first_macs"], each["sent"], each["compared"]
    convolved = each["conv_macs"] - each["first_macs"]
    if not moving:
        behind, sent, compared = (
            still["macs"] - still["first_macs"],
            still["sent"],
            still["compared"],
        )
        convolved = still["conv_macs"] - still["first_macs"]
    if way.gate:
        runs = rate * row["runs"] if moving else 0.0
    if way.every > 1:
        runs, seen = runs / way.every, max(span, way.every / rate)
    if way.delta is not None:
        share = min(1.0, math.sqrt(row["rate"] / rate))
        behind, sent, convolved = behind * share, sent * share, convolved * share
        compared *= share
    first = _quotient(each["first_macs"], each["cells"]) * now
    changed = each["changed_macs"] * _quotient(
        occupied(2 * events / runs, places) if runs else 0.0,
        occupied(2 * row["events"] / row["runs"], places),
    )
    found = each | {
        "first_macs": first,
        "changed_macs": changed,
        "macs": first + behind,
        "conv_macs": first + convolved,
        "sent": sent,
        "compared": compared,
        "cells": now,
    }
    found = {name: count * runs / rate for name, count in found.items()}
    return found | {"events": events / rate, "runs": runs / rate}


_PER_RUN = (
    "macs", "first_macs", "changed_macs", "conv_macs", "dense_macs", "first_dense_macs",
    "behind_weights", "memory_weights", "cells", "sent", "compared", "units", "first_units",
    "gates",
)  # fmt: skip


def _quotient(a: float, b: float) -> float:
    return a / b if b else 0.0


def border(rates: Sequence[float], ratios: Sequence[float]) -> float:
    """Control rate [Hz] above which spiking costs less, of ratios of its power to that of float.

    Interpolated between logarithms; 0 where it costs less at all rates, infinity where not at the
    highest.
    """
    dearer = [k for k, ratio in enumerate(ratios) if ratio >= 1]
    if not ratios or dearer[-1:] == [len(ratios) - 1]:
        return math.inf
    if not dearer:
        return 0.0
    k = dearer[-1]
    before, after = math.log(ratios[k]), math.log(ratios[k + 1])
    return float(rates[k] * (rates[k + 1] / rates[k]) ** (before / (before - after)))
