"""KartGrid-v0: a kart without a heading, pushed up, down, left and right."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from spikedeploy.envs.kart.ends import ClassicEnds, KartState
from spikedeploy.envs.kart.env import KartEnv
from spikedeploy.envs.kart.options import action_name
from spikedeploy.envs.kart.reward import ClassicReward

PUSH = 30.0  # [px/s] that a push adds to the velocity
TOP = 400.0  # [px/s] from which on no push acts, not even one that brakes
FRICTION = 1.05  # by which the velocity is divided at each step
DIRECTIONS = {"up": (0.0, -1.0), "down": (0.0, 1.0), "left": (-1.0, 0.0), "right": (1.0, 0.0)}


class KartGridEnv(KartEnv):
    """Push a kart through the gates: 30 px/s a step in one of four directions, up to 400 px/s.

    Five actions: none, up, down, left, right on the screen. From rest to 400 px/s in 23 steps; left
    alone, it has half its speed after 14. Its velocity is observed as (vx, vy) / 400 px/s, its
    LIDAR reaches 600 px and always begins with the ray to the right.
    """

    ACTIONS: ClassVar[tuple[str, ...]] = ("none", "up", "down", "left", "right")
    OBSERVE: ClassVar[tuple[str, ...]] = ("lidar", "position", "velocity")
    CLASSIC_OBSERVE: ClassVar[tuple[str, ...]] = ("lidar", "position", "speed")
    RANGE: ClassVar[float] = 600.0
    TURNS: ClassVar[bool] = False
    CLASSIC: ClassVar[ClassicReward] = ClassicReward(
        pace=12.0, backward=1.5, progress=1.0, steer=0.0, gate=1.0, crash=-500.0
    )
    CLASSIC_ENDS: ClassVar[ClassicEnds] = ClassicEnds(still=0, deserting=30)
    CLASSIC_SPEED: ClassVar[float] = TOP

    def observed_velocity(self, at: KartState) -> tuple[float, float]:
        """Velocity over the top speed."""
        vx, vy = at.velocity
        return vx / TOP, vy / TOP

    def _act(self, action: Any) -> None:  # noqa: ANN401
        name = action_name(action, self.ACTIONS)
        vx, vy = self._kart.velocity
        if name != "none" and math.hypot(vx, vy) < TOP:
            dx, dy = DIRECTIONS[name]
            self._kart.velocity = vx + PUSH * dx, vy + PUSH * dy

    def _move(self) -> None:
        self._kart.velocity = self._kart.velocity / FRICTION

    def _steering(self) -> int:
        return 0
