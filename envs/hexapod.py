"""Hexapod-v0: walk straight ahead over rough ground."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from envs.disturbances import Pushes, PushTable, Range, check, sample
from envs.errors import EnvError
from envs.gait import Gait
from envs.robot import GRAVITY, STANCE, Motion, Robot
from envs.terrain import Field, Terrain

FloatArray = NDArray[np.float64]

CONTROL_DT = 0.02  # [s]
SMOOTHING = 0.1  # weight of the newest value in a smoothed speed or turn rate
FILTER = 0.6  # weight of the newest value in the command to the servos
TARGET_SPEED = 0.40  # [m/s]
LOWEST_UP = 0.5  # [1] z of the body's up axis below which it has fallen
LIMIT = 10.0  # observations saturate here, as a sensor does

# The observation, entry after entry: name, size, centre, spread; value = (measured - centre) / spread.
_Entry = tuple[str, int, Any, Any]
BODY: tuple[_Entry, ...] = (
    ("height", 1, 0.097, 0.03),  # [m] of the torso above the mean ground around it
    ("gravity", 3, (0.0, 0.0, 0.0), (0.3, 0.3, 1.0)),  # [1] in the body's frame
    ("heading", 1, 0.0, 1.0),  # [rad] from the course
    ("velocity", 3, 0.0, 0.5),  # [m/s] in the body's frame
    ("angular_velocity", 3, 0.0, 1.0),  # [rad/s] in the body's frame
    ("joints", 18, STANCE, 0.6),  # [rad] leg after leg: coxa, femur, tibia
    ("joint_velocity", 18, 0.0, 3.0),  # [rad/s]
    ("previous", 18, 0.0, 1.0),  # [action unit] last filtered command
    ("contact", 6, 0.0, 1.0),  # [1] feet on the ground
    ("phase", 2, 0.0, 1.0),  # [1] sine and cosine of the gait
)
COURSE: tuple[_Entry, ...] = (
    ("speed", 1, 0.0, 0.4),  # [m/s] smoothed, along the course
    ("lateral", 1, 0.0, 1.0),  # [m] off the course, left positive
    ("lateral_velocity", 1, 0.0, 0.5),  # [m/s]
    ("load", 1, 0.0, 24.0),  # [N] all feet together
)


def layout(entries: tuple[_Entry, ...]) -> dict[str, slice]:
    """Name of each entry -> its place in the observation."""
    ends = np.cumsum([size for _, size, _, _ in entries]).tolist()
    return {name: slice(end - size, end) for (name, size, _, _), end in zip(entries, ends)}


def scaling(entries: tuple[_Entry, ...]) -> tuple[FloatArray, FloatArray]:
    """Centre (obs,) and spread (obs,) of every value."""
    centres = [np.broadcast_to(centre, size) for _, size, centre, _ in entries]
    spreads = [np.broadcast_to(spread, size) for _, size, _, spread in entries]
    return np.concatenate(centres).astype(np.float64), np.concatenate(spreads).astype(np.float64)


class HexapodEnv(gymnasium.Env[FloatArray, FloatArray]):
    """Walk along the x axis at 0.4 m/s for 20 s, pushed about on 3 cm bumps.

    Action (18,) in [-1, 1], a residual on the tripod gait, leg after leg coxa, femur, tibia.
    The servos hold  stance + 0.6 rad x filtered,  filtered = 0.6 (gait + AUTHORITY x action) + 0.4 filtered.

    Observation (77,) float64, each about +-1, saturating at +-10; OBSERVATION names its slices.
    On a real robot the servos give joints and joint_velocity, an inertial unit gives gravity and
    angular_velocity, switches or load cells in the feet give contact and load; previous and phase
    are the controller's own. Height, velocity, heading, speed, lateral and lateral_velocity need
    odometry: leg kinematics with the inertial unit, or a camera.

    An episode ends after max_steps (truncated) or with a fall (terminated): the body's up axis below
    0.5 or its centre below 0.04 m over the mean ground around it. It succeeds when it does not fall
    and the return passes SUCCESS_RETURN; the gait alone earns about 2000, the most is near 4000.

    terrain      [m] height of the bumps
    pushes       [1] scale of the pushes, 0 for none
    mass         [1] factor on every body
    payload      [kg] on the torso
    friction     [1] of the feet on the ground
    servo_gain   [1] factor on stiffness and damping of the servos
    max_steps    [control steps]
    render_mode  "rgb_array", "human" or None
    Of the physical options a number is kept, a pair (low, high) is drawn from in every episode.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array", "human"], "render_fps": 50}

    CONTROL_DT: ClassVar[float] = CONTROL_DT
    SUCCESS_RETURN: ClassVar[float] = 2500.0
    ENTRIES: ClassVar[tuple[_Entry, ...]] = BODY + COURSE
    OBSERVATION: ClassVar[dict[str, slice]] = layout(ENTRIES)
    FIELD: ClassVar[Field] = Field(length=24.0, width=8.0, start=(-10.0, 0.0))
    PUSHES: ClassVar[PushTable] = PushTable(kick=(0.125, 0.25), spin=0.5, interval=(100, 250))
    START_HEADING: ClassVar[float] = 0.15  # [rad] at most, either way
    LOWEST_HEIGHT: ClassVar[float] = 0.04  # [m] below which it has fallen
    CROUCH_HEIGHT: ClassVar[float] = 0.09  # [m] below which it is paid less
    AUTHORITY: ClassVar[FloatArray] = np.full(18, 0.5)

    def __init__(
        self,
        *,
        terrain: Range = 0.03,
        pushes: float = 1.0,
        mass: Range = (0.95, 1.05),
        payload: Range = (-0.1, 0.3),
        friction: Range = (0.55, 1.0),
        servo_gain: Range = (0.85, 1.1),
        max_steps: int = 1000,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise EnvError(f"option render_mode: {render_mode!r} is not rgb_array, human or None")
        if max_steps < 1:
            raise EnvError(f"option max_steps: {max_steps} is below 1")
        self.render_mode = render_mode
        self.max_steps = max_steps
        self._bump = check("terrain", terrain, 0.0, 0.1)
        self._body = {
            "mass": check("mass", mass, 0.5, 2.0),
            "payload": check("payload", payload, -0.5, 2.0),
            "friction": check("friction", friction, 0.01, 5.0),
            "servo_gain": check("servo_gain", servo_gain, 0.1, 5.0),
        }
        scale = check("pushes", pushes, 0.0, 10.0)
        self._pushes = Pushes(self.PUSHES, float(scale))
        self._robot = Robot(self.FIELD)
        self._terrain = Terrain(self.FIELD, self._robot.model)
        self._gait = Gait()
        self._centre, self._spread = scaling(self.ENTRIES)
        size = len(self._centre)
        self.observation_space = gymnasium.spaces.Box(-LIMIT, LIMIT, (size,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (18,), np.float64)

    @property
    def hoist(self) -> float:
        """Fraction [0, 1] of the full upward pull (0.6 of the weight); only training raises it."""
        return self._robot.hoist

    @hoist.setter
    def hoist(self, fraction: float) -> None:
        if not 0.0 <= fraction <= 1.0:
            raise EnvError(f"hoist: {fraction} is outside [0, 1]")
        self._robot.hoist = float(fraction)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Start an episode: new ground, new body, new pushes, gait at a random phase."""
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
        motion = self._robot.sense()
        return self._observe(motion, self._height(motion)), {}

    def step(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Move on by one control step of 20 ms."""
        action = self._accept(action)
        push = self._pushes.at(self._step, self.np_random)
        if push is not None:
            self._robot.push(push.kick, push.spin)
        # filtered = 0.6 (gait + authority x action) + 0.4 filtered
        command = self._gait.command() + self.AUTHORITY * action
        self._filtered = FILTER * command + (1.0 - FILTER) * self._filtered
        self._robot.drive(self._filtered)
        self._gait.advance(CONTROL_DT)
        motion = self._robot.sense()
        height = self._height(motion)
        self._step += 1
        self._energy += motion.mean_power * CONTROL_DT
        self._track(motion)
        terms = self._task_terms(motion) | self._regularisers(motion, height, action)
        reward = sum(terms.values())
        self._return += reward
        self._action = action
        fall = -motion.gravity[2] < LOWEST_UP or height < self.LOWEST_HEIGHT
        truncated = not fall and self._step >= self.max_steps
        info = self._info(motion, terms, fall)
        self._prepare()
        observation = self._observe(motion, height)
        if self.render_mode == "human":
            self.render()
        return observation, reward, fall, truncated, info

    def _accept(self, action: FloatArray) -> FloatArray:
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (18,):
            raise EnvError(f"action of step {self._step}: shape {action.shape} instead of (18,)")
        if not np.isfinite(action).all():
            raise EnvError(f"action of step {self._step}: not finite: {action}")
        return np.minimum(np.maximum(action, -1.0), 1.0)

    def _height(self, motion: Motion) -> float:
        x, y, z = motion.position
        return z - self._terrain.ground(x, y)

    def _regularisers(self, motion: Motion, height: float, action: FloatArray) -> dict[str, float]:
        """Terms that both tasks share: stay level, smooth, frugal and upright."""
        gx, gy, _ = motion.gravity
        wx, wy, _ = motion.angular_velocity
        change = action - self._action
        return {
            "tilt": -2.0 * (gx * gx + gy * gy),
            "jerk": -0.02 * float(change @ change),
            "power": -0.025 * motion.power,
            "bounce": -0.5 * min(abs(motion.velocity[2]), 1.0),
            "slip": -0.5 * motion.slip,
            "wobble": -0.02 * (wx * wx + wy * wy),
            "crouch": -5.0 * max(0.0, self.CROUCH_HEIGHT - height),
        }

    def _observe(self, motion: Motion, height: float) -> FloatArray:
        """Observation (77,) of the state that the robot is in now."""
        place = self.OBSERVATION
        values = np.empty(len(self._centre))
        values[0] = height
        values[place["gravity"]] = motion.gravity
        values[place["velocity"]] = motion.body_velocity
        values[place["angular_velocity"]] = motion.angular_velocity
        values[place["joints"]] = motion.joints
        values[place["joint_velocity"]] = motion.joint_velocity
        values[place["previous"]] = self._filtered
        values[place["contact"]] = motion.contact
        values[place["phase"]] = math.sin(self._gait.phase), math.cos(self._gait.phase)
        values[place["load"]] = motion.load.sum()
        self._task_observation(values, motion)
        values -= self._centre
        values /= self._spread
        if not np.isfinite(values).all():
            raise EnvError(f"step {self._step}: the physics diverged; soften options or actions")
        observation: FloatArray = np.minimum(np.maximum(values, -LIMIT), LIMIT)
        return observation

    def _info(self, motion: Motion, terms: dict[str, float], fall: bool) -> dict[str, Any]:
        """What happened in this step and in the episode so far."""
        weight = self._robot.mass * GRAVITY
        return {
            "reward_terms": terms,
            "speed": self._speed,
            "heading": motion.heading,
            "lateral": motion.position[1],
            "slip": motion.slip,
            "fall": fall,
            "power": motion.mean_power,
            # CoT = energy / (m g distance), of the first centimetre at least
            "cot": self._energy / (weight * max(self._distance, 0.01)),
            "distance": self._distance,
            "episode_return": self._return,
            "success": not fall and self._return > self.SUCCESS_RETURN,
        }

    # What makes this task this task; HexapodCommandEnv replaces the following.

    def _begin(self) -> None:
        """Draw what the task needs at reset."""

    def _prepare(self) -> None:
        """Change what the task asks for before the next observation."""

    def _track(self, motion: Motion) -> None:
        """Follow the smoothed speed along the course and the way made good."""
        self._speed += SMOOTHING * (motion.velocity[0] - self._speed)
        self._distance = motion.position[0] - self.FIELD.start[0]

    def _task_terms(self, motion: Motion) -> dict[str, float]:
        """Terms for being alive, fast enough and on course."""
        error = abs(self._speed - TARGET_SPEED)
        return {
            "alive": 1.0,
            "speed": 3.0 * max(-1.0, 1.0 - error / TARGET_SPEED),
            "heading": -0.5 * min(abs(motion.heading), 1.0),
            "lateral": -0.5 * min(abs(motion.position[1]), 1.0),
        }

    def _task_observation(self, values: FloatArray, motion: Motion) -> None:
        place = self.OBSERVATION
        values[place["heading"]] = motion.heading
        values[place["speed"]] = self._speed
        values[place["lateral"]] = motion.position[1]
        values[place["lateral_velocity"]] = motion.velocity[1]
