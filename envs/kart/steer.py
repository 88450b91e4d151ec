"""KartSteer-v0: a kart with throttle, brake and steering, without lateral slip."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.finite import all_finite
from spikedeploy.envs.kart.env import CONTROL_DT, KartEnv
from spikedeploy.envs.kart.options import action_name, one_of
from spikedeploy.envs.kart.reward import ClassicReward
from spikedeploy.envs.kart.stall import ClassicLimits
from spikedeploy.envs.kart.world import KartState

_TOP = 599.0  # [px/s] speed at which the throttle has no effect
_GAIN = 7.488  # [px/s] per step of full throttle
_BRAKE = 11.98  # [px/s] per step of full brake
_DRAG = 1.005  # divisor of the speed at each step
_STEER = 0.2126  # added to the steering accumulator by a step of full steering
_SHARE = 0.2  # [rad] change of heading per unit of the accumulator
_RELEASE = 3.0  # divisor of the accumulator at each step
_TURN = _STEER * _SHARE * 1.5 / CONTROL_DT  # [rad/s] when steering is held: the sum of 1/3^k is 1.5


class KartSteerEnv(KartEnv):
    """Accelerate, brake and steer; the velocity always points along the heading.

    Five actions: none, accelerate, brake, left, right; or, with actions="continuous", (throttle,
    steering) in [-1, 1], where negative throttle brakes. 103 steps from rest to the top speed of
    599 px/s; no reverse; held steering turns at 3.83 rad/s at any speed. Velocity is observed as
    (2 v / 599 px/s - 1, turn / 3.83 rad/s).
    """

    ACTIONS: ClassVar[tuple[str, ...]] = ("none", "accelerate", "brake", "left", "right")
    CLASSIC: ClassVar[ClassicReward] = ClassicReward(
        pace=2.0, backward=1.0, progress=0.5, steer=0.7, gate=1.0, crash=-500.0
    )
    CLASSIC_LIMITS: ClassVar[ClassicLimits] = ClassicLimits(still=120, receding=30)
    CLASSIC_SPEED: ClassVar[float] = _TOP
    EFFECTS: ClassVar[dict[str, tuple[float, float]]] = {
        "none": (0.0, 0.0),
        "accelerate": (1.0, 0.0),
        "brake": (-1.0, 0.0),
        "left": (0.0, -1.0),
        "right": (0.0, 1.0),
    }

    def __init__(
        self,
        *,
        actions: Literal["discrete", "continuous"] = "discrete",
        **options: Any,  # noqa: ANN401
    ) -> None:
        one_of("actions", actions, ("discrete", "continuous"))
        self._continuous = actions == "continuous"
        super().__init__(**options)
        if self._continuous:
            self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)

    def observed_velocity(self, state: KartState) -> tuple[float, float]:
        """Forward speed and turn rate."""
        return 2.0 * math.hypot(*state.velocity) / _TOP - 1.0, state.turn / _TURN

    def _begin(self) -> None:
        super()._begin()
        self._forward = self._wheel = self._steered = 0.0

    def _effect(self, action: Any) -> tuple[float, float]:  # noqa: ANN401
        """Throttle and steering, each in [-1, 1]."""
        if not self._continuous:
            return self.EFFECTS[action_name(action, self.ACTIONS)]
        values = np.asarray(action, dtype=np.float64)
        if values.shape != (2,) or not all_finite(values):
            raise EnvError(
                f"action {action!r}: two finite numbers are needed, throttle and steering"
            )
        throttle, steering = np.clip(values, -1.0, 1.0).tolist()
        return throttle, steering

    def _act(self, action: Any) -> None:  # noqa: ANN401
        throttle, self._steered = self._effect(action)
        if throttle > 0 and self._forward < _TOP:
            self._forward += self._power * _GAIN * throttle
        elif throttle < 0 and self._forward > 0:
            self._forward += _BRAKE * throttle
        self._wheel += _STEER * self._steered
        heading = self._kart.angle
        self._kart.velocity = self._forward * math.cos(heading), self._forward * math.sin(heading)

    def _move(self) -> None:
        """Turn the kart together with its velocity, and apply drag."""
        change = _SHARE * self._wheel
        self._wheel /= _RELEASE
        self._forward /= _DRAG
        self._turn = change / CONTROL_DT
        heading = self._kart.angle + change
        self._kart.angle = heading
        self._kart.velocity = self._forward * math.cos(heading), self._forward * math.sin(heading)

    def _steering(self) -> int:
        return (self._steered > 0) - (self._steered < 0)
