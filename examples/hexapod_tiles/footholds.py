"""A script that walks over tiles: each swinging leg chooses a free foothold and steps onto it.

Legs swing by tripods, half a period of the gait each. In a stance a foot moves back under the body
at the speed of the walk. In a swing the foot goes to one point of its scan: of those that are free,
and whose neighbours are, the one that lies nearest to where a stance should begin when the foot
comes down. The point is chosen anew in every control step, so that what the body did not do as it
should is made up for; the later in the swing, the more it counts how far the foot still has to go.

Where only the ground ahead is scanned, a map remembers it: points vote for the cells on which they
lie by odometry.
"""

import math

import numpy as np
from numpy.typing import NDArray

from examples.hexapod_tiles.env import GRID, SCANS, STRIDE, View, entries
from examples.hexapod_tiles.kinematics import NEUTRAL, STANDING, feet, joints
from spikedeploy.envs.hexapod.env import CONTROL_DT, layout, scaling
from spikedeploy.envs.hexapod.robot import ACTION_UNIT, FREQUENCY, STANCE

FloatArray = NDArray[np.float64]

# found on seeds 0 to 9
_SPEED = 0.2  # [m/s] of the body over its feet in stance
_LIFT = 0.045  # [m] of a foot in mid-swing
_ARRIVED = 0.7  # share of a swing after which the foot stands over its goal
_RISEN, _FALLING = 0.3, 0.7  # shares of a swing at which it is up, and begins to come down
_LAG = 0.03  # [s] by which servos follow their targets
_HEADING, _LATERAL = 1.5, 0.8  # [1/s] turn for a heading [rad], [rad/s m] for an offset
_TURN = 0.6  # [rad/s] at most
_NEIGHBOUR = 2e-3  # [m^2] what a forbidden point beside a foothold adds to its squared distance
_CHANGE = 2.0  # weight of the squared distance that a foot still has to go, at the end of a swing

_CELL, _CELLS = 0.02, (400, 200)  # [m] of the map, and how many along and across the course
_ORIGIN = np.array([25, 100])  # cell in which an episode begins

_SWING = 0.5 / FREQUENCY  # [s]
_OPPOSITE = np.array([0, 1, 0, 1, 0, 1]) * math.pi  # phase of each leg's tripod


class TileMap:
    """Votes of scans on cells of the ground: above 0 where more points said that it is forbidden.

    Its frame is that of the course, x from where the episode began.
    """

    def __init__(self) -> None:
        self._votes = np.zeros(_CELLS)

    def add(self, points: FloatArray, seen: FloatArray) -> None:
        """Add a scan: points (n, 2) [m], 1 where they are forbidden and 0 elsewhere (n,)."""
        np.add.at(self._votes, self._cells(points), seen - 0.5)

    def look_up(self, points: FloatArray) -> FloatArray:
        """Return 1 where points (n, 2) [m] are forbidden, 0 where they are free or unknown."""
        return np.where(self._votes[self._cells(points)] > 0.0, 1.0, 0.0)

    def _cells(self, points: FloatArray) -> tuple[NDArray[np.int64], ...]:
        cells = np.floor(points * (1 / _CELL)) + _ORIGIN
        return tuple(np.clip(cells, 0, np.array(_CELLS) - 1).astype(np.int64).T)


class FootholdScript:
    """The script on observations of HexapodTiles."""

    VIEW: View = "around"

    def __init__(self) -> None:
        self._slices = layout(entries(self.VIEW))  # earlier rows, which come last, are not read
        self._centre, self._spread = scaling(entries(self.VIEW))
        self._points = SCANS["around"].reshape(6, -1, 2)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Return the action (18,)."""
        scan = self._scan(observation)
        sine, cosine = (self._measured(observation, "phase")[k : k + 1] for k in (0, 1))
        heading, lateral = (self._measured(observation, name) for name in ("heading", "lateral"))
        turn = np.clip(-_HEADING * heading - _LATERAL * lateral, -_TURN, _TURN)
        servos = self._measured(observation, "previous")  # [action unit]
        now = feet(STANCE + ACTION_UNIT * servos)[:, :2]
        done = (np.arctan2(sine, cosine) + _OPPOSITE) % math.tau * (1 / math.pi)  # of a swing
        place = now - CONTROL_DT * _passing(now, turn)
        height = STANDING[:, 2] + np.zeros_like(done)
        legs = np.flatnonzero(done < 1.0)
        place[legs] = self._step(legs, scan[legs], now[legs], done[legs], turn)
        height[legs] += _lifted(done[legs] + CONTROL_DT / _SWING)
        wanted = joints(np.concatenate([place, height[:, None]], 1)) - STANCE
        moved = wanted * (1 / (ACTION_UNIT * STRIDE)) - servos * (1 / STRIDE)
        action: FloatArray = np.minimum(np.maximum(moved, -1.0), 1.0)
        return action

    def _scan(self, observation: FloatArray) -> FloatArray:
        """The scan (6, 35) of the footholds, 1 where a point is forbidden."""
        return observation[self._slices["scan"]].reshape(6, -1)

    def _measured(self, observation: FloatArray, name: str) -> FloatArray:
        """An entry of the observation in its own units."""
        entry = self._slices[name]
        return observation[entry] * self._spread[entry] + self._centre[entry]

    def _step(
        self, legs: NDArray[np.int64], scan: FloatArray, now: FloatArray, done: FloatArray,
        turn: FloatArray,
    ) -> FloatArray:  # fmt: skip
        """Where swinging feet (n, 2) are in the next control step."""
        goal = self._goals(legs, scan, now, done, turn)
        steps = np.maximum((_ARRIVED - done) * (_SWING / CONTROL_DT), 1.0)[:, None]
        return now + (goal - now) / steps

    def _goals(
        self, legs: NDArray[np.int64], scan: FloatArray, now: FloatArray, done: FloatArray,
        turn: FloatArray,
    ) -> FloatArray:  # fmt: skip
        """Where feet (n, 2) should be above the footholds that they step onto.

        scan  (n, 35) of these legs
        now   (n, 2) where their feet are
        done  (n,) share of the swing
        """
        points, passing = self._points[legs], _passing(NEUTRAL[legs], turn)
        left = (_SWING * (1.0 - done))[:, None, None]
        # where the points will be under the body when the foot comes down
        then = points - left * _passing(points, turn)
        wanted = NEUTRAL[legs] + 0.5 * _SWING * passing
        cost = np.square(then - wanted[:, None]).sum(-1) + scan + _NEIGHBOUR * _beside(scan)
        to_go = np.square(points - now[:, None]).sum(-1)
        cost += (_CHANGE * np.square(done))[:, None] * to_go
        chosen = points[np.arange(len(legs)), np.argmin(cost, 1)]
        arriving = np.maximum((_ARRIVED - done) * _SWING, CONTROL_DT)[:, None] + _LAG
        reached: FloatArray = chosen - arriving * passing
        return reached


class RememberingScript(FootholdScript):
    """The script on observations of HexapodTilesAhead, which keeps a map of what it saw."""

    VIEW = "ahead"

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget what was seen."""
        self._map, self._travelled, self._velocity = TileMap(), np.zeros(1), np.zeros(1)

    def _scan(self, observation: FloatArray) -> FloatArray:
        """The scan (6, 35) of the footholds, by the map."""
        seen = observation[self._slices["scan"]]  # 0 and 1, as they are observed
        heading, lateral = (self._measured(observation, name) for name in ("heading", "lateral"))
        cosine, sine = np.cos(heading), np.sin(heading)
        moving = self._measured(observation, "velocity")
        velocity = cosine * moving[:1] - sine * moving[1:2]  # along the course
        self._travelled = self._travelled + (0.5 * CONTROL_DT) * (self._velocity + velocity)
        self._velocity = velocity
        here = np.concatenate([self._travelled, lateral])
        turned = np.stack([np.concatenate([cosine, sine]), np.concatenate([-sine, cosine])])
        self._map.add(here + SCANS["ahead"] @ turned, seen)
        return self._map.look_up(here + self._points.reshape(-1, 2) @ turned).reshape(6, -1)


def _lifted(done: FloatArray) -> FloatArray:
    """Height [m] of feet over the ground at these shares of a swing."""
    up, down = done * (1 / _RISEN), (1.0 - done) * (1 / (1.0 - _FALLING))
    risen = np.clip(np.minimum(up, down), 0.0, 1.0)
    return 0.5 * _LIFT - 0.5 * _LIFT * np.cos(math.pi * risen)


def _passing(points: FloatArray, turn: FloatArray) -> FloatArray:
    """Velocity (..., 2) [m/s] of the body over points (..., 2) of the ground."""
    x, y = points[..., 0], points[..., 1]
    return np.stack([_SPEED - turn * y, turn * x], -1)


def _beside(scan: FloatArray) -> FloatArray:
    """How many of the four neighbours (6, 35) of each point are forbidden."""
    padded = np.pad(scan.reshape(-1, *GRID), ((0, 0), (1, 1), (1, 1)), mode="edge")
    middle = slice(1, -1)
    beside = (
        padded[:, :-2, middle] + padded[:, 2:, middle]
        + padded[:, middle, :-2] + padded[:, middle, 2:]
    )  # fmt: skip
    return beside.reshape(len(scan), -1)
