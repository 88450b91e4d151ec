"""Servos without power: single joints, and whole legs; an episode draws which."""

from __future__ import annotations

from typing import Any

from spikedeploy.envs.disturbances.kind import HEXAPOD, Kind
from spikedeploy.envs.disturbances.seeded import FloatArray, SeededWrapper
from spikedeploy.envs.errors import EnvError

_JOINTS, _LEGS = 18, 6


class DeadJoint(SeededWrapper):
    """Some servos hold nothing: only the friction of their gears is left."""

    STREAM = "dead-joint"

    def _begin(self, observation: FloatArray) -> FloatArray:
        if self.number != int(self.number):
            raise EnvError(f"--disturb dead-joint={self.number:g}: give a whole number of joints")
        dead = self.rng.permutation(_JOINTS)[: int(self.number)]
        _robot(self).weaken(dead.tolist(), 0.0)
        return observation


class DeadLeg(SeededWrapper):
    """The three servos of one leg lose power."""

    STREAM = "dead-leg"

    def _begin(self, observation: FloatArray) -> FloatArray:
        first = 3 * int(self.rng.integers(_LEGS))
        _robot(self).weaken([first, first + 1, first + 2], 1.0 - self.number)
        return observation


def _robot(wrapper: SeededWrapper) -> Any:  # noqa: ANN401
    """The environment itself, whose servos can be weakened."""
    return wrapper.unwrapped


DEAD_JOINT = Kind(
    meaning="joints without power, drawn anew in each episode",
    unit="joints",
    levels={HEXAPOD: (1, 2, 3)},
    bounds=(0, _JOINTS),
    source="chosen: up to a sixth of the 18 joints",
    wrap=DeadJoint,
)
DEAD_LEG = Kind(
    meaning="a leg that loses power, drawn anew in each episode",
    unit="share that is lost",
    levels={HEXAPOD: (0.5, 0.8, 1.0)},
    bounds=(0.0, 1.0),
    source="chosen: level 3 is a leg without power, as in Cully et al. 2015",
    wrap=DeadLeg,
)
