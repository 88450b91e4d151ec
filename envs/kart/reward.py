"""What a kart is paid for in one step: named terms whose sum is the reward."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from spikedeploy.envs.errors import EnvError

# Weights of the default reward. A lap of big_S is 24 hundreds of px, so that finishing is worth
# as much as half the way there, and a crash costs as much as a fifth of it.
WEIGHTS: Mapping[str, float] = {
    "progress": 1.0,  # per 100 px that the remaining path became shorter
    "gate": 0.0,  # per gate
    "finish": 10.0,  # once
    "crash": -5.0,  # once, at a wall or for standing still
    "time": -0.01,  # per step
}


class StepOutcome(NamedTuple):
    """What happened in one step.

    gained    by which the remaining path became shorter [px]
    approach  by which the distance to the middle of the next gate became shorter [px]
    gates     passed in it
    since     steps since the last gate
    finish    whether the last gate was passed
    failed    whether the kart crashed or gave up
    speed     [px/s]
    steering  1 towards the next gate, -1 away from it, 0 not at all
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
    """The default: paid by the way, so that the terms of an episode sum to what it got done.

    Progress is the decrease of a potential, the length of the path through the middles of the gates
    that are left. So what is gained by driving on is lost again by driving back (Ng et al. 1999).

    weights  name -> weight, of WEIGHTS
    """

    def __init__(self, changes: Mapping[str, float] | None = None) -> None:
        changes = changes or {}
        unknown = sorted(changes.keys() - WEIGHTS.keys())
        if unknown:
            raise EnvError(f"reward: unknown term {unknown[0]!r}; known: {', '.join(WEIGHTS)}")
        for name, weight in changes.items():
            if not isinstance(weight, (int, float)) or not math.isfinite(weight):
                raise EnvError(f"reward: the weight of {name} is {weight!r}, not a finite number")
        self.weights = {**WEIGHTS, **changes}

    def terms(self, deed: StepOutcome) -> dict[str, float]:
        """The weighted terms of a step."""
        weights = self.weights
        return {
            "progress": weights["progress"] * deed.gained / 100.0,
            "gate": weights["gate"] * deed.gates,
            "finish": weights["finish"] * deed.finish,
            "crash": weights["crash"] * deed.failed,
            "time": weights["time"],
        }


@dataclass(frozen=True)
class ClassicReward:
    """kart-simulator's terms and weights, paid once where it paid its running total every step.

    pace      divisor of exp(v / 100) in the progress term
    backward  factor of progress below zero
    progress, steer, gate, crash: weights; finishing pays 500,000 in all worlds
    """

    pace: float
    backward: float
    progress: float
    steer: float
    gate: float
    crash: float
    finish: float = 500_000.0

    def terms(self, deed: StepOutcome) -> dict[str, float]:
        """The weighted terms of a step."""
        # p = (d0 - d1) exp(v / 100) / pace
        p = deed.approach * math.exp(deed.speed / 100.0) / self.pace
        p *= self.backward if p < 0 else 1.0
        return {
            "progress": self.progress * p / 80.0,
            # +1 towards the gate, -2 away from it
            "steer": 0.1 * self.steer * (deed.steering if deed.steering >= 0 else -2),
            # S = exp(7 - n / 100) / 3, n steps since the last gate
            "gate": self.gate * deed.gates * math.exp(7.0 - deed.since / 100.0) / 3.0,
            "finish": self.finish * deed.finish,
            "crash": self.crash * deed.failed,
        }


Reward = PathReward | ClassicReward
