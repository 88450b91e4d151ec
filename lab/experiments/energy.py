"""Energy of spiking policies over that of float ones, over what is not known about a chip.

    python -m lab energy

Counts are those of results/energy-pairs.csv: of each task the cheapest spiking policy beside the
cheapest float one with 98 % of the teacher's score, in results/pareto and results/gymnasium.csv,
which are not made any more; prices are those of today.

    spiking = SOPs s + updates x s + encoder + constants
    float   = MACs m + reading + constants

s and m are the prices of the horowitz45-int8 tables for a width of the sums, and x is how many
times as much an update costs as a synaptic operation: that of a published table, or the table's
own. The ratio is 1 at one x, which is written beside it. Writes energy.csv and
energy.md; energy.png was drawn at commit 548e02fb.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from lab.experiments.runner import RESULTS, Record, read_rows, render
from spikedeploy.reports import table
from spikedeploy.runtime.files import write_text
from spikedeploy.runtime.metrics.energy import (
    INSTRUCTION,
    addition_energy,
    delta_encoder,
    reading_energy,
    sram,
)
from spikedeploy.runtime.metrics.energy_tables import TABLES

PAIRS = RESULTS / "energy-pairs.csv"

# width of the sums [bits] -> the table that prices them
SUMS = {
    "none": "horowitz45-int8",
    "16": "horowitz45-int8-acc16",
    "32": "horowitz45-int8-acc32",
}
PUBLISHED = ("sanafe", "davies2018", "horowitz45-int8")
OWN = "own"  # the price of an update that belongs to the table of the sums
ENCODERS = {
    "host": "on the host,\nnot counted",
    "chip": "on the chip",
    "software": "in software",
}
# clock -> updates of a neuron in a control step; `free` runs an inference of one timestep through
# input, hidden layer and readout, and all neurons are updated in each of the three
CLOCKS = {"gated": 1, "pipelined": 1, "free": 3}
# instructions of an encoder in software: load observation and level, subtract, compare, branch; add
# to the level, store it, send the event; of a float network: load, scale, send
_OBSERVATION, _EVENT, _NUMBER = 5, 3, 3
_INPUT_BITS = 8  # of a float network's inputs, as in the tables with sums in memory


@dataclass(frozen=True)
class Pair:
    """A spiking policy and a float one; counts are means of a control step over the trainings.

    score, baseline_score   in parts of the teacher's
    seeds, baseline_seeds   how many trainings
    sops, updates        of all neurons, in a clock that updates each once
    one_state            those of the updates that are of neurons without a current
    events               that the encoder sends
    observations, constants, baseline_observations, baseline_constants
                         read by each, and added to what each puts out
    """

    task: str
    spiking: str
    baseline: str
    score: float
    baseline_score: float
    seeds: int
    baseline_seeds: int
    sops: float
    updates: float
    one_state: float
    events: float
    observations: float
    constants: float
    macs: float
    baseline_observations: float
    baseline_constants: float


def pairs() -> list[Pair]:
    """Return the pairs of all tasks that have both policies."""
    return [Pair(**row) for row in read_rows(PAIRS, ("task", "spiking", "baseline"))]


def encoding(pair: Pair, where: str) -> tuple[float, float]:
    """Energy [J] of the encoder, and of the float network's reading of observations."""
    if where == "host":
        return 0.0, 0.0
    if where == "chip":
        return delta_encoder(pair.observations, pair.events), reading_energy(
            pair.baseline_observations
        )
    mine = _OBSERVATION * pair.observations + _EVENT * pair.events
    return INSTRUCTION * mine, INSTRUCTION * _NUMBER * pair.baseline_observations


@dataclass(frozen=True)
class Energies:
    """Energies of a control step [J]; `update` is of one neuron-timestep, the mean of all."""

    pair: Pair
    sums: str
    where: str
    clock: str

    @property
    def _prices(self) -> Mapping[str, float]:
        return TABLES[SUMS[self.sums]].joules

    @property
    def sop(self) -> float:
        """Of a synaptic operation."""
        return self._prices["sop"]

    def update_over_sop(self, of: str) -> float:
        """How many times as much an update costs as a synaptic operation, by a table."""
        if of == OWN:
            whole = self._prices["neuron_update"]
            alone = self._prices.get("one_state_update", whole)
            share = self.pair.one_state / self.pair.updates
            return (share * alone + (1 - share) * whole) / self.sop
        return _TIMES[of]

    def spiking(self, update_over_sop: float) -> float:
        """Of the spiking policy."""
        updates = CLOCKS[self.clock] * self.pair.updates * update_over_sop
        encoder, _ = encoding(self.pair, self.where)
        return (
            (self.pair.sops + updates) * self.sop + encoder + addition_energy(self.pair.constants)
        )

    @property
    def baseline(self) -> float:
        """Of the float network."""
        _, read = encoding(self.pair, self.where)
        return (
            self.pair.macs * self._prices["mac"]
            + read
            + addition_energy(self.pair.baseline_constants)
        )

    def ratio(self, update_over_sop: float) -> float:
        """Spiking over float."""
        return self.spiking(update_over_sop) / self.baseline

    @property
    def flips_at(self) -> float:
        """The price of an update over that of a synaptic operation at which both cost the same.

        Below 0 where the spiking policy costs more without any updates.
        """
        left = self.baseline - self.spiking(0.0)
        return left / (CLOCKS[self.clock] * self.pair.updates * self.sop)


def rows(found: Sequence[Pair]) -> Iterator[Record]:
    """A row for each pair, width, encoder, clock and price of an update."""
    for pair, sums, where, clock in product(found, SUMS, ENCODERS, CLOCKS):
        energies = Energies(pair, sums, where, clock)
        for of in (*PUBLISHED, OWN):
            x = energies.update_over_sop(of)
            yield vars(pair) | {
                "accumulator_bits": sums,
                "encoder": where,
                "clock": clock,
                "update_price_of": of,
                "update_over_sop": x,
                "spiking_j": energies.spiking(x),
                "float_j": energies.baseline,
                "ratio": energies.ratio(x),
                "flips_at_update_over_sop": energies.flips_at,
            }


_TIMES = {
    name: TABLES[name].joules["neuron_update"] / TABLES[name].joules["sop"] for name in PUBLISHED
}


def operations_ratio(pair: Pair, sums: str, in_registers: bool = False) -> float:
    """Energy of the operations of a pair, spiking over float.

    in_registers: whether the float network's inputs are, so that it need not read any
    """
    prices = TABLES[SUMS[sums]].joules
    read = sram(_INPUT_BITS) if in_registers else 0.0
    return pair.sops * prices["sop"] / (pair.macs * (prices["mac"] - read))


def page(found: Sequence[Pair]) -> str:
    """Return the page of the pairs."""
    return render(
        "energy",
        pairs=found,
        operations_ratio=operations_ratio,
        energies=Energies,
        prices={sums: 1e12 * TABLES[name].joules["sop"] for sums, name in SUMS.items()},
        **{"TIMES": _TIMES, "INSTRUCTION": INSTRUCTION, "SUMS": list(SUMS), "OWN": OWN},
        **{"OBSERVATION": _OBSERVATION, "EVENT": _EVENT, "NUMBER": _NUMBER},
        **{"ENCODERS": list(ENCODERS)},
    )


def main() -> None:
    """Write page and table, and print the page's name."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    found = pairs()
    every = list(rows(found))
    table.write_rows(every, list(every[0]), RESULTS / "energy.csv")
    print(write_text(RESULTS / "energy.md", page(found)))
