"""Domain randomisation: body parameters drawn per episode, and pushes at random intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from spikedeploy.envs.errors import EnvError

Range = float | tuple[float, float]


def sample(value: Range, rng: np.random.Generator) -> float:
    """Draw uniformly from a pair (low, high), or return a plain number."""
    if isinstance(value, tuple):
        return float(rng.uniform(*value))
    return float(value)


def check(name: str, value: object, lowest: float, highest: float) -> Range:
    """Return an option as numbers; EnvError if it is out of bounds or not a range."""
    pair = value if isinstance(value, (tuple, list)) else (value, value)
    numbers = [float(end) for end in pair if isinstance(end, (int, float)) and end is not True]
    if len(pair) != 2 or len(numbers) != 2 or not lowest <= numbers[0] <= numbers[1] <= highest:
        raise EnvError(
            f"option {name}: {value!r} is neither a number from {lowest:g} to {highest:g} "
            f"nor a pair (low, high) of such numbers in order"
        )
    return (numbers[0], numbers[1]) if isinstance(value, (tuple, list)) else numbers[0]


@dataclass(frozen=True)
class PushTable:
    """Distribution of a task's pushes.

    kick      (low, high) [m/s] change of the torso's horizontal velocity, any direction
    spin      [rad/s] standard deviation of the change of its yaw rate
    interval  (shortest, longest) [control steps] from one push to the next
    """

    kick: tuple[float, float]
    spin: float
    interval: tuple[int, int]


@dataclass(frozen=True)
class _Push:
    """One push: kick (x, y) [m/s] and spin [rad/s]."""

    kick: tuple[float, float]
    spin: float


class Pushes:
    """Pushes at random intervals; scale 0 switches them off and leaves the schedule as it is."""

    def __init__(self, table: PushTable, scale: float) -> None:
        self.table = table
        self.scale = scale
        self._next = 0

    def reset(self, rng: np.random.Generator) -> None:
        """Draw the time of the first push."""
        self._next = self._interval(rng)

    def at(self, step: int, rng: np.random.Generator) -> _Push | None:
        """Return the push due at this control step, if any."""
        if step < self._next:
            return None
        self._next = step + self._interval(rng)
        speed = self.scale * rng.uniform(*self.table.kick)
        direction = rng.uniform(-math.pi, math.pi)
        spin = self.scale * rng.normal(0.0, self.table.spin)
        return _Push((speed * math.cos(direction), speed * math.sin(direction)), spin)

    def _interval(self, rng: np.random.Generator) -> int:
        shortest, longest = self.table.interval
        return int(rng.integers(shortest, longest + 1))
