"""Gap follower: a scripted driver on the LIDAR's scan (after Sezer and Gokasan 2012).

For the direction of every ray it computes how far a kart could drive straight on, and steers to the
best compromise between that length and the deviation from the heading. It observes what a policy
observes and has no memory; its parameters were tuned on big_S with validation seeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import EnvError

FloatArray = NDArray[np.float64]

WIDTH = 36.0  # half width of the free lane that a kart of radius 19.2 needs [px]
_TOLERANCE = 0.27  # heading error below which a kart drives on [rad]
_LEAN = 0.5  # anticipated heading change per observed turn rate [rad]
_AHEAD = {"steer": 0.5, "push": 0.75}  # relative cost of turning back
_CAUTION = {"steer": 400.0, "push": 250.0}  # free length at which top speed is safe [px]


class GapDriver:
    """Scripted policy: chooses an action for an observation.

    angles: (R,) directions of the rays [rad], from straight ahead, clockwise
    reach: range of the LIDAR [px]
    columns: component -> slice of the observation
    actions: name of an action -> its value in the environment
    """

    def __init__(
        self,
        angles: FloatArray,
        reach: float,
        columns: Mapping[str, slice],
        actions: Mapping[str, Any],
    ) -> None:
        between = angles[:, None] - angles[None, :]
        self.angles, self.reach, self.columns, self.actions = angles, reach, columns, actions
        self._sine, self._cosine = np.abs(np.sin(between)), np.cos(between)
        self._kind = "push" if "up" in actions else "steer"

    @classmethod
    def for_env(cls, env: gymnasium.Env[Any, Any]) -> GapDriver:
        """Return the driver for the kart of an environment."""
        kart: Any = env.unwrapped
        columns = getattr(kart, "OBSERVATION", {})
        if not {"lidar", "velocity"} <= set(columns) or not hasattr(kart, "ACTIONS"):
            raise EnvError(
                "the gap driver needs a kart that observes lidar and velocity; here is "
                f"{', '.join(columns) or 'nothing'}"
            )
        actions = {name: place for place, name in enumerate(kart.ACTIONS)}
        if isinstance(env.action_space, gymnasium.spaces.Box):
            actions = kart.EFFECTS
        return cls(kart.lidar.angles, kart.lidar.range, columns, actions)

    def act(self, observation: FloatArray) -> NDArray[Any]:
        """The action: () int for a discrete action space, else (act,)."""
        # distances are observed from +1 at the kart to -1 at the range
        scan = self.reach * (1.0 - observation[self.columns["lidar"]]) / 2
        velocity = observation[self.columns["velocity"]]
        choose = self._push if self._kind == "push" else self._steer
        return np.asarray(self.actions[choose(scan, velocity)])

    def free(self, scan: FloatArray) -> FloatArray:
        """Free length (R,) [px] in the direction of each ray, for a scan (R,) [px]."""
        beside, along = self._sine * scan, self._cosine * scan
        blocks = (beside < WIDTH) & (along > 1.0)  # hits right beside the kart do not block
        free: FloatArray = np.where(blocks, along, self.reach).min(axis=1)
        return free

    def course(self, scan: FloatArray, heading: float) -> tuple[float, float]:
        """Best direction [rad] and its free length [px]; deviation from `heading` is penalised."""
        free = self.free(scan)
        # score = free (1 - AHEAD (1 - cos(angle - heading)) / 2)
        cost = _AHEAD[self._kind] * (1.0 - np.cos(self.angles - heading)) / 2
        best = int(np.argmax(free * (1.0 - cost)))
        angle = (self.angles[best] + np.pi) % (2 * np.pi) - np.pi
        return float(angle), float(free[best])

    def _steer(self, scan: FloatArray, velocity: FloatArray) -> str:
        angle, free = self.course(scan, _LEAN * velocity[1])
        if abs(angle) > _TOLERANCE:
            return "right" if angle > 0 else "left"
        if "forward" in self.actions:
            return "forward"
        speed, safe = (1.0 + velocity[0]) / 2, min(1.0, free / _CAUTION["steer"])
        return "accelerate" if speed < safe else "brake"

    def _push(self, scan: FloatArray, velocity: FloatArray) -> str:
        angle, free = self.course(scan, float(np.arctan2(velocity[1], velocity[0])))
        # push along the larger component of the missing velocity
        wanted = min(1.0, free / _CAUTION["push"]) * np.array([np.cos(angle), np.sin(angle)])
        missing = wanted - velocity
        if abs(missing[0]) > abs(missing[1]):
            return "right" if missing[0] > 0 else "left"
        return "down" if missing[1] > 0 else "up"
