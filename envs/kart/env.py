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

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.lidar import CLASSIC_RAYS, Lidar, LidarOptions, Observer
from spikedeploy.envs.kart.track import Track, corridor, length_of, load
from spikedeploy.envs.kart.world import KartState, KartWorld

_STALL = 120  # [steps] without progress after which a kart has stalled
_PROGRESS = 20.0  # [px] by which the remaining path must become shorter to count
_SLOW = 25.0  # [px/s] below which kart-simulator counts a kart as standing still


class StallRule:
    """Stalled when the remaining path has not become 20 px shorter within 2 s.

    remaining  length of the path at the start [px]
    """

    def __init__(self, remaining: float) -> None:
        self._best, self._steps = remaining, 0

    def stalled(self, remaining: float, approach: float, speed: float) -> bool:
        """Add a step: remaining path [px], decrease of the gate's distance [px], speed [px/s]."""
        if remaining < self._best - _PROGRESS:
            self._best, self._steps = remaining, 0
        else:
            self._steps += 1
        return self._steps >= _STALL


@dataclass(frozen=True)
class ClassicLimits:
    """Limits of kart-simulator's two stall rules.

    still     consecutive steps below 25 px/s, 0 for no limit
    receding  consecutive steps away from the next gate, 0 for no limit
    """

    still: int
    receding: int


class ClassicStallRule:
    """Stalled as in kart-simulator: standing still or moving away from the gate for too long."""

    def __init__(self, limits: ClassicLimits) -> None:
        self._limits = limits
        self._still = self._receding = 0

    def stalled(self, remaining: float, approach: float, speed: float) -> bool:
        """Add a step, as in StallRule."""
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

    gained    decrease of the remaining path [px]
    approach  decrease of the distance to the midpoint of the next gate [px]
    gates     number of gates passed
    since     steps since the last gate
    finish    whether the last gate was passed
    failed    whether the kart crashed or stalled
    speed     [px/s]
    steering  1 towards the next gate, -1 away from it, 0 none
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

    weights  of each term in WEIGHTS
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

    pace                         divisor of exp(v / 100) in the progress term
    backward                     factor of negative progress
    progress, steer, gate, crash weights
    finish                       weight, the same in all environments
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


Reward = PathReward | ClassicReward


def one_of(name: str, found: object, allowed: Sequence[object]) -> None:
    """Raise EnvError unless the value of an option is one of those allowed."""
    if found not in allowed:
        raise EnvError(f"{name} {found!r} is unknown; known: {', '.join(map(repr, allowed))}")


def steps_of(found: object) -> None:
    """Raise EnvError unless the value of max_steps is a whole number from 1."""
    if not isinstance(found, int) or found < 1:
        raise EnvError(f"max_steps must be a whole number from 1, found {found!r}")


def part(name: str, found: object) -> float:
    """The value of an option above 0 and up to 1; EnvError if it is another."""
    number = isinstance(found, (int, float)) and not isinstance(found, bool)
    if not number or not 0.0 < found <= 1.0:  # type: ignore[operator]
        raise EnvError(f"option {name}: {found!r} is not a number above 0 and up to 1")
    return float(found)  # type: ignore[arg-type]


def track_of(track: str | Path | Track) -> Track:
    """The track of this name, file or kind; of corridors, which are drawn anew, any one."""
    if isinstance(track, Track):
        return track
    cells = length_of(track) if isinstance(track, str) else None
    return load(track) if cells is None else corridor(cells, np.random.default_rng(0))


def lidar_options(
    given: LidarOptions | Mapping[str, Any] | None, reach: float, classic: bool
) -> LidarOptions:
    """The given options, over those of the preset and the environment's range `reach` [px]."""
    if isinstance(given, LidarOptions):
        return given
    defaults: dict[str, Any] = {"range": reach}
    if classic:
        # kart-simulator's rays begin straight behind the kart, and none points ahead
        defaults |= {"count": CLASSIC_RAYS, "facing": -math.pi}
    return LidarOptions.of(given or {}, **defaults)


def reward_of(reward: str | Mapping[str, float], classic: ClassicReward) -> Reward:
    """The reward of this name, or with these weights; `classic` is the environment's own."""
    if isinstance(reward, Mapping):
        return PathReward(reward)
    one_of("reward", reward, ("default", "classic"))
    return classic if reward == "classic" else PathReward()


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
        """Return the outcome of the step between two states."""
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
