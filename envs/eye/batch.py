"""EyeBatch: B karts that see by event cameras, simulated at once.

The physics runs at 960 Hz and views are drawn at 240 Hz or at the control rate, if that is higher:
a kart whose actions are held drives the same path at every control rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.eye.course import (
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
from spikedeploy.envs.eye.signs import BLURS, COLUMNS, ROWS, Signs
from spikedeploy.envs.eye.view import EYE, View

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
_AHEAD = 0.8  # [m] of the point that the teacher pursues


@dataclass(frozen=True)
class EyeOptions:
    """Options of the world.

    signs      "letters", mirrored where the left arm is open, or "chevrons", which point
    rate       control rate [Hz]: 60, 240 or 960
    quiet      share of the time in which the kart waits at gates, 0 to 0.95
    forks      of an episode
    noise      events of a pixel without cause [Hz]
    threshold  change of log luminance for an event, mean of the pixels
    mismatch   standard deviation of the threshold over pixels
    shape      (rows, columns) of the camera
    pool       pixels whose events are added up: pool by pool
    seconds    after which an episode is truncated, gates not counted
    """

    signs: Signs = "letters"
    rate: int = 60
    quiet: float = 0.0
    forks: int = 6
    noise: float = 0.5
    threshold: float = 0.25
    mismatch: float = 0.03
    shape: tuple[int, int] = (32, 64)
    pool: int = 2
    seconds: float = 30.0

    def __post_init__(self) -> None:
        if self.signs not in ("letters", "chevrons"):
            raise EnvError(f"signs must be letters or chevrons, found {self.signs!r}")
        if self.rate not in RATES:
            raise EnvError(f"rate must be 60, 240 or 960 Hz, found {self.rate!r}")
        if not 0 <= self.quiet <= 0.95:
            raise EnvError(f"quiet must be a share from 0 to 0.95, found {self.quiet!r}")

    @property
    def counted(self) -> tuple[int, int, int]:
        """Shape of the event counts: polarity, rows, columns."""
        return 2, self.shape[0] // self.pool, self.shape[1] // self.pool

    @property
    def wait(self) -> float:
        """Mean time at a gate [s], by which `quiet` is reached."""
        return self.quiet / (1 - self.quiet) * sum(LENGTHS) / 2 / SPEED


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
        self._rng: list[np.random.Generator] = [None] * batch  # type: ignore[list-item]
        self.seeds = np.zeros(batch, np.int64)
        zeros = np.zeros(batch)
        self.x, self.y, self.heading, self.turn, self.speed = (zeros.copy() for _ in range(5))
        self.fork, self.steps = np.zeros(batch, np.int64), np.zeros(batch, np.int64)
        self._travelled, self._waited = zeros.copy(), zeros.copy()
        self._hold = zeros.copy()  # [s] for which the gate ahead stays closed
        self._origin, self._forward = np.zeros((batch, 2)), np.zeros((batch, 2))
        self._length, self._arm, self._sign_y = (
            zeros.copy(),
            np.zeros(batch, np.int64),
            zeros.copy(),
        )
        self._letter = np.zeros((batch, 2))
        self._held = np.zeros(batch, np.bool_)
        self._walls = np.full((batch, 2, SIDES, 6), np.nan)
        self._planes = np.zeros((batch, PLANES, 8))
        self._textures = np.zeros((batch, TEXTURES, TEXTURE_ROWS, TEXTURE_COLUMNS), np.float32)
        self._pictures = np.zeros((batch, n + 2, len(BLURS), ROWS, COLUMNS), np.float32)
        self._seen = np.zeros((batch, *options.shape), np.float32)  # log luminance at last events
        self._thresholds = np.zeros((batch, 2, *options.shape), np.float32)
        rows, columns = np.indices(options.shape) // options.pool
        self._cell = (rows * options.counted[2] + columns).reshape(-1)  # of a pixel

    # episodes

    def reset(self, seeds: Sequence[int], which: Sequence[int] | None = None) -> NDArray[np.uint8]:
        """Begin episodes, of all karts or of some; the counts (B, 2, rows, columns), all 0."""
        chosen = range(self.size) if which is None else which
        for b, seed in zip(chosen, seeds, strict=True):
            self._begin(b, int(seed))
        rows = np.asarray(list(chosen), np.int64)
        self._seen[rows] = self._look(rows)
        self._notice()
        return np.zeros((self.size, *self.options.counted), np.uint8)

    def _begin(self, b: int, seed: int) -> None:
        options = self.options
        course = draw_course(seed, options.forks, options.signs, options.wait)
        rng = np.random.default_rng([seed, 1])
        self.courses[b], self._rng[b], self.seeds[b] = course, rng, seed
        self._textures[b], self._pictures[b] = course.textures, course.pictures
        spread = rng.standard_normal((2, *options.shape))
        limits = options.threshold + options.mismatch * spread
        self._thresholds[b] = np.maximum(limits, 0.04 * options.threshold)
        side, tilt = rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2)
        self.x[b], self.y[b], self.heading[b] = 0.0, -side, tilt
        self.turn[b], self.speed[b] = 0.0, SPEED
        self.fork[b] = self.steps[b] = 0
        self._travelled[b] = self._waited[b] = 0.0
        self._enter(b)

    def _enter(self, b: int) -> None:
        """Begin the corridor before the fork ahead."""
        course, k = self.courses[b], int(self.fork[b])
        self._hold[b] = course.wait[k]
        self._origin[b], self._forward[b] = course.origin[k], directions(course.ahead[k])
        self._length[b], self._arm[b] = course.length[k], course.arm[k]
        self._sign_y[b], self._letter[b] = course.sign_y[k], course.letter[k]
        self._walls[b], self._planes[b] = course.local[k].walls, course.local[k].planes
        self._held[b] = False

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Advance by a control step; karts whose episode ended stay as they are until reset.

        actions  (B,) 0 to 6, index of STEERING

        Returns counts (B, 2, rows, columns), reward (B,), terminated and truncated (B,), and by
        name what else is known of each (B,).
        """
        options = self.options
        wanted = np.asarray(STEERING)[actions]
        before = self._travelled
        outcome = {name: np.zeros(self.size, np.bool_) for name in ("right", "wrong", "crash")}
        hits: list[Any] = []
        counts: list[Any] = []
        for _ in range(self._renders):
            stood = self._moving()
            for _ in range(self._substeps // self._renders):
                self._drive(wanted, outcome)
            moved = np.flatnonzero(stood | self._moving())
            if len(moved):
                self._events(moved, hits, counts)
        self._noise(hits, counts)
        self.steps += 1
        finish = self.fork >= options.forks
        self._notice()
        terms: dict[str, Floats] = {
            "progress": 0.1 * (self._travelled - before),
            "right": outcome["right"].astype(np.float64),
            "wrong": -outcome["wrong"].astype(np.float64),
            "crash": -outcome["crash"].astype(np.float64),
        }
        terminated = finish | outcome["wrong"] | outcome["crash"]
        late = self.steps / options.rate - self._waited > options.seconds
        info = {**outcome, "finish": finish, "terms": terms, **self.known()}
        return (
            self._pooled(hits, counts),
            sum(terms.values(), np.zeros(self.size)),
            terminated,
            late & ~terminated,
            info,
        )

    def known(self) -> dict[str, Any]:
        """What a teacher may know of each kart (B,), and labels for auxiliary losses.

        forks     passed
        arm       +1 where the right arm ahead is open, else -1
        visible   the letter of the sign ahead is in the picture, at least in part
        readable  all of it is, at a height of 6 pixels or more
        hint      0 before the sign was readable, then until the turn 1 for left, 2 for right
        state     (B, 6) x / 1 m, distance to the fork / 1 m, sin and cos of the heading, both by
                  the corridor, turn rate / 5 rad/s, speed / 3 m/s
        waiting   the kart stands at a gate
        """
        x, y, angle = self._local()
        state = np.stack(
            (
                x,
                self._length - y,
                np.sin(angle),
                np.cos(angle),
                self.turn / TURN,
                self.speed / SPEED,
            ),
            1,
        )
        return {
            "forks": self.fork.copy(),
            "arm": self._arm.copy(),
            "visible": self._visible.copy(),
            "readable": self._readable.copy(),
            "hint": np.where(self._held, (self._arm + 3) // 2, 0),
            "state": state,
            "waiting": self.speed == 0,
        }

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
        away_x, away_y = self.x - self._origin[:, 0], self.y - self._origin[:, 1]
        fx, fy = self._forward.T
        angle = np.arctan2(fy, fx) - self.heading
        angle = (angle + math.pi) % (2 * math.pi) - math.pi
        return away_x * fy - away_y * fx, away_x * fx + away_y * fy, angle

    def _moving(self) -> NDArray[np.bool_]:
        moving: NDArray[np.bool_] = (self.speed > 0) | (self._hold > 0) & (self._hold < 0.3)
        return moving

    def _drive(self, wanted: Floats, outcome: dict[str, NDArray[np.bool_]]) -> None:
        """Advance the physics by 1/960 s."""
        dt = 1 / PHYSICS
        alive = ~(outcome["wrong"] | outcome["crash"] | (self.fork >= self.options.forks))
        y = self._local()[1]
        room = np.where(self._hold > 0, GATE_AT - 0.6 - y, 9.0)
        stopping = (
            (self._hold > 0)
            & (y < GATE_AT)
            & (self.speed**2 >= 2 * BRAKE * (room - self.speed * dt))
        )
        self.speed = np.clip(self.speed + np.where(stopping, -BRAKE, BRAKE) * dt, 0, SPEED)
        waiting = stopping & (self.speed == 0)
        self._hold = np.where(waiting, np.maximum(self._hold - dt, 0), self._hold)
        self._waited += dt * waiting
        share = 1 - math.exp(-dt / LAG)
        self.turn += (-wanted * TURN * (self.speed / SPEED) - self.turn) * share
        go = dt * alive
        self.heading += self.turn * go
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        self.x += self.speed * cos * go
        self.y += self.speed * sin * go
        self._collide(alive, cos, sin, outcome)

    def _collide(
        self,
        alive: NDArray[np.bool_],
        cos: Floats,
        sin: Floats,
        outcome: dict[str, NDArray[np.bool_]],
    ) -> None:
        """Keep the karts inside, or end the episode; pass on to the next corridor."""
        fx, fy = self._forward.T
        ax, ay = self.x - self._origin[:, 0], self.y - self._origin[:, 1]
        x, y = ax * fy - ay * fx, ax * fx + ay * fy
        to_right, to_front = cos * fy - sin * fx, cos * fx + sin * fy
        free, end = HALF - RADIUS, self._length + HALF - RADIUS
        over, under = np.abs(x) - free, self._length - HALF + RADIUS - y
        inside = (over <= 0) | (under <= 0)
        beside = ~inside & (over <= under)
        corner = ~inside & ~beside
        ahead, behind = y > end, y < 0
        side = np.sign(x)
        into = np.where(beside, to_right * side, 0.0)
        into = np.where(corner | behind, -to_front, into)
        into = np.where(ahead, to_front, into)
        touches = ~inside | ahead | behind
        outcome["crash"] |= alive & touches & (into > HEAD_ON)
        if touches.any():
            put_x = np.where(beside, side * free, x)
            put_y = np.where(corner, y + under, y)
            put_y = np.clip(put_y, 0, end)
            self.x = np.where(touches, self._origin[:, 0] + put_x * fy + put_y * fx, self.x)
            self.y = np.where(touches, self._origin[:, 1] - put_x * fx + put_y * fy, self.y)
            x = put_x
        self._travelled = self._travelled + self.speed * to_front * alive / PHYSICS
        taken = alive & (np.abs(x) > TAKEN) & ~outcome["crash"]
        if taken.any():
            outcome["right"] |= taken & (np.sign(x) == self._arm)
            outcome["wrong"] |= taken & (np.sign(x) != self._arm)
            for b in np.flatnonzero(taken & (np.sign(x) == self._arm)).tolist():
                self.fork[b] += 1
                if self.fork[b] < self.options.forks:
                    self._enter(b)

    # camera

    def _look(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """Log luminance (len(rows), rows, columns) that some of the karts see."""
        position = np.stack((self.x[rows], self.y[rows]), 1)
        planes = self._planes[rows]
        lifted = np.clip(1 - self._hold[rows] / 0.3, 0, 1) * (self.options.quiet > 0)
        planes[:, PLANES - 1, 5:7] += 2.5 * lifted[:, None]
        seen = self._view.log_luminance(
            position,
            self.heading[rows],
            self._walls[rows],
            planes,
            self._textures,
            self._pictures,
            rows,
        )
        return seen

    def _events(self, rows: NDArray[np.int64], hits: list[Any], counts: list[Any]) -> None:
        """Append the events since the last view: index (k,) of polarity and pixel, and number."""
        seen, pixels = self._look(rows), self._cell.size
        change = seen - self._seen[rows]
        found = np.flatnonzero(np.abs(change) >= 0.6 * self.options.threshold)
        which, pixel = np.divmod(found, pixels)
        change = change.reshape(-1)[found]
        place = (rows[which] * 2 + (change < 0)) * pixels + pixel
        limit = self._thresholds.reshape(-1)[place]
        number = np.floor(np.abs(change) / limit).astype(np.int64)
        some = number > 0
        place, number = place[some], number[some]
        self._seen.reshape(-1)[rows[which[some]] * pixels + pixel[some]] += np.copysign(
            number * limit[some], change[some]
        ).astype(np.float32)
        hits.append(place)
        counts.append(number)

    def _noise(self, hits: list[Any], counts: list[Any]) -> None:
        mean = self.options.noise * self._cell.size / self.options.rate
        if not mean:
            return
        for b, rng in enumerate(self._rng):
            number = rng.poisson(mean)
            if number:
                place = rng.integers(0, 2 * self._cell.size, number)
                hits.append(place + b * 2 * self._cell.size)
                counts.append(np.ones(number, np.int64))

    def _pooled(self, hits: list[Any], counts: list[Any]) -> NDArray[np.uint8]:
        """Counts (B, 2, rows, columns) of the cells."""
        shape = (self.size, *self.options.counted)
        if not hits:
            return np.zeros(shape, np.uint8)
        place, number = np.concatenate(hits), np.concatenate(counts)
        first, pixel = np.divmod(place, self._cell.size)
        cells = shape[2] * shape[3]
        total = np.bincount(first * cells + self._cell[pixel], number, self.size * 2 * cells)
        return np.minimum(total, 255).astype(np.uint8).reshape(shape)

    def _notice(self) -> None:
        """Set which letters are visible and readable, and hold what was read until the turn."""
        x, y, angle = self._local()
        depth = self._sign_y - y
        far = np.maximum(depth, 0.05)
        # of the board's middle, to the right of the kart's axis and along it
        along = far * np.cos(angle) - x * np.sin(angle)
        aside = -x * np.cos(angle) - far * np.sin(angle)
        top, side = self._view.slope[0], 1.0
        tall = self._letter[:, 1] - self._letter[:, 0]
        pixels = tall / np.maximum(along, 0.05) * self.options.shape[1] / 2
        in_view = (depth > 0.2) & (along > 0.1) & (np.abs(aside) < side * along)
        self._visible = in_view & (self._letter[:, 0] - EYE < top * along)
        self._readable = in_view & (self._letter[:, 1] - EYE < top * along) & (pixels >= 6)
        self._held |= self._readable
