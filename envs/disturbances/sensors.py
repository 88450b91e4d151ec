"""Noise, bias and dropout of what sensors measure; a kart's LIDAR has kinds of its own.

Observations of ours are scaled so that each is about +-1, so a number means the same for all: it is
in units of the scale of each observation, such as 0.5 m/s for a walker's velocity and 0.6 rad for
its joints (envs.hexapod.observation). The scale of those of other people is measured (scales.py).
"""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np

from spikedeploy.envs.disturbances.kind import FOREIGN, HEXAPOD, KART, Kind
from spikedeploy.envs.disturbances.scales import scale
from spikedeploy.envs.disturbances.seeded import FloatArray, SeededWrapper, columns


class _Sensors(SeededWrapper):
    """Changes what sensors measure, within the range of each observation."""

    WITHOUT: ClassVar[tuple[str, ...]] = ("lidar",)

    def __init__(self, env: gymnasium.Env[Any, Any], number: float) -> None:
        super().__init__(env, number)
        self._places = columns(env, *self.WITHOUT)
        space: Any = env.observation_space
        self._low, self._high = space.low[self._places], space.high[self._places]

    def _observed(self, observation: FloatArray) -> FloatArray:
        seen: FloatArray = observation.copy()
        measured = self._measured(seen[self._places])
        seen[self._places] = np.minimum(np.maximum(measured, self._low), self._high)
        return seen

    def _measured(self, values: FloatArray) -> FloatArray:
        """What the sensors say of the true values (k,)."""
        raise NotImplementedError


class _Errors(_Sensors):
    """Errors in units of the scale of each observation."""

    WITHOUT = ("lidar", "contact")  # switches have no noise

    def __init__(self, env: gymnasium.Env[Any, Any], number: float) -> None:
        super().__init__(env, number)
        self._scale = scale(env)


class Noise(_Errors):
    """White Gaussian noise on every measurement, drawn in each control step."""

    STREAM = "noise"

    def _begin(self, observation: FloatArray) -> FloatArray:
        return self._observed(observation)

    def _measured(self, values: FloatArray) -> FloatArray:
        return values + self._scale * self.rng.normal(0.0, self.number, values.shape)


class Bias(_Errors):
    """A constant error of every measurement, drawn in each episode."""

    STREAM = "bias"

    def _begin(self, observation: FloatArray) -> FloatArray:
        self._bias = self._scale * self.rng.normal(0.0, self.number, self._places.shape)
        return self._observed(observation)

    def _measured(self, values: FloatArray) -> FloatArray:
        return values + self._bias


class Dropout(_Sensors):
    """Measurements that are missing in a control step: the last one that arrived is seen."""

    STREAM = "dropout"

    def __init__(self, env: gymnasium.Env[Any, Any], number: float) -> None:
        super().__init__(env, number)
        self._apart = not getattr(env.unwrapped, "one_hot", False)  # which is one measurement

    def _begin(self, observation: FloatArray) -> FloatArray:
        self._last = observation[self._places]
        return observation

    def _measured(self, values: FloatArray) -> FloatArray:
        lost = self.rng.random(values.shape if self._apart else ()) < self.number
        self._last = np.where(lost, self._last, values)
        return self._last


_SCALES = "standard deviations in units of the scale of each observation"
NOISE = Kind(
    meaning="white noise on every measurement, LIDAR and contacts excepted",
    unit="scale of an observation",
    levels={HEXAPOD: (0.05, 0.1, 0.2), KART: (0.05, 0.15, 0.4), FOREIGN: (0.05, 0.1, 0.2)},
    bounds=(0.0, 10.0),
    source="level 2 of a walker is about the noise that walkers are trained with for robots (Rudin "
    "et al. 2022: +-0.1 m/s, +-0.2 rad/s, +-0.05 of gravity, uniform); karts, which steer by the "
    f"LIDAR, are given more; {_SCALES}",
    wrap=Noise,
)
BIAS = Kind(
    meaning="a constant error of every measurement, LIDAR and contacts excepted",
    unit="scale of an observation",
    levels={HEXAPOD: (0.05, 0.1, 0.2), KART: (0.05, 0.15, 0.4), FOREIGN: (0.05, 0.1, 0.2)},
    bounds=(0.0, 10.0),
    source=f"as the noise, of which a filter would leave it; {_SCALES}",
    wrap=Bias,
)
DROPOUT = Kind(
    meaning="measurements that do not arrive: the last one is seen again; LIDAR excepted",
    unit="probability of each, a control step",
    levels={HEXAPOD: (0.05, 0.2, 0.5), KART: (0.2, 0.5, 0.8), FOREIGN: (0.05, 0.2, 0.5)},
    bounds=(0.0, 1.0),
    source="chosen: from a bus with a bad contact to one that delivers every other value, or fewer",
    wrap=Dropout,
)
