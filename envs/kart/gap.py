"""A scripted driver: follow the gap in the LIDAR's scan (the idea of Sezer and Gokasan 2012).

Of every direction in which a ray points it asks how far a kart could go straight on, and heads for
the best compromise of far and ahead. It sees what a policy sees and has no memory; its numbers were
tuned on big_S, with starts of the validation seeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError

FloatArray = NDArray[np.float64]

WIDTH = 36.0  # half of what must be free beside the centre of a kart of radius 19.2 [px]
TOLERANCE = 0.27  # off the course, below which a kart drives on [rad]
LEAN = 0.5  # by which a kart that turns counts as turned already [rad]
AHEAD = {"steer": 0.5, "push": 0.75}  # share of its worth that going straight back costs
CAUTION = {"steer": 400.0, "push": 250.0}  # free way at which top speed is safe [px]


class GapDriver:
    """Chooses an action for an observation.

    angles   (R,) of the rays [rad], from straight ahead, clockwise
    reach    of the LIDAR [px]
    columns  where the observation has what
    actions  name of an action -> what it is to the environment
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
    def of(cls, env: gymnasium.Env[Any, Any]) -> GapDriver:
        """The driver for an environment's kart."""
        world: Any = env.unwrapped
        columns = getattr(world, "OBSERVATION", {})
        if not {"lidar", "velocity"} <= set(columns) or not hasattr(world, "ACTIONS"):
            raise EnvError(
                "the gap driver needs a kart that observes lidar and velocity; here is "
                f"{', '.join(columns) or 'nothing'}"
            )
        actions = {name: place for place, name in enumerate(world.ACTIONS)}
        if isinstance(env.action_space, gymnasium.spaces.Box):
            actions = world.EFFECTS
        return cls(world.lidar.angles, world.lidar.range, columns, actions)

    def act(self, observation: FloatArray) -> NDArray[Any]:
        """The action (), or (act,) where actions are numbers."""
        # an observed distance is +1 at the kart and -1 at the end of the ray's reach
        scan = self.reach * (1.0 - observation[self.columns["lidar"]]) / 2
        velocity = observation[self.columns["velocity"]]
        choose = self._push if self._kind == "push" else self._steer
        return np.asarray(self.actions[choose(scan, velocity)])

    def free(self, scan: FloatArray) -> FloatArray:
        """How far a kart can go in the direction of each ray (R,) [px], of a scan (R,) [px]."""
        beside, along = self._sine * scan, self._cosine * scan
        blocks = (beside < WIDTH) & (along > 1.0)  # what stands right beside is not in the way
        free: FloatArray = np.where(blocks, along, self.reach).min(axis=1)
        return free

    def course(self, scan: FloatArray, heading: float) -> tuple[float, float]:
        """The direction to take [rad] and how far it is free [px]; `heading` counts as ahead."""
        free = self.free(scan)
        # worth = free (1 - AHEAD (1 - cos(angle - heading)) / 2)
        cost = AHEAD[self._kind] * (1.0 - np.cos(self.angles - heading)) / 2
        best = int(np.argmax(free * (1.0 - cost)))
        angle = (self.angles[best] + np.pi) % (2 * np.pi) - np.pi
        return float(angle), float(free[best])

    def _steer(self, scan: FloatArray, velocity: FloatArray) -> str:
        """The action of a kart that has a heading."""
        angle, free = self.course(scan, LEAN * velocity[1])
        if abs(angle) > TOLERANCE:
            return "right" if angle > 0 else "left"
        if "forward" in self.actions:
            return "forward"
        speed, safe = (1.0 + velocity[0]) / 2, min(1.0, free / CAUTION["steer"])
        return "accelerate" if speed < safe else "brake"

    def _push(self, scan: FloatArray, velocity: FloatArray) -> str:
        """The action of a kart that is pushed in screen directions."""
        angle, free = self.course(scan, float(np.arctan2(velocity[1], velocity[0])))
        # of the velocity that is missing, the larger component
        wanted = min(1.0, free / CAUTION["push"]) * np.array([np.cos(angle), np.sin(angle)])
        missing = wanted - velocity
        if abs(missing[0]) > abs(missing[1]):
            return "right" if missing[0] > 0 else "left"
        return "down" if missing[1] > 0 else "up"
