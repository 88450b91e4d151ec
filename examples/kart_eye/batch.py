"""EyeBatch: B karts that see by event cameras, simulated at once.

The physics runs at 960 Hz and views are drawn at 240 Hz or at the control rate, if that is higher:
a kart whose actions are held drives the same path at every control rate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from examples.kart_eye.course import (
    GATE_AT,
    HALF,
    LENGTHS,
    PLANES,
    SIDES,
    TEXTURE_COLUMNS,
    TEXTURE_ROWS,
    TEXTURES,
    Course,
    directions,
    draw_course,
)
from examples.kart_eye.signs import BLURS, COLUMNS, ROWS, Signs
from examples.kart_eye.view import View
from spikedeploy.envs.event_camera import CameraParameters, EventCamera

Floats = NDArray[np.float64]

STEERING = (-1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0)  # of the seven actions; positive is right
PHYSICS = 960  # [Hz]
VIEWS = 240  # [Hz] at least
RATES = (60, 240, 960)  # [Hz] of control
SPEED = 3.0  # [m/s]
TURN = 5.0  # [rad/s] at full steering and full speed
LAG = 0.08  # [s] time constant of the turn rate
BRAKE = 12.0  # [m/s^2] at a gate, and from it
RADIUS = 0.25  # of the kart [m]
HEAD_ON = 0.75  # share of the speed into a wall that is a crash; below it the kart slides
TAKEN = HALF + 0.3  # of the middle of a fork [m], where an arm has been taken
CAMERA = CameraParameters(on_threshold=0.25, off_threshold=0.25, mismatch=0.03, shot_noise_hz=0.1)
_FOLLOWED = 1 - math.exp(-1 / (PHYSICS * LAG))  # share of a change, in a step of the physics
_GREY = math.log(60.0)  # log luminance of a wall, of which the view draws the rest
_GAP = 0.6  # [m] before a gate at which a kart stands
_OPENING, _LIFT = 0.3, 2.5  # [s], [m] in which a gate opens, upwards
_AHEAD = 0.8  # [m] of the point that the teacher pursues


@dataclass(frozen=True)
class EyeOptions:
    """Options of the world.

    signs      "letters", mirrored where the left arm is open, or "chevrons", which point
    rate       control rate [Hz]: 60, 240 or 960
    quiet      share of the time in which the kart waits at gates, 0 to 0.95
    forks      of an episode
    camera     parameters of the event camera, by name, where they are not those of CAMERA
    shape      (rows, columns) of the camera
    pool       pixels whose events are added up: pool by pool
    max_steps  control steps after which an episode is truncated, those at gates not counted; 0
               stands for 30 s
    """

    signs: Signs = "letters"
    rate: int = 60
    quiet: float = 0.0
    forks: int = 6
    camera: Mapping[str, float] = field(default_factory=dict)
    shape: tuple[int, int] = (32, 64)
    pool: int = 2
    max_steps: int = 0

    def __post_init__(self) -> None:
        if self.signs not in ("letters", "chevrons"):
            raise ValueError(f"signs must be letters or chevrons, found {self.signs!r}")
        if self.rate not in RATES:
            raise ValueError(f"rate must be 60, 240 or 960 Hz, found {self.rate!r}")
        if not 0 <= self.quiet <= 0.95:
            raise ValueError(f"quiet must be a share from 0 to 0.95, found {self.quiet!r}")

    @property
    def counted(self) -> tuple[int, int, int]:
        """Shape of the event counts: polarity, rows, columns."""
        return 2, self.shape[0] // self.pool, self.shape[1] // self.pool

    @property
    def wait(self) -> float:
        """Mean time at a gate [s], by which `quiet` is reached."""
        # to stop and to start again takes SPEED / BRAKE longer
        return self.quiet / (1 - self.quiet) * (sum(LENGTHS) / 2 / SPEED + SPEED / BRAKE)


def nearest_action(steering: Floats) -> NDArray[np.int64]:
    """The actions (B,) whose steering is nearest to steering (B,)."""
    found: NDArray[np.int64] = np.abs(steering[:, None] - STEERING).argmin(1)
    return found


class EyeBatch:
    """B karts, each in a course of its own.

    options     of all
    x, y, heading, turn, speed  (B,) [m], [rad], [rad/s], [m/s]
    fork        (B,) index of the fork ahead, which is the number of forks passed
    """

    def __init__(
        self,
        batch: int,
        options: EyeOptions | None = None,
        **changes: Any,  # noqa: ANN401
    ) -> None:
        self.options = options = replace(options or EyeOptions(), **changes)
        self.size, n = batch, options.forks
        self._view = View(options.shape)
        self._substeps = PHYSICS // options.rate
        self._renders = max(1, VIEWS // options.rate)
        self.courses: list[Course] = [None] * batch  # type: ignore[list-item]
        self.seeds = np.zeros(batch, np.int64)
        zeros = np.zeros(batch)
        self.x, self.y, self.heading, self.turn, self.speed = (zeros.copy() for _ in range(5))
        self.fork, self.steps = np.zeros(batch, np.int64), np.zeros(batch, np.int64)
        self._travelled, self._waited = zeros.copy(), zeros.copy()
        self._hold = zeros.copy()  # [s] for which the gate ahead stays closed
        self._frame = np.zeros((4, batch))  # direction and origin of the corridor, x and y
        self._over, self._go = np.zeros(batch, np.bool_), zeros.copy()  # steps of the physics [s]
        self._length, self._arm = zeros.copy(), np.zeros(batch, np.int64)
        self._walls = np.full((batch, 2, SIDES, 5), np.nan, np.float32)
        self._planes = np.zeros((batch, PLANES, 8), np.float32)
        self._textures = np.zeros((batch, TEXTURES, TEXTURE_ROWS, TEXTURE_COLUMNS), np.float32)
        self._pictures = np.zeros((batch, 2 * n + 3, len(BLURS), ROWS, COLUMNS), np.float32)
        self._frames = np.full((batch, *options.shape), _GREY, np.float32)  # log luminance
        parameters = CameraParameters(**{**asdict(CAMERA), **options.camera})
        self._camera = EventCamera(self._frames.shape, parameters, [0] * batch, is_log=True)
        self._time = zeros.copy()  # of the last frames [s]
        self.pixels = np.zeros((batch, 2, *options.shape), np.uint8)

    def reset(self, seeds: Sequence[int], which: Sequence[int] | None = None) -> NDArray[np.uint8]:
        """Begin episodes, of all karts or of some; the counts (B, 2, rows, columns), all 0."""
        chosen = range(self.size) if which is None else which
        for b, seed in zip(chosen, seeds, strict=True):
            self._begin(b, int(seed))
        self._camera.reset(seeds, chosen)
        self._draw(np.asarray(chosen, np.int64))
        self.pixels[list(chosen)] = 0
        return np.zeros((self.size, *self.options.counted), np.uint8)

    def _begin(self, b: int, seed: int) -> None:
        options = self.options
        course = draw_course(seed, options.forks, options.signs, options.wait)
        rng = np.random.default_rng([seed, 1])
        self.courses[b], self.seeds[b] = course, seed
        self._textures[b], self._pictures[b] = course.textures, course.pictures
        side, tilt = rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2)
        self.x[b], self.y[b], self.heading[b] = 0.0, -side, tilt
        self.turn[b], self.speed[b] = 0.0, SPEED
        self.fork[b] = self.steps[b] = 0
        self._travelled[b] = self._waited[b] = 0.0
        self._over[b], self._go[b] = False, 1 / PHYSICS
        self._enter(b)

    def _enter(self, b: int) -> None:
        """Begin the corridor before the fork ahead."""
        course, k = self.courses[b], int(self.fork[b])
        self._hold[b] = course.wait[k]
        self._frame[:, b] = *directions(course.ahead[k]), *course.origin[k]
        self._length[b], self._arm[b] = course.length[k], course.arm[k]
        self._walls[b], self._planes[b] = course.local[k].walls, course.local[k].planes

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Advance by a control step; karts whose episode ended stay as they are until reset.

        actions  (B,) 0 to 6, index of STEERING

        Returns counts (B, 2, rows, columns), reward (B,), terminated and truncated (B,), and an
        info of arrays (B,): `right`, `wrong` (an arm has been taken, the open one or the other),
        `crash`, `finish`, `forks` passed, `arm` (+1 where the right arm ahead is open, else -1),
        and `waiting` at a gate.
        """
        options = self.options
        wanted = -TURN * np.asarray(STEERING)[actions]
        before = self._travelled.copy()
        outcome = {name: np.zeros(self.size, np.bool_) for name in ("right", "wrong", "crash")}
        self.pixels[:] = 0
        for _ in range(self._renders):
            moved = self.moving()
            for _ in range(self._substeps // self._renders):
                self._drive(wanted, outcome)
            self._draw(np.flatnonzero(moved | self.moving()))
            self._time += 1 / (self._renders * options.rate)
            self._camera.count(self._frames, self._time, self.pixels)
        self.steps += 1
        finish = self.fork >= options.forks
        terms: dict[str, Floats] = {
            "progress": 0.1 * (self._travelled - before),
            "right": outcome["right"].astype(np.float64),
            "wrong": -outcome["wrong"].astype(np.float64),
            "crash": -outcome["crash"].astype(np.float64),
        }
        terminated = finish | outcome["wrong"] | outcome["crash"]
        late = self.steps - self._waited * options.rate >= (options.max_steps or 30 * options.rate)
        info = {**outcome, "finish": finish, "forks": self.fork.copy(), "arm": self._arm.copy()}
        info |= {"waiting": self.speed == 0}
        return (
            self._pooled(),
            sum(terms.values(), np.zeros(self.size)),
            terminated,
            late & ~terminated,
            info,
        )

    def teacher(self) -> Floats:
        """Steering (B,) of the privileged teacher in [-1, 1], positive to the right.

        Pure pursuit (Coulter 1992): the arc through a point 0.8 m ahead on the path, which follows
        the middle of the corridor and of the open arm.
        """
        x, y, angle = self._local()
        rest = self._length - y - _AHEAD  # negative in front of a fork
        goal_x = np.where(rest > 0, 0.0, self._arm * np.maximum(-rest, self._arm * x + 0.5))
        goal_y = np.where(rest > 0, y + _AHEAD, self._length)
        dx, dy = goal_x - x, goal_y - y
        aside = dx * np.cos(angle) - dy * np.sin(angle)
        curvature = 2 * aside / (dx**2 + dy**2)
        found: Floats = np.clip(curvature * SPEED / TURN, -1, 1)
        return found

    # physics

    def _local(self) -> tuple[Floats, Floats, Floats]:
        """Position (B,) to the right and ahead in the corridor, and heading to its right."""
        fx, fy, ox, oy = self._frame
        ax, ay = self.x - ox, self.y - oy
        angle = np.arctan2(fy, fx) - self.heading
        angle = (angle + math.pi) % (2 * math.pi) - math.pi
        return ax * fy - ay * fx, ax * fx + ay * fy, angle

    def moving(self) -> NDArray[np.bool_]:
        """Return a mask (B,) of the karts whose view changes."""
        opens = (self._hold > 0) & (self._hold < _OPENING)
        moving: NDArray[np.bool_] = ~self._over & ((self.speed > 0) | opens)
        return moving

    def _drive(self, wanted: Floats, outcome: dict[str, NDArray[np.bool_]]) -> None:
        """Advance the physics by 1/960 s.

        wanted  (B,) turn rate [rad/s] of a kart at full speed
        """
        if self.options.quiet:
            self._obey_gates()
        self.turn += (wanted - self.turn) * _FOLLOWED
        pace = self.speed * self._go
        self.heading += self.turn * pace / SPEED
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        self.x += pace * cos
        self.y += pace * sin
        fx, fy, ox, oy = self._frame
        ax, ay = self.x - ox, self.y - oy
        x, y = ax * fy - ay * fx, ax * fx + ay * fy
        ahead = cos * fx + sin * fy
        self._travelled += pace * ahead
        # the middle of a corridor and of an arm is far from everything
        if ((np.abs(x) > HALF - RADIUS) | (y > self._length + HALF - RADIUS) | (y < 0)).any():
            self._touch(x, y, cos * fy - sin * fx, ahead, outcome)

    def _touch(
        self,
        x: Floats,
        y: Floats,
        right: Floats,
        ahead: Floats,
        outcome: dict[str, NDArray[np.bool_]],
    ) -> None:
        """Keep the karts inside or end their episodes, and pass on to the next corridors.

        x, y          (B,) position in the corridor [m]
        right, ahead  (B,) direction there
        """
        free, end = HALF - RADIUS, self._length + HALF - RADIUS
        over, under = np.abs(x) - free, self._length - free - y  # the corridor's walls, its corners
        outside = (over > 0) & (under > 0)
        at_side, at_corner = outside & (over <= under), outside & (over > under)
        at_end, at_start = y > end, y < 0
        into = np.select(
            (at_end, at_start | at_corner, at_side), (ahead, -ahead, right * np.sign(x)), 0.0
        )
        outcome["crash"] |= ~self._over & (into > HEAD_ON)
        put_x = np.where(at_side, np.copysign(free, x), x)
        put_y = np.clip(np.where(at_corner, y + under, y), 0, end)
        fx, fy, _, _ = self._frame
        self.x += (put_x - x) * fy + (put_y - y) * fx
        self.y += (put_y - y) * fy - (put_x - x) * fx
        taken = ~self._over & ~outcome["crash"] & (np.abs(put_x) > TAKEN)
        right_arm = np.sign(put_x) == self._arm
        outcome["right"] |= taken & right_arm
        outcome["wrong"] |= taken & ~right_arm
        for b in np.flatnonzero(taken & right_arm).tolist():
            self.fork[b] += 1
            if self.fork[b] < self.options.forks:
                self._enter(b)
        self._over |= outcome["crash"] | outcome["wrong"] | (self.fork >= self.options.forks)
        self._go = np.where(self._over, 0.0, 1 / PHYSICS)

    def _obey_gates(self) -> None:
        """Brake before closed gates, wait until they are open, and go on."""
        _, y, _ = self._local()
        room = GATE_AT - _GAP - y
        halts = (self._hold > 0) & (self.speed**2 >= 2 * BRAKE * (room - self.speed / PHYSICS))
        change = np.where(halts, -BRAKE, BRAKE) / PHYSICS
        self.speed = np.clip(self.speed + change, 0, SPEED)
        waits = halts & (self.speed == 0) & ~self._over
        self._hold = np.where(waits, np.maximum(self._hold - 1 / PHYSICS, 0), self._hold)
        self._waited += waits / PHYSICS

    # camera

    def look(self, view: View, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """Log luminance (len(rows), rows, columns) that some of the karts have before them."""
        position = np.stack((self.x[rows], self.y[rows]), 1)
        planes = self._planes[rows]
        planes[:, -1, 5:7] += np.float32(_LIFT) * (1 - self._hold[rows, None] / _OPENING).clip(0, 1)
        shown = self._walls[rows], planes, self._textures, self._pictures, rows
        return view.log_luminance(position, self.heading[rows], *shown)

    @property
    def closed(self) -> NDArray[np.bool_]:
        """Mask (B,) of the karts before whom a gate is closed."""
        return np.asarray(self._hold > 0)

    def _draw(self, rows: NDArray[np.int64]) -> None:
        """Draw what some of the karts see; the others stand still."""
        if len(rows):
            self._frames[rows] = self.look(self._view, rows) + np.float32(_GREY)

    def _pooled(self) -> NDArray[np.uint8]:
        """Counts (B, 2, rows, columns) of the cells, at most 255."""
        pool, total = self.options.pool, np.zeros((self.size, *self.options.counted), np.uint16)
        for row in range(pool):
            for column in range(pool):
                total += self.pixels[:, :, row::pool, column::pool]
        return np.minimum(total, 255).astype(np.uint8)
