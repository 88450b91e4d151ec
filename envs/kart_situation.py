"""Where a kart is and how it moves: all that is observed and paid for is read from it."""

from __future__ import annotations

from typing import NamedTuple


class Situation(NamedTuple):
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
