"""A script that walks over tiles: each swinging leg chooses a free foothold and steps onto it.

Legs swing by tripods, half a period of the gait each. In a stance a foot moves back under the body
at the speed of the walk. In a swing the foot goes to one point of its scan: of those that are free,
and whose neighbours are, the one that lies nearest to where a stance should begin when the foot
comes down. The point is chosen anew in every control step, so that what the body did not do as it
should is made up for; the later in the swing, the more it counts how far the foot still has to go.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.hexapod.env import CONTROL_DT
from spikedeploy.envs.hexapod.legs import NEUTRAL, STANDING, feet, joints
from spikedeploy.envs.hexapod.robot import ACTION_UNIT, FREQUENCY, STANCE
from spikedeploy.envs.hexapod.tiles import GRID, SCANS, STRIDE, HexapodTilesEnv

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

_SWING = 0.5 / FREQUENCY  # [s]
_OPPOSITE = np.array([0, 1, 0, 1, 0, 1]) * math.pi  # phase of each leg's tripod


class FootholdScript:
    """The script on observations of HexapodTilesEnv with the view "around"."""

    def __init__(self, env: HexapodTilesEnv) -> None:
        self._slices = env.OBSERVATION
        self._centre, self._spread = env.scaling
        self._points = SCANS["around"].reshape(6, -1, 2)

    def act(self, observation: FloatArray) -> FloatArray:
        """The action (18,)."""
        measured = observation * self._spread + self._centre
        sine, cosine = measured[self._slices["phase"]]
        heading, lateral = (measured[self._slices[n]].item() for n in ("heading", "lateral"))
        turn = min(max(-_HEADING * heading - _LATERAL * lateral, -_TURN), _TURN)
        servos = measured[self._slices["previous"]]  # [action unit]
        now = feet(STANCE + ACTION_UNIT * servos)[:, :2]
        done = ((math.atan2(sine, cosine) + _OPPOSITE) % math.tau) / math.pi  # share of a swing
        swinging = done < 1.0
        goal = self._goals(measured[self._slices["scan"]].reshape(6, -1), now, done, turn)
        steps = np.maximum((_ARRIVED - done) * _SWING / CONTROL_DT, 1.0)[:, None]
        over = now + (goal - now) / steps
        under = now - CONTROL_DT * _passing(now, turn)
        next_ = done + CONTROL_DT / _SWING
        risen = np.clip(np.minimum(next_ / _RISEN, (1.0 - next_) / (1.0 - _FALLING)), 0.0, 1.0)
        lifted = _LIFT * (0.5 - 0.5 * np.cos(math.pi * risen))
        place = np.where(swinging[:, None], over, under)
        height = STANDING[:, 2] + np.where(swinging, lifted, 0.0)
        wanted = (joints(np.concatenate([place, height[:, None]], 1)) - STANCE) / ACTION_UNIT
        return np.asarray(np.clip((wanted - servos) / STRIDE, -1.0, 1.0))

    def _goals(
        self, scan: FloatArray, now: FloatArray, done: FloatArray, turn: float
    ) -> FloatArray:
        """Where feet (6, 2) should be above the footholds that they step onto.

        now   (6, 2) where they are
        done  (6,) share of the swing
        """
        left = _SWING * np.maximum(1.0 - done, 0.0)[:, None, None]
        # where the points will be under the body when the foot comes down
        then = self._points - left * _passing(self._points, turn)
        wanted = NEUTRAL + 0.5 * _SWING * _passing(NEUTRAL, turn)
        cost = np.square(then - wanted[:, None]).sum(-1) + scan + _NEIGHBOUR * _beside(scan)
        to_go = np.square(self._points - now[:, None]).sum(-1)
        cost += _CHANGE * np.square(done)[:, None] * to_go
        chosen = self._points[np.arange(6), np.argmin(cost, 1)]
        arriving = np.maximum((_ARRIVED - done) * _SWING, CONTROL_DT)[:, None] + _LAG
        return np.asarray(chosen - arriving * _passing(NEUTRAL, turn))


def _passing(points: FloatArray, turn: float) -> FloatArray:
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
    return np.asarray(beside.reshape(len(scan), -1))
