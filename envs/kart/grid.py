"""KartGrid-v0: a kart without a heading, pushed up, down, left and right."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from spikedeploy.envs.kart.env import KartEnv
from spikedeploy.envs.kart.options import action_name
from spikedeploy.envs.kart.reward import ClassicReward
from spikedeploy.envs.kart.stall import ClassicLimits
from spikedeploy.envs.kart.world import KartState

_PUSH = 30.0  # [px/s] added to the velocity by one push
_TOP = 400.0  # [px/s] speed at which pushes have no effect, not even braking ones
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
    CLASSIC_OBSERVE: ClassVar[tuple[str, ...]] = ("lidar", "position", "speed")
    RANGE: ClassVar[float] = 600.0
    TURNS: ClassVar[bool] = False
    CLASSIC: ClassVar[ClassicReward] = ClassicReward(
        pace=12.0, backward=1.5, progress=1.0, steer=0.0, gate=1.0, crash=-500.0
    )
    CLASSIC_LIMITS: ClassVar[ClassicLimits] = ClassicLimits(still=0, receding=30)
    CLASSIC_SPEED: ClassVar[float] = _TOP

    def observed_velocity(self, state: KartState) -> tuple[float, float]:
        """Velocity divided by the top speed."""
        vx, vy = state.velocity
        return vx / _TOP, vy / _TOP

    def _act(self, action: Any) -> None:  # noqa: ANN401
        name = action_name(action, self.ACTIONS)
        vx, vy = self._kart.velocity
        if name != "none" and math.hypot(vx, vy) < _TOP:
            dx, dy = _DIRECTIONS[name]
            push = self._power * _PUSH
            self._kart.velocity = vx + push * dx, vy + push * dy

    def _move(self) -> None:
        self._kart.velocity = self._kart.velocity / _FRICTION

    def _steering(self) -> int:
        return 0
