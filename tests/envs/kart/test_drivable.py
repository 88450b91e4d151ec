"""Every shipped track can be finished: a driver that knows the map does, from unseen starts."""

import math

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.kart import track as track_file
from spikedeploy.envs.kart.track import distances

CELL = 6.0  # [px] of the driver's map
NEAR = 8  # cells ahead that it steers for


class MapDriver:
    """Turns a Gazebo kart on the spot and drives down the map of steps to the next gate."""

    def __init__(self, course):
        self.course = course
        self.low = course.walls.reshape(-1, 2).min(axis=0)
        shape = np.ceil((course.walls.reshape(-1, 2).max(axis=0) - self.low) / CELL).astype(int) + 1
        self.cells = np.indices(shape).reshape(2, -1).T * CELL + self.low
        room = np.min([distances(self.cells, wall[None])[:, 0] for wall in course.walls], axis=0)
        self.open = (room > 26.0).reshape(shape)
        self.maps = {}

    def steps_to(self, gate):
        """Steps (x, y) from every open cell to where a gate is touched, driving around others."""
        if gate not in self.maps:
            away = distances(self.cells, self.course.gates[gate : gate + 1])[:, 0]
            front = (away < 12.0).reshape(self.open.shape) & self.open
            steps = np.where(front, 0.0, np.inf)
            while front.any():
                grown = np.zeros_like(front)
                grown[1:] |= front[:-1]
                grown[:-1] |= front[1:]
                grown[:, 1:] |= front[:, :-1]
                grown[:, :-1] |= front[:, 1:]
                front = grown & self.open & np.isinf(steps)
                steps[front] = steps[np.isfinite(steps)].max() + 1
            self.maps[gate] = steps
        return self.maps[gate]

    def act(self, pose, gate):
        steps = self.steps_to(gate)
        x, y = np.rint((np.array(pose[:2]) - self.low) / CELL).astype(int)
        left, top = max(0, x - NEAR), max(0, y - NEAR)
        around = steps[left : x + NEAR + 1, top : y + NEAR + 1]
        for place in np.argsort(around, axis=None, kind="stable"):
            a, b = np.add(np.unravel_index(place, around.shape), (left, top))
            if self._sees((x, y), (a, b)):
                break
        bearing = math.atan2(b - y, a - x) - pose[2]
        off = math.remainder(bearing, math.tau)
        return 1 if abs(off) < 0.06 else (3 if off > 0 else 2)

    def _sees(self, one, other):
        count = 1 + max(abs(one[0] - other[0]), abs(one[1] - other[1]))
        between = np.rint(np.linspace(one, other, count)).astype(int)
        return self.open[between[1:, 0], between[1:, 1]].all()


@pytest.mark.parametrize("name", track_file.names())
def test_a_driver_with_a_map_finishes(name):
    env = envs.make("kart-gazebo", track=name).unwrapped
    for seed in (10_000, 10_001):
        env.reset(seed=seed)
        driver, over = MapDriver(env.track), False
        while not over:
            *_, terminated, truncated, info = env.step(driver.act(env.pose, env.next_gate))
            over = terminated or truncated
        assert info["finish"], info
