"""Reward of a kart for one step: named terms, and their weights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from spikedeploy.envs.errors import EnvError

# Weights of the default reward. A lap of big_S is 2,400 px, so that progress earns 24, finishing
# 10 more, and a crash costs 5.
_WEIGHTS: Mapping[str, float] = {
    "progress": 1.0,  # per 100 px that the remaining path became shorter
    "gate": 0.0,  # per gate
    "finish": 10.0,  # once
    "crash": -5.0,  # once, at a wall or for stalling
    "time": -0.01,  # per step
}


class StepOutcome(NamedTuple):
    """What happened in one step, as rewards see it.

    gained    decrease of the remaining path [px]
    approach  decrease of the distance to the midpoint of the next gate [px]
    gates     number of gates passed
    since     steps since the last gate
    finish    whether the last gate was passed
    failed    whether the kart crashed or stalled
    speed     [px/s]
    steering  1 towards the next gate, -1 away from it, 0 none
    """

    gained: float
    approach: float
    gates: int
    since: int
    finish: bool
    failed: bool
    speed: float
    steering: int


class PathReward:
    """The default reward, whose progress term is potential-based shaping (Ng et al. 1999).

    The potential is the length of the path through the midpoints of the remaining gates: what
    driving on gains, driving back loses.

    weights  of each term in WEIGHTS
    """

    def __init__(self, changes: Mapping[str, float] | None = None) -> None:
        changes = changes or {}
        unknown = sorted(changes.keys() - _WEIGHTS.keys())
        if unknown:
            raise EnvError(f"reward: unknown term {unknown[0]!r}; known: {', '.join(_WEIGHTS)}")
        for name, weight in changes.items():
            if not isinstance(weight, (int, float)) or not math.isfinite(weight):
                raise EnvError(f"reward: the weight of {name} is {weight!r}, not a finite number")
        self.weights = {**_WEIGHTS, **changes}

    def terms(self, outcome: StepOutcome) -> dict[str, float]:
        """Weighted terms of a step."""
        weights = self.weights
        return {
            "progress": weights["progress"] * outcome.gained / 100.0,
            "gate": weights["gate"] * outcome.gates,
            "finish": weights["finish"] * outcome.finish,
            "crash": weights["crash"] * outcome.failed,
            "time": weights["time"],
        }


@dataclass(frozen=True)
class ClassicReward:
    """kart-simulator's terms and weights, each paid once and not as a running total every step.

    pace                         divisor of exp(v / 100) in the progress term
    backward                     factor of negative progress
    progress, steer, gate, crash weights
    finish                       weight, the same in all environments
    """

    pace: float
    backward: float
    progress: float
    steer: float
    gate: float
    crash: float
    finish: float = 500_000.0

    def terms(self, outcome: StepOutcome) -> dict[str, float]:
        """Weighted terms of a step."""
        # p = (d0 - d1) exp(v / 100) / pace
        p = outcome.approach * math.exp(outcome.speed / 100.0) / self.pace
        p *= self.backward if p < 0 else 1.0
        return {
            "progress": self.progress * p / 80.0,
            # +1 towards the gate, -2 away from it
            "steer": 0.1 * self.steer * (outcome.steering if outcome.steering >= 0 else -2),
            # exp(7 - n / 100) / 3, n steps since the last gate
            "gate": self.gate * outcome.gates * math.exp(7.0 - outcome.since / 100.0) / 3.0,
            "finish": self.finish * outcome.finish,
            "crash": self.crash * outcome.failed,
        }


Reward = PathReward | ClassicReward
