"""KartGazebo-v0: a kart that drives forward or turns on the spot, each at one speed."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from spikedeploy.envs.kart.env import KartEnv
from spikedeploy.envs.kart.options import action_name
from spikedeploy.envs.kart.reward import ClassicReward
from spikedeploy.envs.kart.stall import ClassicLimits
from spikedeploy.envs.kart.world import KartState

SPEED = 440.0  # [px/s] forward
_TURN = 5.68  # [rad/s] on the spot


class KartGazeboEnv(KartEnv):
    """Drive forward at 440 px/s or turn on the spot at 5.68 rad/s, never both.

    Four actions: stop, forward, left, right. A command takes effect in the next step, by 7.33 px
    or 0.0947 rad. Velocity is observed as (2 v / 440 px/s - 1, turn / 5.68 rad/s).
    """

    ACTIONS: ClassVar[tuple[str, ...]] = ("stop", "forward", "left", "right")
    CLASSIC: ClassVar[ClassicReward] = ClassicReward(
        pace=2.0, backward=1.0, progress=0.2, steer=0.7, gate=2.0, crash=-1000.0
    )
    CLASSIC_LIMITS: ClassVar[ClassicLimits] = ClassicLimits(still=100, receding=0)
    CLASSIC_SPEED: ClassVar[float] = (
        4.4  # kart-simulator's, 100 times too small: it saturates at +-1
    )

    def observed_velocity(self, state: KartState) -> tuple[float, float]:
        """Forward speed and turn rate."""
        return 2.0 * math.hypot(*state.velocity) / SPEED - 1.0, state.turn / _TURN

    def _act(self, action: Any) -> None:  # noqa: ANN401
        self._command = action_name(action, self.ACTIONS)

    def _move(self) -> None:
        """Set the velocities of the next step."""
        speed = self._power * SPEED if self._command == "forward" else 0.0
        heading = self._kart.angle
        self._kart.velocity = speed * math.cos(heading), speed * math.sin(heading)
        self._turn = _TURN * self._steering()
        self._kart.angular_velocity = self._turn

    def _steering(self) -> int:
        return {"left": -1, "right": 1}.get(self._command, 0)
