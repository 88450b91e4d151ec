"""When a kart has given up: one rule of ours, and kart-simulator's two.

Where a kart is and how it moves: all that is observed and paid for is read from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

STALL = 120  # [steps] without getting on, after which a kart has given up
GETTING_ON = 20.0  # [px] by which the remaining path must have become shorter
SLOW = 25.0  # [px/s] below which kart-simulator says that a kart stands still


class Stall:
    """Gives up when the remaining path has not become 20 px shorter within 2 s.

    remaining  path from the start [px]
    """

    def __init__(self, remaining: float) -> None:
        self._best, self._for = remaining, 0

    def gives_up(self, remaining: float, approach: float, speed: float) -> bool:
        """Take in a step: path left [px], how much nearer the gate came [px], speed [px/s]."""
        if remaining < self._best - GETTING_ON:
            self._best, self._for = remaining, 0
        else:
            self._for += 1
        return self._for >= STALL


@dataclass(frozen=True)
class ClassicEnds:
    """When kart-simulator gives an episode up.

    still       steps below 25 px/s in a row, 0 for never
    deserting   steps of negative progress in a row, 0 for never
    """

    still: int
    deserting: int


class ClassicStall:
    """Gives up as kart-simulator does."""

    def __init__(self, ends: ClassicEnds) -> None:
        self._ends = ends
        self._still_for = self._deserting_for = 0

    def gives_up(self, remaining: float, approach: float, speed: float) -> bool:
        """Take in a step, as Stall does."""
        self._still_for = self._still_for + 1 if speed < SLOW else 0
        self._deserting_for = self._deserting_for + 1 if approach < 0 else 0
        still = 0 < self._ends.still <= self._still_for
        return still or 0 < self._ends.deserting <= self._deserting_for


class KartState(NamedTuple):
    """Where a kart is and how it moves.

    x, y, heading  [px], [rad]
    velocity       (2,) [px/s]
    turn           [rad/s], clockwise
    next_gate      index of the gate that comes next; the number of gates when all are passed
    """

    x: float
    y: float
    heading: float
    velocity: tuple[float, float]
    turn: float
    next_gate: int
