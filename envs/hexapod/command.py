"""HexapodCommand-v0: follow a commanded forward speed and turn rate over rougher ground."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from spikedeploy.envs.hexapod.env import (
    BODY,
    CONTROL_DT,
    LOAD,
    SMOOTHING,
    FloatArray,
    HexapodEnv,
    ObservationEntry,
    PushTable,
    Range,
    command_terms,
    layout,
)
from spikedeploy.envs.hexapod.robot import Field, Motion

_STAND = 0.15  # probability of the command to stand still
SPEED = (-0.25, 0.45)  # [m/s]
_TURN = 0.8  # [rad/s] largest turn rate
_OUTER_SPEED = 0.5  # [m/s] largest speed of the outer legs
_HALF_TRACK = 0.2  # [m] distance of the outer feet from the body's centre
HOLD = (100, 200)  # [control steps] shortest and longest duration of a command

# RMSE below which commands are followed: a fifth of the largest command. A robot that stands still
# has about twice as much, the RMS of the commands themselves (0.22 m/s and 0.36 rad/s).
_FOLLOWED = 0.2
FOLLOWED = np.array([_FOLLOWED * SPEED[1], _FOLLOWED * _TURN])  # [m/s], [rad/s]

_COMMANDED_BODY = tuple(
    ObservationEntry("turn_error", 1, 0.0, 0.8) if entry.name == "heading" else entry  # [rad/s]
    for entry in BODY
)
_COMMAND = (
    ObservationEntry("speed_error", 1, 0.0, 0.4),  # [m/s] commanded - smoothed, as turn_error
    ObservationEntry("command", 2, 0.0, (0.45, 0.8)),  # [m/s], [rad/s] forward speed and turn rate
)


def draw_command(rng: np.random.Generator) -> tuple[float, float]:
    """Draw forward speed [m/s] and turn rate [rad/s] that the legs can follow together."""
    stand = rng.random() < _STAND
    speed = rng.uniform(*SPEED)
    turn = _fastest_turn(speed) * rng.uniform(-1.0, 1.0)
    return (0.0, 0.0) if stand else (speed, turn)


def _fastest_turn(speed: float) -> float:
    """Largest turn rate [rad/s] that the outer legs can follow at a forward speed [m/s]."""
    # |turn| <= (outer speed - |speed|) / half track
    return min(_TURN, (_OUTER_SPEED - abs(speed)) / _HALF_TRACK)


class HexapodCommandEnv(HexapodEnv):
    """Follow a speed and a turn rate that change every 2 to 4 s, on 5 to 9 cm bumps.

    The same body, gait, action pipeline and options as HexapodEnv, with three differences:
    the residual has an authority of 0.9 on the six coxae, without which the gait cannot be
    reversed; kicks are 0.25 to 0.5 m/s; the ground is rougher. 15 % of the commands are to stand.

    Observation (77,): turn_error, speed_error and command (speed, turn) replace heading, speed,
    lateral and lateral_velocity. A real robot therefore needs no odometry of position or heading;
    it still has to estimate the body's velocity (leg kinematics with an inertial unit) and its
    height over the ground. Servos, inertial unit and foot sensors measure the rest.

    Reward: 1 + 2.5 kernel(speed error, 0.12 m/s) + 2 kernel(turn error, 0.3 rad/s), less sideways
    motion and the regularisers of HexapodEnv; at most 5.5 a step. The kernel is narrow because with
    a broad one an open-loop gait modulator scores like a policy with feedback.

    A fall is an up axis below 0.5 or a height below 0.035 m. An episode succeeds when it does not
    fall and follows: RMSE below a fifth of the largest command in speed and turn rate, 0.09 m/s and
    0.16 rad/s (FOLLOWED), changes of the command included. The gait alone earns about 1400. The
    info adds command_speed, command_turn, speed_error and turn_error (commanded - smoothed) to
    HexapodEnv's; its speed is along the body and its distance the length of the path.
    """

    ENTRIES: ClassVar[tuple[ObservationEntry, ...]] = (*_COMMANDED_BODY, *_COMMAND, LOAD)
    OBSERVATION: ClassVar[dict[str, slice]] = layout(ENTRIES)
    FIELD: ClassVar[Field] = Field(length=18.0, width=18.0, start=(0.0, 0.0))
    PUSHES: ClassVar[PushTable] = PushTable(kick=(0.25, 0.5), spin=1.0, interval=(75, 200))
    START_HEADING: ClassVar[float] = math.pi
    LOWEST_HEIGHT: ClassVar[float] = 0.035
    CROUCH_HEIGHT: ClassVar[float] = 0.085
    AUTHORITY: ClassVar[FloatArray] = np.tile([0.9, 0.5, 0.5], 6)

    def __init__(self, *, terrain: Range = (0.05, 0.09), **options: Any) -> None:  # noqa: ANN401
        super().__init__(terrain=terrain, **options)

    @property
    def command(self) -> tuple[float, float]:
        """Current command: forward speed [m/s] and turn rate [rad/s]."""
        return self._command

    def steer(self, speed: float, turn: float) -> None:
        """Command a speed [m/s] and a turn rate [rad/s] until the end, clipped to their limits."""
        speed = min(max(speed, SPEED[0]), SPEED[1])
        most = _fastest_turn(speed)
        self._command = speed, min(max(turn, -most), most)
        self._change = math.inf

    def _begin(self) -> None:
        self._turn = 0.0
        self._squares = np.zeros(2)
        self._command = draw_command(self.np_random)
        self._change = self._hold()

    def _update_command(self) -> None:
        if self._step >= self._change:
            self._command = draw_command(self.np_random)
            self._change = self._step + self._hold()

    def _hold(self) -> int:
        shortest, longest = HOLD
        return int(self.np_random.integers(shortest, longest + 1))

    def _track(self, motion: Motion) -> None:
        forward, _ = _planar(motion)
        self._speed += SMOOTHING * (forward - self._speed)
        self._turn += SMOOTHING * (motion.angular_velocity[2] - self._turn)
        self._distance += abs(self._speed) * CONTROL_DT
        speed, turn = self._command
        self._squares += np.square([speed - self._speed, turn - self._turn])

    def _succeeds(self) -> bool:
        return bool((np.sqrt(self._squares / self._step) < FOLLOWED).all())

    def _task_terms(self, motion: Motion) -> dict[str, float]:
        speed, turn = self._command
        _, sideways = _planar(motion)
        return command_terms(speed - self._speed, turn - self._turn, sideways)

    def _task_observation(self, motion: Motion) -> tuple[float, ...]:
        speed, turn = self._command
        return turn - self._turn, speed - self._speed, speed, turn

    def _info(self, motion: Motion, terms: dict[str, float], fall: bool) -> dict[str, Any]:
        speed, turn = self._command
        return super()._info(motion, terms, fall) | {
            "command_speed": speed,
            "command_turn": turn,
            "speed_error": speed - self._speed,
            "turn_error": turn - self._turn,
        }


def _planar(motion: Motion) -> tuple[float, float]:
    """Forward and leftward speed [m/s] in the horizontal plane, relative to the heading."""
    vx, vy, _ = motion.velocity
    cosine, sine = math.cos(motion.heading), math.sin(motion.heading)
    return vx * cosine + vy * sine, vy * cosine - vx * sine
