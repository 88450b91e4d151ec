"""KartEnv: what all karts share, from the episode to observation, reward and stalling.

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
from numpy.typing import NDArray

from spikedeploy.envs.kart.lidar import Lidar, LidarOptions
from spikedeploy.envs.kart.track import Track, corridor, length_of, load
from spikedeploy.envs.kart.world import KartState, KartWorld
from spikedeploy.runtime.errors import EnvError

_STALL = 120  # [steps] without progress after which a kart has stalled
_PROGRESS = 20.0  # [px] by which the remaining path must become shorter to count
_SLOW = 25.0  # [px/s] below which kart-simulator counts a kart as standing still


@dataclass(frozen=True)
class ClassicLimits:
    """Limits of kart-simulator's two stall rules.

    still: consecutive steps below 25 px/s, 0 for no limit
    receding: consecutive steps away from the next gate, 0 for no limit
    """

    still: int
    receding: int


class _StallRule:
    """Detect a stalled kart.

    Its remaining path [px] has not become 20 px shorter within 2 s; by kart-simulator's limits it
    stood still or moved away from the gate for too long.
    """

    def __init__(self, remaining: float, limits: ClassicLimits | None) -> None:
        self._best, self._limits = remaining, limits
        self._steps = self._still = self._receding = 0

    def stalled(self, remaining: float, approach: float, speed: float) -> bool:
        """Add a step: remaining path [px], decrease of the gate's distance [px], speed [px/s]."""
        if self._limits is None:
            self._steps += 1
            if remaining < self._best - _PROGRESS:
                self._best, self._steps = remaining, 0
            return self._steps >= _STALL
        self._still = self._still + 1 if speed < _SLOW else 0
        self._receding = self._receding + 1 if approach < 0 else 0
        still = 0 < self._limits.still <= self._still
        return still or 0 < self._limits.receding <= self._receding


# Weights of the default reward. A lap of big_S is 2,400 px, so that progress earns 24, finishing
# 10 more, and a crash costs 5.
_WEIGHTS: Mapping[str, float] = {
    "progress": 1.0,  # per 100 px that the remaining path became shorter
    "gate": 0.0,  # per gate
    "finish": 10.0,  # once
    "crash": -5.0,  # once, at a wall or for stalling
    "time": -0.01,  # per step
}


class StepOutcome(NamedTuple):
    """Outcome of one step, for rewards.

    gained: decrease of the remaining path [px]
    approach: decrease of the distance to the midpoint of the next gate [px]
    gates: number of gates passed
    since: steps since the last gate
    finish: whether the last gate was passed
    failed: whether the kart crashed or stalled
    speed: [px/s]
    steering: 1 towards the next gate, -1 away from it, 0 none
    """

    gained: float
    approach: float
    gates: int
    since: int
    finish: bool
    failed: bool
    speed: float
    steering: int


class PathReward:
    """The default reward, whose progress term is potential-based shaping (Ng et al. 1999).

    The potential is the length of the path through the midpoints of the remaining gates: what
    driving on gains, driving back loses.

    weights: of each term in WEIGHTS
    """

    def __init__(self, changes: Mapping[str, float] | None = None) -> None:
        changes = changes or {}
        unknown = sorted(changes.keys() - _WEIGHTS.keys())
        if unknown:
            raise EnvError(f"reward: unknown term {unknown[0]!r}; known: {', '.join(_WEIGHTS)}")
        for name, weight in changes.items():
            if not isinstance(weight, (int, float)) or not math.isfinite(weight):
                raise EnvError(f"reward: the weight of {name} is {weight!r}, not a finite number")
        self.weights = {**_WEIGHTS, **changes}

    def terms(self, outcome: StepOutcome) -> dict[str, float]:
        """Weighted terms of a step."""
        weights = self.weights
        return {
            "progress": weights["progress"] * outcome.gained / 100.0,
            "gate": weights["gate"] * outcome.gates,
            "finish": weights["finish"] * outcome.finish,
            "crash": weights["crash"] * outcome.failed,
            "time": weights["time"],
        }


@dataclass(frozen=True)
class ClassicReward:
    """kart-simulator's terms and weights, each paid once and not as a running total every step.

    pace: divisor of exp(v / 100) in the progress term
    backward: factor of negative progress
    progress, steer, gate, crash: weights
    finish: weight, the same in all environments
    """

    pace: float
    backward: float
    progress: float
    steer: float
    gate: float
    crash: float
    finish: float = 500_000.0

    def terms(self, outcome: StepOutcome) -> dict[str, float]:
        """Weighted terms of a step."""
        # p = (d0 - d1) exp(v / 100) / pace
        p = outcome.approach * math.exp(outcome.speed / 100.0) / self.pace
        p *= self.backward if p < 0 else 1.0
        return {
            "progress": self.progress * p / 80.0,
            # +1 towards the gate, -2 away from it
            "steer": 0.1 * self.steer * (outcome.steering if outcome.steering >= 0 else -2),
            # exp(7 - n / 100) / 3, n steps since the last gate
            "gate": self.gate * outcome.gates * math.exp(7.0 - outcome.since / 100.0) / 3.0,
            "finish": self.finish * outcome.finish,
            "crash": self.crash * outcome.failed,
        }


def check_choice(name: str, found: object, *allowed: object) -> None:
    """Raise EnvError unless the value of an option is one of those allowed."""
    if found not in allowed:
        raise EnvError(f"{name} {found!r} is unknown; known: {', '.join(map(repr, allowed))}")


def _part(name: str, found: object) -> float:
    number = isinstance(found, (int, float)) and not isinstance(found, bool)
    if not number or not 0.0 < found <= 1.0:  # type: ignore[operator]
        raise EnvError(f"option {name}: {found!r} is not a number above 0 and up to 1")
    return float(found)  # type: ignore[arg-type]


def action_name(action: Any, names: Sequence[str]) -> str:  # noqa: ANN401
    """Name of a discrete action; EnvError if there is no such action."""
    index = np.asarray(action)
    whole = not index.shape and index.dtype.kind in "iu"
    if not whole or not 0 <= (place := int(index)) < len(names):
        raise EnvError(
            f"action {action!r} is none of the {len(names)} of this kart: 0 to {len(names) - 1}, "
            f"{', '.join(names)}"
        )
    return names[place]


_SIZES = {  # of every component of an observation except the LIDAR's
    "position": 2,
    "velocity": 2,
    "heading": 2,
    "gate": 3,
    "progress": 1,
    "speed": 1,
}
_CLASSIC_BOX = 54.0, 81.0, 990.0, 958.0  # left, top, right, bottom [px] on every track
_CLASSIC_RAYS = 59  # 60 were asked for

FloatArray = NDArray[np.float64]

CONTROL_DT = 1.0 / 60.0  # [s]


class KartEnv(gymnasium.Env[FloatArray, Any]):
    """A kart that has to pass a track's gates in order without touching a wall.

    preset: "default", or "classic": kart-simulator's observation, reward and termination
    track: a name of track_file.names(), `corridor`, `corridor-N`, a .json file, or a Track
    observe: components, keys of _SIZES or "lidar"; None takes the preset's
    lidar: LidarOptions, or some of them by name, which replace the environment's defaults
    reward: "default", "classic", or weights by name that replace some of the default's
    max_steps: control steps after which an episode is truncated
    start: "random" within the track's spread and headings, or "fixed" at their centre
    grip: [1] share of a change of velocity that the tyres pass on in a control step
    power: [1] factor on what the motor does: push, speed or acceleration
    render_mode: "rgb_array" or None

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
        check_choice("preset", preset, "default", "classic")
        check_choice("start", start, "random", "fixed")
        check_choice("render_mode", render_mode, None, "rgb_array")
        if not isinstance(max_steps, int) or max_steps < 1:
            raise EnvError(f"max_steps must be a whole number from 1, found {max_steps!r}")
        self._grip, self._power = _part("grip", grip), _part("power", power)
        classic = self._classic = preset == "classic"
        self.max_steps, self.render_mode = max_steps, render_mode
        self._start_fixed = start == "fixed"
        if not isinstance(lidar, LidarOptions):
            # kart-simulator's rays begin straight behind the kart, and none points ahead
            rays = {"count": _CLASSIC_RAYS, "facing": -math.pi} if classic else {}
            lidar = LidarOptions.with_changes(lidar or {}, range=self.RANGE, **rays)
        self.lidar = Lidar(lidar)
        self._reward = self._reward_of(preset if reward is None else reward)
        self._corridor = length_of(track) if isinstance(track, str) else None
        if self._corridor is not None:  # any one: each episode has its own
            track = corridor(self._corridor, np.random.default_rng(0))
        self._base_track = track if isinstance(track, Track) else load(track)
        self._build(self._base_track)
        default = self.CLASSIC_OBSERVE if classic else self.OBSERVE
        self.OBSERVATION = self._columns(default if observe is None else observe)
        self._observed = max(place.stop for place in self.OBSERVATION.values())
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (self._observed,), np.float64)
        self.action_space: gymnasium.Space[Any] = gymnasium.spaces.Discrete(len(self.ACTIONS))
        self._begin()
        self._reset_state()

    def _reward_of(self, reward: str | Mapping[str, float]) -> PathReward | ClassicReward:
        if isinstance(reward, Mapping):
            return PathReward(reward)
        check_choice("reward", reward, "default", "classic")
        return self.CLASSIC if reward == "classic" else PathReward()

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
        observation = self._observation()
        info = self._info(terms, finish=finish, crash=crash, stalled=stalled)
        ended = finish or outcome.failed
        over = self._steps >= self.max_steps and not ended
        return observation, sum(terms.values()), ended, over, info

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

        x, y, heading: [px], [rad]
        velocity: (2,) [px/s]
        turn: [rad/s]
        """
        state = KartState(x, y, heading, (velocity[0], velocity[1]), turn, next_gate)
        return self._observe(state, self.lidar.distances(x, y, heading))

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
        self.track = track
        self.lidar.set_walls(track.walls)
        self._world = KartWorld(track, self._grip)
        self._kart = self._world.kart

    def _begin(self) -> None:
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
        limits = self.CLASSIC_LIMITS if self._classic else None
        self._stall = _StallRule(self._remaining, limits)

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
        return self.track.remaining(state.x, state.y, state.next_gate)

    def _pass_gates(self) -> int:
        first = self._next
        while self._next in self._world.touching:
            self._next += 1
        return self._next - first

    def _outcome(
        self, before: KartState, now: KartState, passed: int, finish: bool, crash: bool
    ) -> StepOutcome:
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

    def _columns(self, names: Sequence[str]) -> dict[str, slice]:
        known = ["lidar", *_SIZES]
        for name in names:
            if name not in known:
                raise EnvError(f"observe: unknown component {name!r}; known: {', '.join(known)}")
        if len(set(names)) != len(names) or not names:
            raise EnvError(f"observe: {', '.join(names) or 'nothing'}: name each component once")
        columns, end = {}, 0
        for name in names:
            size = len(self.lidar.angles) if name == "lidar" else _SIZES[name]
            columns[name] = slice(end, end := end + size)
        return columns

    def _observation(self) -> FloatArray:
        """Measure with the LIDAR, whose distances (R,) [px] `scan` holds, and observe."""
        self.scan = self.lidar.measure(*self.pose, self.np_random)
        return self._observe(self._state, self.scan)

    def _observe(self, state: KartState, scan: FloatArray) -> FloatArray:
        """The observation (obs,) of a state in which the LIDAR measured `scan` (R,) [px]."""
        values = np.empty(self._observed)
        for name, place in self.OBSERVATION.items():
            values[place] = self._component(name, state, scan)
        # np.maximum and np.minimum take a third of the time of np.clip
        np.maximum(values, -1.0, out=values)
        np.minimum(values, 1.0, out=values)
        return values

    def _component(
        self, name: str, state: KartState, scan: FloatArray
    ) -> Sequence[float] | FloatArray:
        if name == "lidar":
            return self._seen_walls(scan)
        if name == "heading":
            return math.cos(state.heading), math.sin(state.heading)
        if name == "velocity":
            return self.observed_velocity(state)
        if name == "speed":
            return (2.0 * math.hypot(*state.velocity) / self.CLASSIC_SPEED - 1.0,)
        if name == "position":
            left, top, right, bottom = _CLASSIC_BOX if self._classic else self.track.box
            across, down = (state.x - left) / (right - left), (state.y - top) / (bottom - top)
            return 2.0 * across - 1.0, 2.0 * down - 1.0
        if name == "progress":
            return (2.0 * self.progress_at(state) - 1.0,)
        # cosine and sine of the next gate's bearing from the heading, and its distance
        middles = self.track.midpoints
        x, y = middles[min(state.next_gate, len(middles) - 1)]
        bearing = math.atan2(y - state.y, x - state.x) - state.heading
        distance = math.hypot(x - state.x, y - state.y)
        return math.cos(bearing), math.sin(bearing), 1.0 - 2.0 * distance / self.lidar.range

    def _seen_walls(self, scan: FloatArray) -> FloatArray:
        """+1 for a wall at the kart's centre, -1 for none within range."""
        reach = self.lidar.range
        if not self._classic:
            return 1.0 - scan * (2.0 / reach)
        # rays without a hit, or with one in the last 2 px, count as range + range / 600, as in
        # kart-simulator, which adds the range in metres over 6 to a length in px
        most = reach + reach / 600.0
        return 1.0 - np.where(scan > reach - 2.0, most, scan) * (2.0 / most)

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
