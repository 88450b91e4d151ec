"""A scripted driver: follow the gap (Sezer and Gokasan 2012, the idea) in the LIDAR's scan.

Of every direction in which a ray points it asks how far a kart could go straight on, and turns
towards the best compromise of far and ahead. It sees what a policy sees and has no memory, so what
it finishes needs no learning.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from envs.errors import EnvError

FloatArray = NDArray[np.float64]


class GapDriver:
    """Chooses an action for an observation.

    angles   (R,) of the rays [rad], from straight ahead, positive to the right
    reach    of the LIDAR [px]
    columns  where the observation has what
    actions  their names, in the environment's order
    """

    width = 34.0  # half of what must be free beside the kart's centre [px]
    ahead = 0.7  # share of its worth that a direction straight back loses
    tolerance = 0.13  # off the course below which it drives on [rad]
    caution = 300.0  # free distance at which top speed is still safe [px]

    def __init__(
        self,
        angles: FloatArray,
        reach: float,
        columns: dict[str, slice],
        actions: tuple[str, ...],
    ) -> None:
        between = angles[:, None] - angles[None, :]
        self.angles = (angles + np.pi) % (2 * np.pi) - np.pi
        self.reach, self.columns, self.actions = reach, columns, actions
        self._sine, self._cosine = np.abs(np.sin(between)), np.cos(between)

    @classmethod
    def of(cls, env: gymnasium.Env[Any, Any]) -> GapDriver:
        """The driver for an environment's kart."""
        world: Any = env.unwrapped
        columns = getattr(world, "OBSERVATION", {})
        if not {"lidar", "velocity"} <= set(columns) or not hasattr(world, "ACTIONS"):
            raise EnvError(
                "the gap driver needs a kart whose observation has lidar and velocity; this has "
                f"{', '.join(columns) or 'none'}"
            )
        return cls(world.lidar.angles, world.lidar.range, columns, world.ACTIONS)

    def act(self, observation: FloatArray) -> NDArray[np.int64]:
        """The index of the action, ()."""
        # an observed distance is +1 at the kart and -1 at the end of the ray's reach
        scan = self.reach * (1.0 - observation[self.columns["lidar"]]) / 2
        velocity = observation[self.columns["velocity"]]
        choose = self._push if "up" in self.actions else self._steer
        return np.asarray(self.actions.index(choose(scan, velocity)))

    def free(self, scan: FloatArray) -> FloatArray:
        """How far a kart can go in the direction of each ray (R,) [px], of a scan (R,) [px]."""
        beside, along = self._sine * scan, self._cosine * scan
        blocks = (beside < self.width) & (along > 0)
        free: FloatArray = np.where(blocks, along, self.reach).min(axis=1)
        return free

    def course(self, scan: FloatArray, heading: float) -> tuple[float, float]:
        """The direction to take [rad] and how far it is free [px]; straight ahead is `heading`."""
        free = self.free(scan)
        # worth = free (1 - ahead (1 - cos(angle - heading)) / 2)
        worth = free * (1.0 - self.ahead * (1.0 - np.cos(self.angles - heading)) / 2)
        best = int(np.argmax(worth))
        return float(self.angles[best]), float(free[best])

    def _steer(self, scan: FloatArray, velocity: FloatArray) -> str:
        """The action of a kart that has a heading."""
        angle, free = self.course(scan, 0.0)
        if abs(angle) > self.tolerance:
            return "right" if angle > 0 else "left"
        if "forward" in self.actions:
            return "forward"
        speed, safe = (1.0 + velocity[0]) / 2, min(1.0, free / self.caution)
        return "accelerate" if speed < safe else "brake"

    def _push(self, scan: FloatArray, velocity: FloatArray) -> str:
        """The action of a kart that is pushed in screen directions."""
        heading = float(np.arctan2(velocity[1], velocity[0]))
        angle, free = self.course(scan, heading)
        # of the missing velocity, the larger component
        wanted = min(1.0, free / self.caution) * np.array([np.cos(angle), np.sin(angle)])
        missing = wanted - velocity
        if abs(missing[0]) > abs(missing[1]):
            return "right" if missing[0] > 0 else "left"
        return "down" if missing[1] > 0 else "up"
