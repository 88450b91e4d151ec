"""Verdicts: what became of a trace when it was replayed."""

from dataclasses import asdict, dataclass
from typing import Any

# in the order in which a neuron computes them
QUANTITIES = ("current", "current 2", "membrane", "spikes")


@dataclass(frozen=True)
class Difference:
    """The first number that is not as recorded.

    step: row of the trace, counted from 0.
    layer, neuron: whose it is; neurons are counted from 0.
    quantity: one of QUANTITIES, or what was summed up over the run, which has no place.
    expected, found: in the trace, and here.
    """

    step: int | None
    layer: str | None
    neuron: int | None
    quantity: str
    expected: float
    found: float

    def describe(self) -> str:
        """One line for people."""
        place = (
            "" if self.step is None else f"step {self.step}, {self.layer}, neuron {self.neuron}, "
        )
        return f"{place}{self.quantity}: expected {self.expected}, found {self.found}"


@dataclass(frozen=True)
class Verdict:
    """What became of a trace.

    chip: in whose reading it was replayed.
    source: who recorded it.
    steps: T.
    compared: numbers that were compared.
    passed_over: recorded numbers that were not compared.
    why: they were not; empty where all were.
    difference: None where all numbers are equal.
    unread: fields of the file that mean nothing to the reader.
    """

    chip: str
    source: str
    steps: int
    compared: int
    passed_over: int
    why: str
    difference: Difference | None
    unread: tuple[str, ...]

    @property
    def equal(self) -> bool:
        """Whether every compared number is as recorded."""
        return self.difference is None

    def as_json(self) -> dict[str, Any]:
        """Everything, for machines."""
        return {"equal": self.equal, **asdict(self)}
