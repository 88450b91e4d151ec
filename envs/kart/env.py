"""KartEnv: what all karts share, from the episode to observation, reward and stalling.

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

from spikedeploy.envs.kart.lidar import Lidar, LidarOptions
from spikedeploy.envs.kart.track import Track, load
from spikedeploy.envs.kart.world import KartState, KartWorld
from spikedeploy.runtime.errors import EnvError

_STALL = 120  # [steps] without progress after which a kart has stalled
_PROGRESS = 20.0  # [px] by which the remaining path must become shorter to count


class _StallRule:
    """Detect a stalled kart, whose remaining path [px] has not become 20 px shorter within 2 s."""

    def __init__(self, remaining: float) -> None:
        self._best, self._steps = remaining, 0

    def stalled(self, remaining: float) -> bool:
        """Add a step with this remaining path [px]."""
        self._steps += 1
        if remaining < self._best - _PROGRESS:
            self._best, self._steps = remaining, 0
        return self._steps >= _STALL


# Weights of the reward. A lap of big_S is 2,400 px, so that progress earns 24, finishing
# 10 more, and a crash costs 5.
_WEIGHTS: Mapping[str, float] = {
    "progress": 1.0,  # per 100 px that the remaining path became shorter
    "gate": 0.0,  # per gate
    "finish": 10.0,  # once
    "crash": -5.0,  # once, at a wall or for stalling
    "time": -0.01,  # per step
}


class PathReward:
    """The reward, whose progress term is potential-based shaping (Ng et al. 1999).

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

    def terms(self, gained: float, gates: int, finish: bool, failed: bool) -> dict[str, float]:
        """Weighted terms of a step.

        gained: decrease of the remaining path [px]
        gates: number of gates passed
        finish: whether the last gate was passed
        failed: whether the kart crashed or stalled
        """
        weights = self.weights
        return {
            "progress": weights["progress"] * gained / 100.0,
            "gate": weights["gate"] * gates,
            "finish": weights["finish"] * finish,
            "crash": weights["crash"] * failed,
            "time": weights["time"],
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
}

FloatArray = NDArray[np.float64]

CONTROL_DT = 1.0 / 60.0  # [s]


class KartEnv(gymnasium.Env[FloatArray, Any]):
    """A kart that has to pass a track's gates in order without touching a wall.

    track: a name of track.names(), a .json file, or a Track
    observe: components, keys of _SIZES or "lidar"; None takes OBSERVE
    lidar: LidarOptions, or some of them by name, which replace the environment's defaults
    reward: weights by name that replace some of the default's
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
    _remaining: float
    _stall: _StallRule
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 60}  # noqa: RUF012
    CONTROL_DT: ClassVar[float] = CONTROL_DT
    ACTIONS: ClassVar[tuple[str, ...]]
    OBSERVE: ClassVar[tuple[str, ...]] = ("lidar", "position", "velocity", "heading")
    RANGE: ClassVar[float] = 350.0  # [px] of the LIDAR
    TURNS: ClassVar[bool] = True  # whether kart and LIDAR have a heading

    def __init__(
        self,
        *,
        track: str | Path | Track = "big_S",
        observe: Sequence[str] | None = None,
        lidar: LidarOptions | Mapping[str, Any] | None = None,
        reward: Mapping[str, float] | None = None,
        max_steps: int = 2000,
        start: Literal["random", "fixed"] = "random",
        grip: float = 1.0,
        power: float = 1.0,
        render_mode: str | None = None,
    ) -> None:
        check_choice("start", start, "random", "fixed")
        check_choice("render_mode", render_mode, None, "rgb_array")
        if not isinstance(max_steps, int) or max_steps < 1:
            raise EnvError(f"max_steps must be a whole number from 1, found {max_steps!r}")
        self._grip, self._power = _part("grip", grip), _part("power", power)
        self.max_steps, self.render_mode = max_steps, render_mode
        self._start_fixed = start == "fixed"
        if not isinstance(lidar, LidarOptions):
            lidar = LidarOptions.with_changes(lidar or {}, range=self.RANGE)
        self.lidar = Lidar(lidar)
        if not isinstance(reward, Mapping | None):
            raise EnvError(f"reward {reward!r}: give weights by name; known: {', '.join(_WEIGHTS)}")
        self._reward = PathReward(reward)
        self.track = track if isinstance(track, Track) else load(track)
        self.lidar.set_walls(self.track.walls)
        self._world = KartWorld(self.track, self._grip)
        self._kart = self._world.kart
        self.OBSERVATION = self._columns(self.OBSERVE if observe is None else observe)
        self._observed = max(place.stop for place in self.OBSERVATION.values())
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (self._observed,), np.float64)
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
        """Put the kart at the start."""
        super().reset(seed=seed)
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
        gained = self._remaining - (remaining := self._remaining_path(now))
        self._remaining = remaining
        stalled = not (crash or finish) and self._stall.stalled(remaining)
        terms = self._reward.terms(gained, passed, finish, crash or stalled)
        observation = self._observation()
        info = self._info(terms, finish=finish, crash=crash, stalled=stalled)
        ended = finish or crash or stalled
        over = self._steps >= self.max_steps and not ended
        return observation, sum(terms.values()), ended, over, info

    def render(self) -> Any:  # noqa: ANN401
        """A picture (H, W, 3) uint8 of the track and the kart."""
        if self.render_mode is None:
            raise EnvError('render needs an environment made with render_mode="rgb_array"')
        from spikedeploy.envs.kart.picture import picture

        return picture(self)

    @abstractmethod
    def observed_velocity(self, state: KartState) -> tuple[float, float]:
        """The two numbers of the velocity component, about +-1."""

    @abstractmethod
    def _act(self, action: Any) -> None:  # noqa: ANN401
        """Apply an action before the physics step."""

    @abstractmethod
    def _move(self) -> None:
        """Update the velocities after the physics step."""

    def _begin(self) -> None:
        self._world.clear()
        self._steps: int = 0
        self._turn: float = 0.0
        self._distance: float = 0.0
        self._next: int = 0

    def _reset_state(self) -> None:
        """Read the initial state, and start progress and stall detection from it."""
        self._state = self._read_state()
        self._remaining = self._remaining_path(self._state)
        self._stall = _StallRule(self._remaining)

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

    def _progress(self, state: KartState) -> float:
        """Completed share of the path from the start, in [0, 1]."""
        return min(1.0, max(0.0, 1.0 - self._remaining_path(state) / self.track.length))

    def _pass_gates(self) -> int:
        first = self._next
        while self._next in self._world.touching:
            self._next += 1
        return self._next - first

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
            # +1 for a wall at the kart's centre, -1 for none within range
            return 1.0 - scan * (2.0 / self.lidar.range)
        if name == "heading":
            return math.cos(state.heading), math.sin(state.heading)
        if name == "velocity":
            return self.observed_velocity(state)
        if name == "position":
            left, top, right, bottom = self.track.box
            across, down = (state.x - left) / (right - left), (state.y - top) / (bottom - top)
            return 2.0 * across - 1.0, 2.0 * down - 1.0
        if name == "progress":
            return (2.0 * self._progress(state) - 1.0,)
        # cosine and sine of the next gate's bearing from the heading, and its distance
        middles = self.track.midpoints
        x, y = middles[min(state.next_gate, len(middles) - 1)]
        bearing = math.atan2(y - state.y, x - state.x) - state.heading
        distance = math.hypot(x - state.x, y - state.y)
        return math.cos(bearing), math.sin(bearing), 1.0 - 2.0 * distance / self.lidar.range

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
            "progress": self._progress(self._state),
            "distance": self._distance,
            "reward_terms": terms,
        }
