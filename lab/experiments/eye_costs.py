"""Energies of policies that see by events, term by term, and a rule that predicts them.

A spiking policy is priced by one of the ACCOUNTINGS, and a float one by the same table beside it,
at 45 nm. Static power is no part of either.

operations   synaptic operations; or multiplications of weights, by the cheapest of three circuits:
             inputs that are not 0; in the first layer those that changed, onto sums that are kept;
             all inputs of convolutions, by an array that reads each of them for 16 channels
updates      neurons that a chip updates, and those that it looks at; units of a GRU
traffic      messages and spikes, where a table prices them; activations that are written and read
histogram    events that are added up until the control step ends, and the cells that hold some
constants    biases, and what the host adds
comparisons  units of a delta network, which are compared with what they sent, and their kept sums

The rule, `predict`, takes the counts of a policy at one control rate, moving and mostly at rest,
and the events a second of another cell of the map. Events come at the rate of motion for the share
of time that this takes, and not at all else; what is counted at rest follows from both counts.

    occupied(n, M) = M (1 - exp(-n / M)), places of M in which one of n events falls
    a float network that runs f times a second sees occupied(e s, C) cells in the time s: its first
        layer takes so many operations a cell, the others what they take in motion and at rest; of
        its cells change those of the events that came and of as many that are past
    one that n events trigger runs min(f, 1 / (n / e + 1 / (2 f))) times a second, as a control step
        ends half a step after them, and not at all at rest; one that runs in every k-th step f / k
        times
    a delta network: behind the first layer a random walk, whose changes since the last control step
        grow with the root of its time
    a spiking one: operations a second as at rest, and the others as cells with events a second;
        updates f N, or f occupied(a / f, N) where a chip updates those alone at which some of a
        operations a second arrive
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from lab.experiments.costs import ACC16, INT8
from lab.experiments.training import Record
from lab.experiments.vision import WAYS, Execution
from spikedeploy.runtime.metrics.energy import (
    ACCESS,
    ADDITION,
    addition_energy,
    chip_terms,
    delta_encoder,
    reading_energy,
)
from spikedeploy.runtime.metrics.energy_tables import MULTIPLICATION, TABLES, sram

TERMS = ("operations", "updates", "traffic", "histogram", "constants", "comparisons")

_BYTE = sram(8)
# an event of a histogram: its count of 8 bits read and written, and an addition
EVENT = 2 * _BYTE + ADDITION
# a cell with events: its address of 16 bits written into a list and read, its count read, cleared
CELL = 2 * ACCESS + 2 * _BYTE
# a unit of a GRU: three functions from tables of 16 bits, three products, five additions, and the
# state of 16 bits read and written
GATES = 3 * ACCESS + 3 * MULTIPLICATION + 5 * ADDITION + 2 * ACCESS
# a multiplication of 8 bits in an array whose weights and sums are in registers, and whose inputs
# are read once for 16 of its columns, as each of 16 x 16 units takes part in each cycle
IN_ARRAY = TABLES[INT8].joules["mac"] - _BYTE + _BYTE / 16
# the leak of a neuron that was not updated for a while, assumed, as no chip that is emulated has
# it: the timestep of its last update read and written, beta^n from a table of 16 bits, a product
LAZY_LEAK = 3 * ACCESS + MULTIPLICATION


@dataclass(frozen=True)
class Accounting:
    """What a chip is charged for.

    title       for people
    place       the chip whose counts it takes
    table       prices of the float networks, and without `chip_table` of the chip
    chip_table  prices of the chip, so scaled that a synaptic operation costs as much as in `table`
    updates     "all" neurons of the ledger in each control step; "touched", those that a spike
                reaches, with a lazy leak
    source      what the charge for updates is known from
    """

    title: str
    place: str
    table: str
    updates: str
    source: str
    chip_table: str = ""

    @property
    def scale(self) -> float:
        """Factor of the prices of the chip's own table."""
        if not self.chip_table:
            return 1.0
        return TABLES[self.table].joules["sop"] / TABLES[self.chip_table].joules["sop"]


ACCOUNTINGS = {
    "loihi1": Accounting(
        "Loihi, all neurons", "loihi1", INT8, "all",
        "sanafe, every price over that of a synaptic operation", "sanafe",
    ),
    "int": Accounting("8-bit integers, all neurons", "int", INT8, "all", "derived"),
    "int-touched": Accounting(
        "8-bit integers, touched neurons", "int", INT8, "touched", "assumed: no emulated chip"
    ),
    "int-memory": Accounting(
        "8-bit integers, sums of 16 bits in memory", "int", ACC16, "all", "derived",
    ),
    "speck": Accounting("Speck in timesteps", "speck2f", ACC16, "all", "derived"),
}  # fmt: skip


def terms(row: Record, accounting: Accounting) -> dict[str, float]:
    """Power [W] of each term of a policy, from its counts of a control step."""
    found = _chip(row, accounting) if row["spiking"] else _float(row, accounting.table)
    return {name: row["rate"] * joules for name, joules in zip(TERMS, found, strict=True)}


def power(row: Record, accounting: Accounting) -> float:
    """All terms [W]."""
    return float(sum(terms(row, accounting).values()))


def _chip(row: Record, accounting: Accounting) -> tuple[float, ...]:
    table = TABLES[accounting.chip_table or accounting.table]
    each = {name: j * accounting.scale for name, j in chip_terms(row, table).items()}
    updates, operations = each["updates"] + each["idle"], each["operations"]
    # what is sent to a chip in timesteps is counted until the control step ends
    histogram = row["events"] * EVENT + row["cells"] * CELL
    if accounting.updates == "touched":
        updates = row["touched"] * (table.joules["neuron_update"] + LAZY_LEAK)
    constants = each["bias"] + addition_energy(row["constants"])
    return operations, updates, each["messages"] + each["spikes"], histogram, constants, 0.0


def _float(row: Record, table: str) -> tuple[float, ...]:
    # where sums are in memory a multiplication reads its input, which is in its price
    moved = row["sent"] * (_BYTE if table == ACC16 else 2 * _BYTE)
    compared = row["compared"]
    kept = compared and row["units"] * 2 * ACCESS
    return (
        _multiplications(row, TABLES[table].joules["mac"]),
        row["gates"] * GATES,
        moved,
        row["events"] * EVENT + row["cells"] * CELL,
        addition_energy(row["units"]),
        delta_encoder(compared, row["sent"] if compared else 0) - reading_energy(compared) + kept,
    )


def _multiplications(row: Record, each: float) -> float:
    """Energy [J] of a float network's multiplications, by the cheapest circuit."""
    kept = row["first_units"] * 2 * ACCESS
    found: float = min(
        row["macs"] * each,
        (row["macs"] - row["first_macs"] + row["changed_macs"]) * each + kept,
        (row["macs"] - row["conv_macs"]) * each + row["dense_macs"] * IN_ARRAY,
    )
    return found


def latency(row: Record) -> tuple[float, float]:
    """Mean and longest time [s] from an event to an action that follows from it, computing apart.

    The event waits until the control step ends, or until as many have come as trigger a network,
    and for the control steps in which layers hand it on.
    """
    way = Execution() if row["spiking"] else WAYS[row["way"]]
    waits = max(way.every, way.trigger / max(row["events"], 1e-9)) / row["rate"]
    first, last = (steps / row["rate"] for steps in row["late"])
    return first + waits / 2, last + waits


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

    row     of the policy, at the rate it was trained for and without quiet
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
    "graded_sop", "spike_out", "spike_in",
)  # fmt: skip


def _still(row: Record, rest: Record) -> Record:
    """Counts of a control step at rest, of which `rest` has a share, and motion the other."""
    moving = min(1.0, rest["events"] / row["events"])
    if moving > 1 - 1e-9:
        return row | dict.fromkeys(_COUNTED, 0.0)
    found = {n: (rest[n] - moving * row[n]) / (1 - moving) for n in _COUNTED if n in row}
    return row | {name: max(each, 0.0) for name, each in found.items()}


def _chip_at(row: Record, still: Record, rate: float, moving: float) -> Record:
    """Counts of a spiking policy at a rate, in motion (1) or at rest (0)."""
    slower = row["rate"] / rate  # a second has so many control steps less
    events = moving * row["events"] * slower
    cells = occupied(events, places_of(row["events"], row["cells"]))
    found = {"events": events, "cells": cells}
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
    behind, sent = each["macs"] - each["first_macs"], each["sent"]
    convolved = each["conv_macs"] - each["first_macs"]
    if not moving:
        behind, sent = still["macs"] - still["first_macs"], still["sent"]
        convolved = still["conv_macs"] - still["first_macs"]
    if way.every > 1:
        runs, seen = rate / way.every, max(span, way.every / rate)
        usual = max(usual, way.every / row["rate"])
    if way.delta is not None:
        share = min(1.0, math.sqrt(row["rate"] / rate))
        behind, sent, convolved = behind * share, sent * share, convolved * share
    first = each["first_macs"] / each["cells"] * now
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
        "cells": now,
    }
    found = {name: count * runs / rate for name, count in found.items()}
    return found | {"events": events / rate, "runs": runs / rate}


_PER_RUN = (
    "macs", "first_macs", "changed_macs", "conv_macs", "dense_macs", "cells", "sent", "compared",
    "units", "first_units", "gates",
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
