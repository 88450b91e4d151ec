"""KartSteer-v0: a kart with throttle, brake and steering, which never slides."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.ends import ClassicEnds, KartState
from spikedeploy.envs.kart.env import CONTROL_DT, KartEnv
from spikedeploy.envs.kart.options import action_name, one_of
from spikedeploy.envs.kart.reward import ClassicReward

TOP = 599.0  # [px/s] from which on the throttle does nothing
GAIN = 7.488  # [px/s] per step of full throttle
BRAKE = 11.98  # [px/s] per step of full brake
DRAG = 1.005  # by which the velocity is divided at each step
STEER = 0.2126  # that a step of full steering adds to the accumulator
SHARE = 0.2  # [rad] of the accumulator by which the heading changes
RELEASE = 3.0  # by which the accumulator is divided at each step
TURN = STEER * SHARE * 1.5 / CONTROL_DT  # [rad/s] when steering is held: the sum of 1/3^k is 1.5


class KartSteerEnv(KartEnv):
    """Accelerate, brake and steer; the velocity always points where the kart does.

    Five actions: none, accelerate, brake, left, right; or, with actions="continuous", (throttle,
    steering) in [-1, 1], where a throttle below zero brakes. 103 steps from rest to the top speed
    of 599 px/s; no reverse; steering held turns by 3.83 rad/s at any speed. Its motion is observed
    as (2 v / 599 px/s - 1, turn / 3.83 rad/s).
    """

    ACTIONS: ClassVar[tuple[str, ...]] = ("none", "accelerate", "brake", "left", "right")
    CLASSIC: ClassVar[ClassicReward] = ClassicReward(
        pace=2.0, backward=1.0, progress=0.5, steer=0.7, gate=1.0, crash=-500.0
    )
    CLASSIC_ENDS: ClassVar[ClassicEnds] = ClassicEnds(still=120, deserting=30)
    CLASSIC_SPEED: ClassVar[float] = TOP
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

    def observed_velocity(self, at: KartState) -> tuple[float, float]:
        """Forward speed and turn rate."""
        return 2.0 * math.hypot(*at.velocity) / TOP - 1.0, at.turn / TURN

    def _begin(self) -> None:
        super()._begin()
        self._forward = self._wheel = self._steered = 0.0

    def _effect(self, action: Any) -> tuple[float, float]:  # noqa: ANN401
        """Throttle and steering, each in [-1, 1]."""
        if not self._continuous:
            return self.EFFECTS[action_name(action, self.ACTIONS)]
        values = np.asarray(action, dtype=np.float64)
        if values.shape != (2,) or not np.isfinite(values).all():
            raise EnvError(f"action {action!r}: two finite numbers are needed, throttle, steering")
        throttle, steering = np.clip(values, -1.0, 1.0).tolist()
        return throttle, steering

    def _act(self, action: Any) -> None:  # noqa: ANN401
        throttle, self._steered = self._effect(action)
        if throttle > 0 and self._forward < TOP:
            self._forward += GAIN * throttle
        elif throttle < 0 and self._forward > 0:
            self._forward += BRAKE * throttle
        self._wheel += STEER * self._steered
        heading = self._kart.angle
        self._kart.velocity = self._forward * math.cos(heading), self._forward * math.sin(heading)

    def _move(self) -> None:
        """Turn the kart and its velocity alike, and slow it down."""
        change = SHARE * self._wheel
        self._wheel /= RELEASE
        self._forward /= DRAG
        self._turn = change / CONTROL_DT
        heading = self._kart.angle + change
        self._kart.angle = heading
        self._kart.velocity = self._forward * math.cos(heading), self._forward * math.sin(heading)

    def _steering(self) -> int:
        return (self._steered > 0) - (self._steered < 0)
