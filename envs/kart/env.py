"""KartEnv: what all karts share, from the episode to observation and reward.

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
from spikedeploy.envs.kart.corridor import corridor, length_of
from spikedeploy.envs.kart.lidar import Lidar, LidarOptions
from spikedeploy.envs.kart.observation import Observer
from spikedeploy.envs.kart.options import lidar_options, one_of, part, reward_of, steps_of, track_of
from spikedeploy.envs.kart.reward import ClassicReward, StepOutcome
from spikedeploy.envs.kart.stall import ClassicLimits, ClassicStallRule, StallRule
from spikedeploy.envs.kart.track import Track
from spikedeploy.envs.kart.world import KartState, KartWorld

FloatArray = NDArray[np.float64]

CONTROL_DT = 1.0 / 60.0  # [s]


class KartEnv(gymnasium.Env[FloatArray, Any]):
    """A kart that has to pass a track's gates in order without touching a wall.

    preset      "default", or "classic": kart-simulator's observation, reward and termination
    track       a name of track_file.names(), `corridor`, `corridor-N`, a .json file, or a Track
    observe     components, keys of observation.SIZES or "lidar"; None takes the preset's
    lidar       LidarOptions, or some of them by name, which replace the environment's defaults
    reward      "default", "classic", or weights by name that replace some of the default's
    max_steps   control steps after which an episode is truncated
    start       "random" within the track's spread and headings, or "fixed" at their centre
    grip        [1] share of a change of velocity that the tyres pass on in a control step
    power       [1] factor on what the motor does: push, speed or acceleration
    render_mode "rgb_array" or None

    An episode ends at the last gate (terminated, a success), at a wall (terminated), when the
    remaining path has not become 20 px shorter within 2 s (terminated: standing still and driving
    in circles are failures of the policy, not a time limit), or after max_steps (truncated).
    """

    _state: KartState
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 60}  # noqa: RUF012
    CONTROL_DT: ClassVar[float] = CONTROL_DT
    ACTIONS: ClassVar[tuple[str, ...]]
    OBSERVE: ClassVar[tuple[str, ...]] = ("lidar", "position", "velocity", "heading")
    CLASSIC_OBSERVE: ClassVar[tuple[str, ...]] = ("lidar", "position", "speed", "heading")
    RANGE: ClassVar[float] = 350.0  # [px] of the LIDAR
    CLASSIC: ClassVar[ClassicReward]
    CLASSIC_LIMITS: ClassVar[ClassicLimits]
    CLASSIC_SPEED: ClassVar[float]  # [px/s] observed as +1
    TURNS: ClassVar[bool] = True  # whether kart and LIDAR have a heading

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
        grip: float = 1.0,
        power: float = 1.0,
        render_mode: str | None = None,
    ) -> None:
        one_of("preset", preset, ("default", "classic"))
        one_of("start", start, ("random", "fixed"))
        one_of("render_mode", render_mode, (None, "rgb_array"))
        steps_of(max_steps)
        self._grip, self._power = part("grip", grip), part("power", power)
        classic = preset == "classic"
        self.max_steps, self.render_mode = max_steps, render_mode
        self._classic, self._start_fixed = classic, start == "fixed"
        self.lidar = Lidar(lidar_options(lidar, self.RANGE, classic))
        self._reward = reward_of(preset if reward is None else reward, self.CLASSIC)
        self._corridor = length_of(track) if isinstance(track, str) else None
        self._base_track = track_of(track)
        self._build(self._base_track)
        default = self.CLASSIC_OBSERVE if classic else self.OBSERVE
        self._observer = Observer(self, default if observe is None else observe, classic)
        self.OBSERVATION = self._observer.columns
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (self._observer.size,), np.float64)
        self.action_space: gymnasium.Space[Any] = gymnasium.spaces.Discrete(len(self.ACTIONS))
        self._begin()
        self._reset_state()

    @property
    def pose(self) -> tuple[float, float, float]:
        """Position [px] and heading [rad]."""
        return self._state.x, self._state.y, self._state.heading

    @property
    def velocity(self) -> tuple[float, float]:
        """Velocity [px/s]."""
        return self._state.velocity

    @property
    def speed(self) -> float:
        """Speed [px/s]."""
        return math.hypot(*self._state.velocity)

    @property
    def turn(self) -> float:
        """Turn rate [rad/s]."""
        return self._state.turn

    @property
    def next_gate(self) -> int:
        """Index of the next gate; the number of gates when all are passed."""
        return self._next

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Put the kart at the start; a corridor is drawn anew, a swaying finish is moved."""
        super().reset(seed=seed)
        if self._corridor is not None:
            self._build(corridor(self._corridor, self.np_random))
        elif self._base_track.sway:
            self._build(self._base_track.swayed(self.np_random))
        self._begin()
        self._place_at_start()
        self._reset_state()
        self._measure()
        return self._observation(), self._info({}, finish=False, crash=False, stalled=False)

    def step(self, action: Any) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Advance by one control step of 1/60 s."""
        before = self._state
        self._steps += 1
        self._act(action)
        self._world.step(CONTROL_DT)
        self._move()
        passed = self._pass_gates()
        finish = self._next == len(self.track.gates)
        crash = self._world.touched_wall and not finish
        now = self._state = self._read_state()
        self._distance += math.hypot(now.x - before.x, now.y - before.y)
        outcome = self._outcome(before, now, passed, finish, crash)
        terms = self._reward.terms(outcome)
        stalled = outcome.failed and not crash
        self._measure()
        info = self._info(terms, finish=finish, crash=crash, stalled=stalled)
        over = self._steps >= self.max_steps
        ended = finish or outcome.failed
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
        """The observation (obs,) of a state, without noise; the episode is not affected.

        x, y, heading  [px], [rad]
        velocity       (2,) [px/s]
        turn           [rad/s]
        """
        state = KartState(x, y, heading, (velocity[0], velocity[1]), turn, next_gate)
        return self._observer(self, state, self.lidar.distances(x, y, heading))

    def progress_at(self, state: KartState) -> float:
        """Completed share of the path from the start, in [0, 1]."""
        return min(1.0, max(0.0, 1.0 - self._remaining_path(state) / self.track.length))

    @abstractmethod
    def observed_velocity(self, state: KartState) -> tuple[float, float]:
        """The two numbers of the velocity component, about +-1."""

    @abstractmethod
    def _act(self, action: Any) -> None:  # noqa: ANN401
        """Apply an action before the physics step."""

    @abstractmethod
    def _move(self) -> None:
        """Update the velocities after the physics step."""

    @abstractmethod
    def _steering(self) -> int:
        """Direction of steering: 1 clockwise, -1 counterclockwise, 0 none."""

    def _build(self, track: Track) -> None:
        """Build the physics of a track, and give its walls to the LIDAR."""
        self.track = track
        self.lidar.set_walls(track.walls)
        self._world = KartWorld(track, self._grip)
        self._kart = self._world.kart

    def _begin(self) -> None:
        """Clear the variables of the last episode."""
        self._world.clear()
        self._steps: int = 0
        self._since_gate: int = 0
        self._turn: float = 0.0
        self._distance: float = 0.0
        self._next: int = 0

    def _reset_state(self) -> None:
        """Read the initial state, and start progress and stall detection from it."""
        self._state = self._read_state()
        self._remaining = self._remaining_path(self._state)
        rule = ClassicStallRule(self.CLASSIC_LIMITS) if self._classic else None
        self._stall = rule or StallRule(self._remaining)

    def _place_at_start(self) -> None:
        low, high = self.track.heading
        x, y = self.track.start
        heading = (low + high) / 2.0
        if not self._start_fixed:
            dx, dy = self.np_random.uniform(-self.track.spread, self.track.spread, 2)
            x, y, heading = x + dx, y + dy, self.np_random.uniform(low, high)
        self._world.place(float(x), float(y), float(heading) if self.TURNS else 0.0)

    def _read_state(self) -> KartState:
        x, y = self._kart.position
        vx, vy = self._kart.velocity
        return KartState(x, y, self._kart.angle, (vx, vy), self._turn, self._next)

    def _remaining_path(self, state: KartState) -> float:
        """Length of the path through the midpoints of the remaining gates [px]."""
        return self.track.remaining(state.x, state.y, state.next_gate)

    def _pass_gates(self) -> int:
        """Pass the gates that the kart touches, in order; return their number."""
        first = self._next
        while self._next in self._world.touching:
            self._next += 1
        return self._next - first

    def _outcome(
        self, before: KartState, now: KartState, passed: int, finish: bool, crash: bool
    ) -> StepOutcome:
        """What happened in the step between two states."""
        remaining = self._remaining_path(now)
        x, y = self.track.midpoints[min(before.next_gate, len(self.track.gates) - 1)]
        approach = math.hypot(before.x - x, before.y - y) - math.hypot(now.x - x, now.y - y)
        gained, self._remaining = self._remaining - remaining, remaining
        since = self._since_gate
        self._since_gate = 0 if passed else since + 1
        failed = crash or (not finish and self._stall.stalled(remaining, approach, self.speed))
        towards = math.atan2(y - before.y, x - before.x) - before.heading
        steering = self._steering() if math.sin(towards) > 0 else -self._steering()
        return StepOutcome(gained, approach, passed, since, finish, failed, self.speed, steering)

    def _measure(self) -> None:
        """Measure with the LIDAR; `scan` (R,) holds the distances [px]."""
        self.scan = self.lidar.measure(*self.pose, self.np_random)

    def _observation(self) -> FloatArray:
        return self._observer(self, self._state, self.scan)

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
            "progress": self.progress_at(self._state),
            "distance": self._distance,
            "reward_terms": terms,
        }
