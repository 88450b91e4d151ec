"""The three karts: KartGrid-v0, KartGazebo-v0 and KartSteer-v0."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np

from spikedeploy.envs.finite import all_finite
from spikedeploy.envs.kart.env import (
    CONTROL_DT,
    KartEnv,
    action_name,
    check_choice,
)
from spikedeploy.envs.kart.world import KartState
from spikedeploy.runtime.errors import EnvError

_PUSH = 30.0  # [px/s] added to the velocity by one push
_GRID_TOP = 400.0  # [px/s] speed at which pushes have no effect, not even braking ones
_FRICTION = 1.05  # divisor of the velocity at each step
_DIRECTIONS = {"up": (0.0, -1.0), "down": (0.0, 1.0), "left": (-1.0, 0.0), "right": (1.0, 0.0)}


class KartGridEnv(KartEnv):
    """Push a kart through the gates: 30 px/s a step in one of four directions, up to 400 px/s.

    Five actions: none, up, down, left, right on the screen. It takes 23 steps from rest to
    400 px/s, and without pushes the speed halves in 14. Velocity is observed as (vx, vy) / 400
    px/s. The LIDAR has a range of 600 px, and its first ray always points to the right.
    """

    ACTIONS: ClassVar[tuple[str, ...]] = ("none", "up", "down", "left", "right")
    OBSERVE: ClassVar[tuple[str, ...]] = ("lidar", "position", "velocity")
    RANGE: ClassVar[float] = 600.0
    TURNS: ClassVar[bool] = False

    def observed_velocity(self, state: KartState) -> tuple[float, float]:
        """Velocity divided by the top speed."""
        vx, vy = state.velocity
        return vx / _GRID_TOP, vy / _GRID_TOP

    def _act(self, action: Any) -> None:  # noqa: ANN401
        name = action_name(action, self.ACTIONS)
        vx, vy = self._kart.velocity
        if name != "none" and math.hypot(vx, vy) < _GRID_TOP:
            dx, dy = _DIRECTIONS[name]
            push = self._power * _PUSH
            self._kart.velocity = vx + push * dx, vy + push * dy

    def _move(self) -> None:
        self._kart.velocity = self._kart.velocity / _FRICTION


SPEED = 440.0  # [px/s] forward
_SPOT_TURN = 5.68  # [rad/s] on the spot


class KartGazeboEnv(KartEnv):
    """Drive forward at 440 px/s or turn on the spot at 5.68 rad/s, never both.

    Four actions: stop, forward, left, right. A command takes effect in the next step, by 7.33 px
    or 0.0947 rad. Velocity is observed as (2 v / 440 px/s - 1, turn / 5.68 rad/s).
    """

    ACTIONS: ClassVar[tuple[str, ...]] = ("stop", "forward", "left", "right")

    def observed_velocity(self, state: KartState) -> tuple[float, float]:
        """Forward speed and turn rate."""
        return 2.0 * math.hypot(*state.velocity) / SPEED - 1.0, state.turn / _SPOT_TURN

    def _act(self, action: Any) -> None:  # noqa: ANN401
        self._command = action_name(action, self.ACTIONS)

    def _move(self) -> None:
        speed = self._power * SPEED if self._command == "forward" else 0.0
        heading = self._kart.angle
        self._kart.velocity = speed * math.cos(heading), speed * math.sin(heading)
        self._turn = _SPOT_TURN * {"left": -1, "right": 1}.get(self._command, 0)
        self._kart.angular_velocity = self._turn


_STEER_TOP = 599.0  # [px/s] speed at which the throttle has no effect
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
        check_choice("actions", actions, "discrete", "continuous")
        self._continuous = actions == "continuous"
        super().__init__(**options)
        if self._continuous:
            self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)

    def observed_velocity(self, state: KartState) -> tuple[float, float]:
        """Forward speed and turn rate."""
        return 2.0 * math.hypot(*state.velocity) / _STEER_TOP - 1.0, state.turn / _TURN

    def _begin(self) -> None:
        super()._begin()
        self._forward = self._wheel = 0.0

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
        throttle, steering = self._effect(action)
        if throttle > 0 and self._forward < _STEER_TOP:
            self._forward += self._power * _GAIN * throttle
        elif throttle < 0 and self._forward > 0:
            self._forward += _BRAKE * throttle
        self._wheel += _STEER * steering
        heading = self._kart.angle
        self._kart.velocity = self._forward * math.cos(heading), self._forward * math.sin(heading)

    def _move(self) -> None:
        change = _SHARE * self._wheel
        self._wheel /= _RELEASE
        self._forward /= _DRAG
        self._turn = change / CONTROL_DT
        heading = self._kart.angle + change
        self._kart.angle = heading
        self._kart.velocity = self._forward * math.cos(heading), self._forward * math.sin(heading)
