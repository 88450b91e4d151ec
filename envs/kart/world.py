"""Physics of one kart on one track: a circle among line sensors, on pymunk."""

from __future__ import annotations

from typing import Any, NamedTuple

import pymunk
from numpy.typing import NDArray

from spikedeploy.envs.kart.track import RADIUS, Track

_MASS = 1.0
_KART, _WALL, _GATE = 1, 2, 3  # collision types


class KartState(NamedTuple):
    """State of a kart that observation and reward are computed from.

    x, y, heading: [px], [rad]
    velocity: (2,) [px/s]
    turn: turn rate [rad/s], clockwise
    next_gate: index of the next gate; the number of gates when all are passed
    """

    x: float
    y: float
    heading: float
    velocity: tuple[float, float]
    turn: float
    next_gate: int


class KartWorld:
    """A pymunk space with a kart and with the walls and gates of a track as sensors.

    kart: the body: position [px], velocity [px/s], angle [rad]
    touched_wall: whether the kart touched a wall in the last step
    touching: indices of the gates that the kart touches
    grip: [1] share of a change of velocity that the tyres pass on in a step; 1 is all
    """

    def __init__(self, track: Track, grip: float = 1.0) -> None:
        self.grip = grip
        self.kart = pymunk.Body(_MASS, pymunk.moment_for_circle(_MASS, 0.0, RADIUS))
        self._space = pymunk.Space()
        self._space.on_collision(_KART, _WALL, begin=self._touch_wall)
        self._space.on_collision(_KART, _GATE, begin=self._enter_gate, separate=self._leave_gate)
        for wall in track.walls:
            self._add_line(wall, _WALL)
        self._gates = {self._add_line(gate, _GATE): k for k, gate in enumerate(track.gates)}
        self._rim = pymunk.Circle(self.kart, RADIUS)
        self._rim.collision_type = _KART
        self._space.add(self.kart, self._rim)
        self.clear()

    def clear(self) -> None:
        """Put the kart at rest and clear all contacts."""
        # removed and added again: the space would keep the contacts of the last episode
        self._space.remove(self.kart, self._rim)
        self._space.add(self.kart, self._rim)
        self.kart.velocity, self.kart.angular_velocity, self.kart.angle = (0.0, 0.0), 0.0, 0.0
        self.touching: set[int] = set()
        self.touched_wall = False
        self._slid = self.kart.velocity  # of the last step

    def place(self, x: float, y: float, heading: float) -> None:
        """Set position [px] and heading [rad]."""
        self.kart.position, self.kart.angle = (x, y), heading
        self._space.reindex_shapes_for_body(self.kart)

    def step(self, dt: float) -> None:
        """Advance by dt [s] and record contacts."""
        self.touched_wall = False
        if self.grip < 1.0:
            self.kart.velocity = self._slid + self.grip * (self.kart.velocity - self._slid)
            self._slid = self.kart.velocity
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
