"""What the karts have in common: the world, the episode, the observation and the reward.

Lengths are in px, 100 px to a metre, y downwards; angles in rad, 0 to the right, clockwise. A step
of the environment is one step of the physics, 1/60 s.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import gymnasium
import numpy as np
import pymunk
from numpy.typing import NDArray

from envs import track as tracks
from envs.corridor import cells_in, corridor
from envs.errors import EnvError
from envs.kart_observation import CLASSIC_RAYS, Observer
from envs.kart_reward import ClassicReward, Deed, PathReward, Reward
from envs.lidar import Lidar, LidarOptions
from envs.track import Track
from envs.track_rules import RADIUS

FloatArray = NDArray[np.float64]

CONTROL_DT = 1.0 / 60.0  # [s]
MASS = 1.0
STALL = 120  # [steps] without getting on, after which a kart has given up
GETTING_ON = 20.0  # [px] by which the remaining path must have become shorter
KART, WALL, GATE = 1, 2, 3  # collision types


class Situation(NamedTuple):
    """Where a kart is and how it moves.

    x, y, heading  [px], [rad]
    velocity       (2,) [px/s]
    turn           [rad/s], clockwise
    next_gate      index of the gate that comes next; the number of gates when all are passed
    """

    x: float
    y: float
    heading: float
    velocity: tuple[float, float]
    turn: float
    next_gate: int


@dataclass(frozen=True)
class ClassicEnds:
    """When kart-simulator gives an episode up.

    still       steps below 25 px/s in a row, 0 for never
    deserting   steps of negative progress in a row, 0 for never
    """

    still: int
    deserting: int


class KartEnv(gymnasium.Env[FloatArray, Any]):
    """A kart that has to pass a track's gates in their order without touching a wall.

    preset      "default", or "classic": kart-simulator's observation, reward and ends
    track       a name of envs.track.names(), `corridor`, `corridor-N`, a .json file, or a Track
    observe     components of envs.kart_observation; None takes the preset's
    lidar       LidarOptions, or some of them by name, over the environment's defaults
    reward      "default", "classic", or weights by name over those of the default
    max_steps   after which an episode is truncated
    start       "random" within the track's spread and headings, or "fixed" in their middle
    render_mode "rgb_array" or None

    An episode ends with the last gate (terminated, a success), at a wall (terminated), when the
    remaining path has not become 20 px shorter within 2 s (terminated: standing still and driving
    in circles are failures of the driver, not of the clock), or after max_steps (truncated).
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 60}  # noqa: RUF012
    CONTROL_DT: ClassVar[float] = CONTROL_DT
    ACTIONS: ClassVar[tuple[str, ...]]
    OBSERVE: ClassVar[tuple[str, ...]] = ("lidar", "position", "velocity", "heading")
    CLASSIC_OBSERVE: ClassVar[tuple[str, ...]] = ("lidar", "position", "speed", "heading")
    RANGE: ClassVar[float] = 350.0  # [px] of the LIDAR
    CLASSIC: ClassVar[ClassicReward]
    CLASSIC_ENDS: ClassVar[ClassicEnds]
    CLASSIC_SPEED: ClassVar[float]  # [px/s] that is observed as +1
    TURNS: ClassVar[bool] = True  # whether the kart, and its LIDAR with it, has a heading

    def __init__(
        self,
        *,
        preset: Literal["default", "classic"] = "default",
        track: str | Path | Track = "big_S",
        observe: Sequence[str] | None = None,
        lidar: LidarOptions | Mapping[str, Any] | None = None,
        reward: Literal["default", "classic"] | Mapping[str, float] | None = None,
        max_steps: int = 2000,
        start: Literal["random", "fixed"] = "random",
        render_mode: str | None = None,
    ) -> None:
        _one_of("preset", preset, ("default", "classic"))
        _one_of("start", start, ("random", "fixed"))
        _one_of("render_mode", render_mode, (None, "rgb_array"))
        if not isinstance(max_steps, int) or max_steps < 1:
            raise EnvError(f"max_steps must be a whole number from 1, found {max_steps!r}")
        classic = preset == "classic"
        self.max_steps, self.render_mode = max_steps, render_mode
        self._classic, self._start_fixed = classic, start == "fixed"
        self.lidar = Lidar(self._lidar_options(lidar))
        self._reward = self._reward_of(preset if reward is None else reward)
        self._cells = cells_in(track) if isinstance(track, str) else None
        self._course = self._load(track)
        self._build(self._course)
        preset_names = self.CLASSIC_OBSERVE if classic else self.OBSERVE
        names = preset_names if observe is None else observe
        self._observer = Observer(self, names, classic)
        self.OBSERVATION = self._observer.columns
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (self._observer.size,), np.float64)
        self.action_space: gymnasium.Space[Any] = gymnasium.spaces.Discrete(len(self.ACTIONS))
        self._begin()

    @property
    def pose(self) -> tuple[float, float, float]:
        """Place [px] and heading [rad]."""
        return self._at.x, self._at.y, self._at.heading

    @property
    def velocity(self) -> tuple[float, float]:
        """Velocity [px/s]."""
        return self._at.velocity

    @property
    def speed(self) -> float:
        """Speed [px/s]."""
        return math.hypot(*self._at.velocity)

    @property
    def turn(self) -> float:
        """Turn rate [rad/s]."""
        return self._at.turn

    @property
    def next_gate(self) -> int:
        """Index of the gate that comes next; the number of gates when all are passed."""
        return self._next

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Put the kart at the start of the track, which may be another one each time."""
        super().reset(seed=seed)
        if self._cells is not None:
            self._build(corridor(self._cells, self.np_random))
        elif self._course.sway:
            self._build(self._course.swayed(self.np_random))
        self._begin()
        self._place_at_start()
        self._at = self._situation()
        self._remaining = self._best = self._path_left(self._at)
        self._look()
        return self._observation(), self._info({}, finish=False, crash=False, stalled=False)

    def step(self, action: Any) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Drive for 1/60 s."""
        before = self._at
        self._steps += 1
        self._touched_wall = False
        self._act(action)
        self._space.step(CONTROL_DT)
        self._move()
        passed = self._pass_gates()
        finish = self._next == len(self.track.gates)
        crash = self._touched_wall and not finish
        now = self._at = self._situation()
        self._distance += math.hypot(now.x - before.x, now.y - before.y)
        deed = self._deed(before, now, passed, finish, crash)
        terms = self._reward.terms(deed)
        stalled = deed.failed and not crash
        self._look()
        info = self._info(terms, finish=finish, crash=crash, stalled=stalled)
        over = self._steps >= self.max_steps
        ended = finish or deed.failed
        return self._observation(), sum(terms.values()), ended, over and not ended, info

    def render(self) -> Any:  # noqa: ANN401
        """A picture (H, W, 3) uint8 of the track and the kart."""
        if self.render_mode is None:
            raise EnvError('render needs an environment made with render_mode="rgb_array"')
        from envs.kart_picture import picture

        return picture(self)

    def observe_at(
        self,
        x: float,
        y: float,
        heading: float,
        velocity: Sequence[float],
        turn: float,
        next_gate: int,
    ) -> FloatArray:
        """What would be observed there (obs,); the episode does not notice.

        x, y, heading  [px], [rad]
        velocity       (2,) [px/s]
        turn           [rad/s]
        """
        at = Situation(x, y, heading, (velocity[0], velocity[1]), turn, next_gate)
        return self._observer(self, at, self.lidar.look(x, y, heading))

    def progress_at(self, at: Situation) -> float:
        """Share of the path from the start that lies behind, in [0, 1]."""
        return min(1.0, max(0.0, 1.0 - self._path_left(at) / self.track.length))

    @abstractmethod
    def observed_velocity(self, at: Situation) -> tuple[float, float]:
        """The two numbers that say how the kart moves, about +-1."""

    @abstractmethod
    def _act(self, action: Any) -> None:  # noqa: ANN401
        """Do what an action does before the physics move the kart."""

    @abstractmethod
    def _move(self) -> None:
        """Do what happens to the kart after the physics moved it."""

    @abstractmethod
    def _steering(self) -> int:
        """Whether the kart was steered: 1 clockwise, -1 the other way, 0 not."""

    def _one_of_actions(self, action: Any) -> str:  # noqa: ANN401
        """The name of an action, or the reason why there is none."""
        index = np.asarray(action)
        if index.shape or index.dtype.kind not in "iu" or not 0 <= index < len(self.ACTIONS):
            raise EnvError(
                f"action {action!r} is none of the {len(self.ACTIONS)} of this kart: 0 to "
                f"{len(self.ACTIONS) - 1}, {', '.join(self.ACTIONS)}"
            )
        return self.ACTIONS[int(index)]

    def _lidar_options(self, given: LidarOptions | Mapping[str, Any] | None) -> LidarOptions:
        """The options that were given, over those of the preset."""
        if isinstance(given, LidarOptions):
            return given
        defaults: dict[str, Any] = {"range": self.RANGE}
        if self._classic:
            # the seed's rays begin straight behind the kart, and none points ahead
            defaults |= {"count": CLASSIC_RAYS, "facing": -math.pi}
        return LidarOptions.of(given or {}, **defaults)

    def _reward_of(self, reward: str | Mapping[str, float]) -> Reward:
        if isinstance(reward, Mapping):
            return PathReward(reward)
        _one_of("reward", reward, ("default", "classic"))
        return self.CLASSIC if reward == "classic" else PathReward()

    def _load(self, track: str | Path | Track) -> Track:
        if isinstance(track, Track):
            return track
        if self._cells is not None:
            return corridor(self._cells, np.random.default_rng(0))
        return tracks.load(track)

    def _build(self, track: Track) -> None:
        """Put walls and gates into a new space, and the kart into it."""
        self.track = track
        self.lidar.show(track.walls)
        self._kart = pymunk.Body(MASS, pymunk.moment_for_circle(MASS, 0.0, RADIUS))
        self._space = pymunk.Space()
        self._space.on_collision(KART, WALL, begin=self._touch_wall)
        self._space.on_collision(KART, GATE, begin=self._enter_gate, separate=self._leave_gate)
        for a, b in track.walls:
            self._add_line(a, b, WALL)
        self._gates = {
            self._add_line(a, b, GATE): number for number, (a, b) in enumerate(track.gates)
        }
        self._shape = pymunk.Circle(self._kart, RADIUS)
        self._shape.collision_type = KART
        self._space.add(self._kart, self._shape)

    def _add_line(self, a: FloatArray, b: FloatArray, kind: int) -> pymunk.Segment:
        """Add a line that is felt but stops nobody."""
        line = pymunk.Segment(self._space.static_body, tuple(a), tuple(b), 0.0)
        line.sensor, line.collision_type = True, kind
        self._space.add(line)
        return line

    def _touch_wall(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:  # noqa: ANN401
        self._touched_wall = True

    def _enter_gate(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:  # noqa: ANN401
        self._touching |= {self._gates[s] for s in arbiter.shapes if s in self._gates}

    def _leave_gate(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:  # noqa: ANN401
        self._touching -= {self._gates[s] for s in arbiter.shapes if s in self._gates}

    def _begin(self) -> None:
        """Forget the last episode."""
        # out and in again: the space would go on believing in touches of the last episode
        self._space.remove(self._kart, self._shape)
        self._space.add(self._kart, self._shape)
        self._kart.velocity, self._kart.angular_velocity, self._kart.angle = (0.0, 0.0), 0.0, 0.0
        self._touching: set[int] = set()
        self._touched_wall = False
        self._steps: int = 0
        self._since_gate = self._stalled_for = self._still_for = self._deserting_for = 0
        self._turn: float = 0.0
        self._distance: float = 0.0
        self._next: int = 0
        self._remaining = self._best = math.inf
        self._at = self._situation()

    def _place_at_start(self) -> None:
        low, high = self.track.heading
        x, y = self.track.start
        heading = (low + high) / 2.0
        if not self._start_fixed:
            dx, dy = self.np_random.uniform(-self.track.spread, self.track.spread, 2)
            x, y, heading = x + dx, y + dy, self.np_random.uniform(low, high)
        self._kart.position = float(x), float(y)
        self._kart.angle = float(heading) if self.TURNS else 0.0
        self._space.reindex_shapes_for_body(self._kart)

    def _situation(self) -> Situation:
        x, y = self._kart.position
        vx, vy = self._kart.velocity
        return Situation(x, y, self._kart.angle, (vx, vy), self._turn, self._next)

    def _path_left(self, at: Situation) -> float:
        """Length of the path through the middles of the gates that are left [px]."""
        return self.track.remaining(at.x, at.y, at.next_gate)

    def _pass_gates(self) -> int:
        """Count the gates that were passed: those touched by the rim, in their order."""
        first = self._next
        while self._next in self._touching:
            self._next += 1
        return self._next - first

    def _deed(
        self, before: Situation, now: Situation, passed: int, finish: bool, crash: bool
    ) -> Deed:
        """What was done in the step between two situations."""
        remaining = self._path_left(now)
        x, y = self.track.midpoints[min(before.next_gate, len(self.track.gates) - 1)]
        approach = math.hypot(before.x - x, before.y - y) - math.hypot(now.x - x, now.y - y)
        gained, self._remaining = self._remaining - remaining, remaining
        since = self._since_gate
        self._since_gate = 0 if passed else since + 1
        failed = crash or (not finish and self._gives_up(remaining, approach))
        towards = math.atan2(y - before.y, x - before.x) - before.heading
        steering = self._steering() if math.sin(towards) > 0 else -self._steering()
        return Deed(gained, approach, passed, since, finish, failed, self.speed, steering)

    def _gives_up(self, remaining: float, approach: float) -> bool:
        """Whether the kart does not get on any more."""
        if self._classic:
            ends = self.CLASSIC_ENDS
            self._still_for = self._still_for + 1 if self.speed < 25.0 else 0
            self._deserting_for = self._deserting_for + 1 if approach < 0 else 0
            still = 0 < ends.still <= self._still_for
            return still or 0 < ends.deserting <= self._deserting_for
        if remaining < self._best - GETTING_ON:
            self._best, self._stalled_for = remaining, 0
        else:
            self._stalled_for += 1
        return self._stalled_for >= STALL

    def _look(self) -> None:
        """Measure with the LIDAR; `scan` (R,) [px] holds what it says."""
        self.scan = self.lidar.measure(*self.pose, self.np_random)

    def _observation(self) -> FloatArray:
        return self._observer(self, self._at, self.scan)

    def _info(
        self, terms: dict[str, float], *, finish: bool, crash: bool, stalled: bool
    ) -> dict[str, Any]:
        x, y, heading = self.pose
        return {
            "success": finish,
            "finish": finish,
            "crash": crash,
            "stalled": stalled,
            "gates": self._next,
            "lap_time": self._steps * CONTROL_DT,
            "x": x,
            "y": y,
            "heading": heading,
            "speed": self.speed,
            "progress": self.progress_at(self._at),
            "distance": self._distance,
            "reward_terms": terms,
        }


def _one_of(name: str, found: object, allowed: Sequence[object]) -> None:
    if found not in allowed:
        raise EnvError(f"{name} {found!r} is unknown; known: {', '.join(map(repr, allowed))}")
