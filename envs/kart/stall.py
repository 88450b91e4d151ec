"""Stall detection: ends the episode of a kart that makes no progress."""

from __future__ import annotations

from dataclasses import dataclass

_STALL = 120  # [steps] without progress after which a kart has stalled
_PROGRESS = 20.0  # [px] by which the remaining path must become shorter to count
_SLOW = 25.0  # [px/s] below which kart-simulator counts a kart as standing still


class StallRule:
    """Stalled when the remaining path has not become 20 px shorter within 2 s.

    remaining  length of the path at the start [px]
    """

    def __init__(self, remaining: float) -> None:
        self._best, self._steps = remaining, 0

    def stalled(self, remaining: float, approach: float, speed: float) -> bool:
        """Add a step: remaining path [px], decrease of the gate's distance [px], speed [px/s]."""
        if remaining < self._best - _PROGRESS:
            self._best, self._steps = remaining, 0
        else:
            self._steps += 1
        return self._steps >= _STALL


@dataclass(frozen=True)
class ClassicLimits:
    """Limits of kart-simulator's two stall rules.

    still     consecutive steps below 25 px/s, 0 for no limit
    receding  consecutive steps away from the next gate, 0 for no limit
    """

    still: int
    receding: int


class ClassicStallRule:
    """Stalled as in kart-simulator: standing still or moving away from the gate for too long."""

    def __init__(self, limits: ClassicLimits) -> None:
        self._limits = limits
        self._still = self._receding = 0

    def stalled(self, remaining: float, approach: float, speed: float) -> bool:
        """Add a step, as in StallRule."""
        self._still = self._still + 1 if speed < _SLOW else 0
        self._receding = self._receding + 1 if approach < 0 else 0
        still = 0 < self._limits.still <= self._still
        return still or 0 < self._limits.receding <= self._receding
