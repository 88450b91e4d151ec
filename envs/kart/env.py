"""What the karts have in common: the world, the episode, the observation and the reward.

Lengths are in px, 100 px to a metre, y downwards; angles in rad, 0 to the right, clockwise. A step
of the environment is one step of the physics, 1/60 s.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart import track as tracks
from spikedeploy.envs.kart.corridor import cells_in, corridor
from spikedeploy.envs.kart.ends import ClassicEnds, ClassicStall, KartState, Stall
from spikedeploy.envs.kart.lidar import Lidar, LidarOptions
from spikedeploy.envs.kart.observation import Observer
from spikedeploy.envs.kart.options import lidar_options, one_of, reward_of
from spikedeploy.envs.kart.reward import ClassicReward, StepOutcome
from spikedeploy.envs.kart.track import Track
from spikedeploy.envs.kart.world import KartWorld

FloatArray = NDArray[np.float64]

CONTROL_DT = 1.0 / 60.0  # [s]


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

    _at: KartState
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
        one_of("preset", preset, ("default", "classic"))
        one_of("start", start, ("random", "fixed"))
        one_of("render_mode", render_mode, (None, "rgb_array"))
        if not isinstance(max_steps, int) or max_steps < 1:
            raise EnvError(f"max_steps must be a whole number from 1, found {max_steps!r}")
        classic = preset == "classic"
        self.max_steps, self.render_mode = max_steps, render_mode
        self._classic, self._start_fixed = classic, start == "fixed"
        self.lidar = Lidar(lidar_options(lidar, self.RANGE, classic))
        self._reward = reward_of(preset if reward is None else reward, self.CLASSIC)
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
        self._take_stock()

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
        self._take_stock()
        self._look()
        return self._observation(), self._info({}, finish=False, crash=False, stalled=False)

    def step(self, action: Any) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Drive for 1/60 s."""
        before = self._at
        self._steps += 1
        self._act(action)
        self._world.step(CONTROL_DT)
        self._move()
        passed = self._pass_gates()
        finish = self._next == len(self.track.gates)
        crash = self._world.touched_wall and not finish
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
        from spikedeploy.envs.kart.picture import picture

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
        at = KartState(x, y, heading, (velocity[0], velocity[1]), turn, next_gate)
        return self._observer(self, at, self.lidar.look(x, y, heading))

    def progress_at(self, at: KartState) -> float:
        """Share of the path from the start that lies behind, in [0, 1]."""
        return min(1.0, max(0.0, 1.0 - self._path_left(at) / self.track.length))

    @abstractmethod
    def observed_velocity(self, at: KartState) -> tuple[float, float]:
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

    def _load(self, track: str | Path | Track) -> Track:
        if isinstance(track, Track):
            return track
        if self._cells is not None:
            return corridor(self._cells, np.random.default_rng(0))
        return tracks.load(track)

    def _build(self, track: Track) -> None:
        """Make the world of a track, and show its walls to the LIDAR."""
        self.track = track
        self.lidar.show(track.walls)
        self._world = KartWorld(track)
        self._kart = self._world.kart

    def _begin(self) -> None:
        """Forget the last episode."""
        self._world.forget()
        self._steps: int = 0
        self._since_gate: int = 0
        self._turn: float = 0.0
        self._distance: float = 0.0
        self._next: int = 0

    def _take_stock(self) -> None:
        """Take note of where the episode begins, and of how far it is from there."""
        self._at = self._situation()
        self._remaining = self._path_left(self._at)
        self._ends = ClassicStall(self.CLASSIC_ENDS) if self._classic else Stall(self._remaining)

    def _place_at_start(self) -> None:
        low, high = self.track.heading
        x, y = self.track.start
        heading = (low + high) / 2.0
        if not self._start_fixed:
            dx, dy = self.np_random.uniform(-self.track.spread, self.track.spread, 2)
            x, y, heading = x + dx, y + dy, self.np_random.uniform(low, high)
        self._world.place(float(x), float(y), float(heading) if self.TURNS else 0.0)

    def _situation(self) -> KartState:
        x, y = self._kart.position
        vx, vy = self._kart.velocity
        return KartState(x, y, self._kart.angle, (vx, vy), self._turn, self._next)

    def _path_left(self, at: KartState) -> float:
        """Length of the path through the middles of the gates that are left [px]."""
        return self.track.remaining(at.x, at.y, at.next_gate)

    def _pass_gates(self) -> int:
        """Count the gates that were passed: those touched by the rim, in their order."""
        first = self._next
        while self._next in self._world.touching:
            self._next += 1
        return self._next - first

    def _deed(
        self, before: KartState, now: KartState, passed: int, finish: bool, crash: bool
    ) -> StepOutcome:
        """What was done in the step between two situations."""
        remaining = self._path_left(now)
        x, y = self.track.midpoints[min(before.next_gate, len(self.track.gates) - 1)]
        approach = math.hypot(before.x - x, before.y - y) - math.hypot(now.x - x, now.y - y)
        gained, self._remaining = self._remaining - remaining, remaining
        since = self._since_gate
        self._since_gate = 0 if passed else since + 1
        failed = crash or (not finish and self._ends.gives_up(remaining, approach, self.speed))
        towards = math.atan2(y - before.y, x - before.x) - before.heading
        steering = self._steering() if math.sin(towards) > 0 else -self._steering()
        return StepOutcome(gained, approach, passed, since, finish, failed, self.speed, steering)

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
