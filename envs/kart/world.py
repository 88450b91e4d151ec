"""The physics of one kart on one track: a circle among lines that are felt but stop nobody."""

from __future__ import annotations

from typing import Any

import pymunk
from numpy.typing import NDArray

from spikedeploy.envs.kart.track import Track
from spikedeploy.envs.kart.track_rules import RADIUS

MASS = 1.0
KART, WALL, GATE = 1, 2, 3  # collision types


class KartWorld:
    """A pymunk space with the walls and gates of a track, and a kart.

    kart          the body: position [px], velocity [px/s], angle [rad]
    touched_wall  whether its rim met a wall in the last step
    touching      indices of the gates that its rim is on
    """

    def __init__(self, track: Track) -> None:
        self.kart = pymunk.Body(MASS, pymunk.moment_for_circle(MASS, 0.0, RADIUS))
        self._space = pymunk.Space()
        self._space.on_collision(KART, WALL, begin=self._touch_wall)
        self._space.on_collision(KART, GATE, begin=self._enter_gate, separate=self._leave_gate)
        for wall in track.walls:
            self._add_line(wall, WALL)
        self._gates = {self._add_line(gate, GATE): k for k, gate in enumerate(track.gates)}
        self._rim = pymunk.Circle(self.kart, RADIUS)
        self._rim.collision_type = KART
        self._space.add(self.kart, self._rim)
        self.forget()

    def forget(self) -> None:
        """Stand still, and touch nothing."""
        # out and in again: the space would go on believing in touches of the last episode
        self._space.remove(self.kart, self._rim)
        self._space.add(self.kart, self._rim)
        self.kart.velocity, self.kart.angular_velocity, self.kart.angle = (0.0, 0.0), 0.0, 0.0
        self.touching: set[int] = set()
        self.touched_wall = False

    def place(self, x: float, y: float, heading: float) -> None:
        """Put the kart somewhere [px], [rad]."""
        self.kart.position, self.kart.angle = (x, y), heading
        self._space.reindex_shapes_for_body(self.kart)

    def step(self, dt: float) -> None:
        """Move the kart for dt [s], and feel what its rim meets."""
        self.touched_wall = False
        self._space.step(dt)

    def _add_line(self, ends: NDArray[Any], kind: int) -> pymunk.Segment:
        a, b = ends
        line = pymunk.Segment(self._space.static_body, tuple(a), tuple(b), 0.0)
        line.sensor, line.collision_type = True, kind
        self._space.add(line)
        return line

    def _touch_wall(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:  # noqa: ANN401
        self.touched_wall = True

    def _enter_gate(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:  # noqa: ANN401
        self.touching |= {self._gates[s] for s in arbiter.shapes if s in self._gates}

    def _leave_gate(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:  # noqa: ANN401
        self.touching -= {self._gates[s] for s in arbiter.shapes if s in self._gates}
