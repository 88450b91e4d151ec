"""Hexapod-v0: walk straight ahead over rough ground; observation, reward and random bodies."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, get_args

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.finite import all_finite
from spikedeploy.envs.hexapod.camera import Camera, Mark
from spikedeploy.envs.hexapod.robot import (
    GRAVITY,
    STANCE,
    Field,
    Gait,
    Ground,
    Motion,
    Robot,
    Terrain,
)
from spikedeploy.runtime.errors import EnvError

Range = float | tuple[float, float]


def sample(value: Range, rng: np.random.Generator) -> float:
    """Draw uniformly from a pair (low, high), or return a plain number."""
    if isinstance(value, tuple):
        return float(rng.uniform(*value))
    return float(value)


def check(name: str, value: object, lowest: float, highest: float) -> Range:
    """Return an option as numbers; EnvError if it is out of bounds or not a range."""
    pair = value if isinstance(value, (tuple, list)) else (value, value)
    numbers = [float(end) for end in pair if isinstance(end, (int, float)) and end is not True]
    if len(pair) != 2 or len(numbers) != 2 or not lowest <= numbers[0] <= numbers[1] <= highest:
        raise EnvError(
            f"option {name}: {value!r} is neither a number from {lowest:g} to {highest:g} "
            f"nor a pair (low, high) of such numbers in order"
        )
    return (numbers[0], numbers[1]) if isinstance(value, (tuple, list)) else numbers[0]


@dataclass(frozen=True)
class PushTable:
    """Distribution of a task's pushes.

    kick: (low, high) [m/s] change of the torso's horizontal velocity, any direction
    spin: [rad/s] standard deviation of the change of its yaw rate
    interval: (shortest, longest) [control steps] from one push to the next
    """

    kick: tuple[float, float]
    spin: float
    interval: tuple[int, int]


class Pushes:
    """Pushes at random intervals; scale 0 switches them off and leaves the schedule as it is."""

    def __init__(self, table: PushTable, scale: float) -> None:
        self.table = table
        self.scale = scale
        self._next = 0

    def reset(self, rng: np.random.Generator) -> None:
        """Draw the time of the first push."""
        self._next = self._interval(rng)

    def due(self, step: int, rng: np.random.Generator) -> tuple[tuple[float, float], float] | None:
        """Return the push due at this control step, if any: kick (x, y) [m/s], spin [rad/s]."""
        if step < self._next:
            return None
        self._next = step + self._interval(rng)
        speed = self.scale * rng.uniform(*self.table.kick)
        direction = rng.uniform(-math.pi, math.pi)
        spin = self.scale * rng.normal(0.0, self.table.spin)
        return (speed * math.cos(direction), speed * math.sin(direction)), spin

    def _interval(self, rng: np.random.Generator) -> int:
        shortest, longest = self.table.interval
        return int(rng.integers(shortest, longest + 1))


FloatArray = NDArray[np.float64]

LIMIT = 10.0  # observations saturate at this magnitude, as sensors do


class ObservationEntry(NamedTuple):
    """Consecutive values of an observation; each is (measured - centre) / spread.

    name: key in the environment's OBSERVATION
    size: number of values
    centre: (size,) or one for all [unit of the measurement]
    spread: (size,) or one for all, so that values are about +-1
    """

    name: str
    size: int
    centre: Sequence[float] | FloatArray | float
    spread: Sequence[float] | FloatArray | float


BODY = (
    ObservationEntry("height", 1, 0.097, 0.03),  # [m] of the torso above the mean ground around it
    ObservationEntry("gravity", 3, 0.0, (0.3, 0.3, 1.0)),  # [1] in the body's frame
    ObservationEntry("heading", 1, 0.0, 1.0),  # [rad] from the course
    ObservationEntry("velocity", 3, 0.0, 0.5),  # [m/s] in the body's frame
    ObservationEntry("angular_velocity", 3, 0.0, 1.0),  # [rad/s] in the body's frame
    ObservationEntry("joints", 18, STANCE, 0.6),  # [rad] leg after leg: coxa, femur, tibia
    ObservationEntry("joint_velocity", 18, 0.0, 3.0),  # [rad/s]
    ObservationEntry("previous", 18, 0.0, 1.0),  # [action unit] last filtered command
    ObservationEntry("contact", 6, 0.0, 1.0),  # [1] feet on the ground
    ObservationEntry("phase", 2, 0.0, 1.0),  # [1] sine and cosine of the gait
)
COURSE = (
    ObservationEntry("speed", 1, 0.0, 0.4),  # [m/s] smoothed, along the course
    ObservationEntry("lateral", 1, 0.0, 1.0),  # [m] off the course, left positive
    ObservationEntry("lateral_velocity", 1, 0.0, 0.5),  # [m/s]
)
LOAD = ObservationEntry("load", 1, 0.0, 24.0)  # [N] all feet together


def layout(entries: Sequence[ObservationEntry]) -> dict[str, slice]:
    """Name of each entry -> its slice of the observation."""
    slices, end = {}, 0
    for entry in entries:
        slices[entry.name] = slice(end, end + entry.size)
        end += entry.size
    return slices


def scaling(entries: Sequence[ObservationEntry]) -> tuple[FloatArray, FloatArray]:
    """Centre (obs,) and spread (obs,) of every value."""
    centres = [np.broadcast_to(entry.centre, entry.size) for entry in entries]
    spreads = [np.broadcast_to(entry.spread, entry.size) for entry in entries]
    return np.concatenate(centres).astype(np.float64), np.concatenate(spreads).astype(np.float64)


_TARGET_SPEED = 0.40  # [m/s] of Hexapod-v0
_SPEED_KERNEL = 0.12  # [m/s]
_TURN_KERNEL = 0.3  # [rad/s]


def course_terms(
    speed: float, heading: float, lateral: float, target: float = _TARGET_SPEED
) -> dict[str, float]:
    """Terms for walking straight: alive, speed, heading, lateral.

    speed: [m/s] smoothed, along the course
    heading: [rad] from the course
    lateral: [m] off the course
    target: [m/s] the speed that is asked for
    """
    return {
        "alive": 1.0,
        "speed": 3.0 * max(-1.0, 1.0 - abs(speed - target) / target),
        "heading": -0.5 * min(abs(heading), 1.0),
        "lateral": -0.5 * min(abs(lateral), 1.0),
    }


def command_terms(speed_error: float, turn_error: float, sideways: float) -> dict[str, float]:
    """Terms for following commands: alive, speed, turn, sideways.

    speed_error: [m/s] commanded - smoothed
    turn_error: [rad/s] commanded - smoothed
    sideways: [m/s] leftward
    """
    return {
        "alive": 1.0,
        "speed": 2.5 * kernel(speed_error, _SPEED_KERNEL),
        "turn": 2.0 * kernel(turn_error, _TURN_KERNEL),
        "sideways": -0.5 * min(abs(sideways), 0.5),
    }


def kernel(error: float, width: float) -> float:
    """Score in [-1, 1] of a tracking error: 1 at 0, 0 at the width, a quarter as steep beyond."""
    excess = abs(error) / width
    # k(e) = 1 - e/s up to s; -(e/s - 1)/4 beyond, at least -1
    return 1.0 - excess if excess <= 1.0 else max(-1.0, -0.25 * (excess - 1.0))


def regularisers(
    motion: Motion, height: float, crouch: float, change: FloatArray, jerk: float
) -> dict[str, float]:
    """Terms that both tasks share: posture, smoothness and power.

    height: [m] of the torso above the mean ground
    crouch: [m] height below which crouching is penalised
    change: (18,) change of the action since the last control step
    jerk: weight of its square

    Power is sampled at the end of the control step, as by a current sensor at 50 Hz.
    """
    gx, gy, _ = motion.gravity
    wx, wy, _ = motion.angular_velocity
    return {
        "tilt": -2.0 * (gx * gx + gy * gy),
        "jerk": -jerk * float(change @ change),
        "power": -0.025 * motion.power,
        "bounce": -0.5 * min(abs(motion.velocity[2]), 1.0),
        "slip": -0.5 * motion.slip,
        "wobble": -0.02 * (wx * wx + wy * wy),
        "crouch": -5.0 * max(0.0, crouch - height),
    }


CONTROL_DT = 0.02  # [s]
SMOOTHING = 0.1  # weight of the newest value in a smoothed speed or turn rate
_FILTER = 0.6  # weight of the newest value in the command to the servos
_LOWEST_UP = 0.5  # [1] z of the body's up axis below which the robot has fallen


class HexapodEnv(gymnasium.Env[FloatArray, FloatArray]):
    """Walk along the x axis at 0.4 m/s for 20 s over 3 cm bumps, with random pushes.

    Action (18,) in [-1, 1], a residual on the tripod gait, leg by leg coxa, femur, tibia.
    The servos hold stance + 0.6 rad x filtered, where in every control step
    filtered = 0.6 (gait + AUTHORITY x action) + 0.4 filtered.

    Observation (77,) float64, each about +-1, saturating at +-10; OBSERVATION names its slices.
    On a real robot the servos give joints and joint_velocity, an inertial unit gives gravity and
    angular_velocity, switches or load cells in the feet give contact and load; previous and phase
    are the controller's own. Height, velocity, heading, speed, lateral and lateral_velocity need
    odometry: leg kinematics with the inertial unit, or a camera.

    An episode ends after max_steps (truncated) or with a fall (terminated): the z of the body's up
    axis below 0.5, or its centre below 0.04 m over the mean ground around it. It succeeds when it
    does not fall and its return passes SUCCESS_RETURN. Over 1000 steps the gait alone earns about
    1950 (0.155 m/s), a random residual about 850; 4000 is the bound that no walker reaches.

    The info of a step has reward_terms (their sum is the reward), fall, success (so far) and
    speed [m/s] smoothed · heading [rad] · lateral [m] · slip [m/s] · power [W] mean of the step ·
    distance [m] along the course · cot [1] energy / (m g distance) so far · episode_return so far.

    terrain: [m] height of the bumps, blocks or risers
    ground: "bumps"; "steps", blocks of 25 cm of random heights; or "stairs", three risers up
        and three down, with treads of 25 cm. Edges are slopes of 5 cm, the spacing of
        samples of the ground
    pushes: [1] scale of the pushes, 0 for none
    mass: [1] factor on every body
    payload: [kg] on the torso
    friction: [1] of the feet on the ground
    servo_gain: [1] factor on stiffness and damping of the servos
    slope: [rad] of the ground, which rises along the x axis
    max_steps: [control steps]
    render_mode: "rgb_array" or None
    Physical options are a number, or a pair (low, high) from which each episode draws.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - declared so by gymnasium
        "render_modes": ["rgb_array"],
        "render_fps": 50,
    }

    CONTROL_DT: ClassVar[float] = CONTROL_DT
    SUCCESS_RETURN: ClassVar[float] = 2500.0
    ENTRIES: ClassVar[tuple[ObservationEntry, ...]] = (*BODY, *COURSE, LOAD)
    OBSERVATION: ClassVar[dict[str, slice]] = layout(ENTRIES)
    FIELD: ClassVar[Field] = Field(length=24.0, width=8.0, start=(-10.0, 0.0))
    PUSHES: ClassVar[PushTable] = PushTable(kick=(0.125, 0.25), spin=0.5, interval=(100, 250))
    START_HEADING: ClassVar[float] = 0.15  # [rad] at most, either way
    LOWEST_HEIGHT: ClassVar[float] = 0.04  # [m] below which the robot has fallen
    CROUCH_HEIGHT: ClassVar[float] = 0.09  # [m] below which crouching is penalised
    AUTHORITY: ClassVar[FloatArray] = np.full(18, 0.5)
    JERK: ClassVar[float] = 0.02  # weight of squared changes of the action

    def __init__(
        self,
        *,
        terrain: Range = 0.03,
        ground: Ground = "bumps",
        pushes: float = 1.0,
        mass: Range = (0.95, 1.05),
        payload: Range = (-0.1, 0.3),
        friction: Range = (0.55, 1.0),
        servo_gain: Range = (0.85, 1.1),
        slope: Range = 0.0,
        max_steps: int = 1000,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise EnvError(f"option render_mode: {render_mode!r} is neither rgb_array nor None")
        if max_steps < 1:
            raise EnvError(f"option max_steps: {max_steps} is below 1")
        self.render_mode = render_mode
        self.max_steps = max_steps
        if ground not in get_args(Ground):
            raise EnvError(f"option ground: {ground!r} is not one of {', '.join(get_args(Ground))}")
        self._bump = check("terrain", terrain, 0.0, 0.1)
        self._body = {
            "mass": check("mass", mass, 0.5, 2.0),
            "payload": check("payload", payload, -0.5, 2.0),
            "friction": check("friction", friction, 0.01, 5.0),
            "servo_gain": check("servo_gain", servo_gain, 0.1, 5.0),
            "slope": check("slope", slope, -0.5, 0.5),
        }
        scale = check("pushes", pushes, 0.0, 10.0)
        if isinstance(scale, tuple):
            raise EnvError(f"option pushes: {pushes!r} is a pair; one number scales every push")
        self._pushes = Pushes(self.PUSHES, scale)
        self._robot = Robot(self.FIELD, ground)
        self._terrain = Terrain(self.FIELD, self._robot.model, ground)
        self._gait = Gait()
        self._camera: Camera | None = None
        self._centre, self._spread = scaling(self.ENTRIES)
        size = len(self._centre)
        self.observation_space = gymnasium.spaces.Box(-LIMIT, LIMIT, (size,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (18,), np.float64)

    @property
    def robot(self) -> Robot:
        """The robot, with MuJoCo's model and state."""
        return self._robot

    @property
    def scaling(self) -> tuple[FloatArray, FloatArray]:
        """Centre (obs,) and spread (obs,) by which observations are scaled."""
        return self._centre, self._spread

    @property
    def support_force(self) -> float:
        """Fraction [0, 1] of the full upward force (0.6 of the weight); used in training only."""
        return self._robot.support_force

    @support_force.setter
    def support_force(self, fraction: float) -> None:
        if not 0.0 <= fraction <= 1.0:
            raise EnvError(f"support_force: {fraction} is outside [0, 1]")
        self._robot.support_force = float(fraction)

    def weaken(self, servos: Sequence[int], factor: float) -> None:
        """Scale stiffness and damping of some of the 18 servos, until the next reset."""
        self._robot.weaken(servos, factor)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Start an episode with new ground, body parameters, pushes and gait phase."""
        super().reset(seed=seed)
        rng = self.np_random
        self._terrain.roughen(sample(self._bump, rng), rng)
        self._robot.rebuild(**{name: sample(value, rng) for name, value in self._body.items()})
        self._gait.reset(rng.uniform(0.0, math.tau))
        self._pushes.reset(rng)
        x, y = self.FIELD.start
        heading = rng.uniform(-self.START_HEADING, self.START_HEADING)
        self._robot.place(x, y, self._terrain.ground(x, y), heading)
        self._step = 0
        self._action = np.zeros(18)
        self._filtered = np.zeros(18)
        self._speed = 0.0
        self._energy = 0.0
        self._distance = 0.0
        self._return = 0.0
        self._begin()
        if self._camera is not None:
            self._camera.update_ground()
        motion = self._robot.sense()
        return self._observe(motion, self._height(motion)), {}

    def step(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Advance by one control step of 20 ms."""
        action = self._accept(action)
        motion = self._move(action)
        height = self._height(motion)
        self._step += 1
        self._energy += motion.mean_power * CONTROL_DT
        self._track(motion)
        terms = self._task_terms(motion)
        change = action - self._action
        terms |= regularisers(motion, height, self.CROUCH_HEIGHT, change, self.JERK)
        reward = sum(terms.values())
        self._return += reward
        self._action = action
        fall = -motion.gravity[2] < _LOWEST_UP or height < self.LOWEST_HEIGHT
        truncated = not fall and self._step >= self.max_steps
        info = self._info(motion, terms, fall)
        self._update_command()
        observation = self._observe(motion, height)
        return observation, reward, fall, truncated, info

    def render(self) -> NDArray[np.uint8]:
        """Return a frame (480, 640, 3)."""
        if self.render_mode is None:
            raise EnvError('made without render_mode; choose "rgb_array"')
        if self._camera is None:
            self._camera = Camera(self._robot, self._marks)
        return self._camera.picture()

    def close(self) -> None:
        """Close the camera, if there is one."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _accept(self, action: FloatArray) -> FloatArray:
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (18,):
            raise EnvError(f"action of step {self._step}: shape {action.shape} instead of (18,)")
        if not all_finite(action):
            raise EnvError(f"action of step {self._step}: not finite: {action}")
        return np.minimum(np.maximum(action, -1.0), 1.0)

    def _move(self, action: FloatArray) -> Motion:
        push = self._pushes.due(self._step, self.np_random)
        if push is not None:
            self._robot.push(*push)
        self._filtered = self._servo_command(action)
        self._robot.drive(self._filtered)
        self._gait.advance(CONTROL_DT)
        return self._robot.sense()

    def _height(self, motion: Motion) -> float:
        x, y, z = motion.position
        return z - self._terrain.ground(x, y)

    def _observe(self, motion: Motion, height: float) -> FloatArray:
        """Observation (77,) of the current state."""
        turning, *course = self._task_observation(motion)
        phase = math.sin(self._gait.phase), math.cos(self._gait.phase)
        body = height, *motion.gravity, turning, *motion.body_velocity, *motion.angular_velocity
        # in the order of ENTRIES
        values = np.concatenate(
            (
                body,
                motion.joints,
                motion.joint_velocity,
                self._filtered,
                motion.contact,
                (*phase, *course, np.add.reduce(motion.load)),
                *self._further(motion),
            )
        )
        values -= self._centre
        values /= self._spread
        np.maximum(values, -LIMIT, out=values)
        np.minimum(values, LIMIT, out=values)
        return values

    def _info(self, motion: Motion, terms: dict[str, float], fall: bool) -> dict[str, Any]:
        weight = self._robot.mass * GRAVITY
        return {
            "reward_terms": terms,
            "speed": self._speed,
            "heading": motion.heading,
            "lateral": motion.position[1],
            "slip": motion.slip,
            "fall": fall,
            "power": motion.mean_power,
            # CoT = energy / (m g distance), with a distance of at least 1 cm
            "cot": self._energy / (weight * max(self._distance, 0.01)),
            "distance": self._distance,
            "episode_return": self._return,
            "success": not fall and self._succeeds(),
        }

    # The parts that depend on the task; other environments override them.

    def _servo_command(self, action: FloatArray) -> FloatArray:
        """Command (18,) to the servos [action unit]."""
        # filtered = 0.6 (gait + authority x action) + 0.4 filtered
        command = self._gait.command() + self.AUTHORITY * action
        filtered: FloatArray = _FILTER * command + (1.0 - _FILTER) * self._filtered
        return filtered

    def _marks(self) -> Iterable[Mark]:
        """Return the marks that are drawn on the ground."""
        return ()

    def _further(self, motion: Motion) -> tuple[FloatArray, ...]:
        """Return the task's own sensor readings, which follow those of the robot."""
        return ()

    def _begin(self) -> None:
        """Draw the task's variables at reset."""

    def _update_command(self) -> None:
        """Update the task's commands before the next observation."""

    def _track(self, motion: Motion) -> None:
        self._speed += SMOOTHING * (motion.velocity[0] - self._speed)
        self._distance = motion.position[0] - self.FIELD.start[0]

    def _task_terms(self, motion: Motion) -> dict[str, float]:
        return course_terms(self._speed, motion.heading, motion.position[1])

    def _succeeds(self) -> bool:
        """Return True if the episode so far is a success, unless it ends with a fall."""
        return self._return > self.SUCCESS_RETURN

    def _task_observation(self, motion: Motion) -> tuple[float, ...]:
        """The task's entry of BODY, then its own."""
        return motion.heading, self._speed, motion.position[1], motion.velocity[1]
