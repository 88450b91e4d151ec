"""The hexapod: MuJoCo model, servos and sensors, the gait and the ground."""

from __future__ import annotations

import logging
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.drawing import without_renderer
from spikedeploy.envs.finite import all_finite
from spikedeploy.runtime.errors import EnvError

with without_renderer():
    import mujoco

LEGS = ("RF", "RM", "RR", "LF", "LM", "LR")

# Tripods RF-RR-LM and RM-LF-LR step in antiphase: a phase shift of pi flips the signs of sine and
# cosine, so that one sign per leg is the whole coupling. In LEGS the tripods alternate.


FREQUENCY = 1.25  # [Hz]
_YAW = 0.35  # [action unit] amplitude of the coxa
_LIFT = 0.45  # [action unit] amplitude of the femur during swing
_EXTEND = 0.20  # [action unit] amplitude of the tibia during swing


class Gait:
    """Open-loop tripod gait.

    phase: [rad], in [0, 2 pi)
    """

    phase = 0.0

    def reset(self, phase: float) -> None:
        """Set the phase [rad]."""
        self.phase = phase % math.tau

    def advance(self, dt: float) -> None:
        """Advance the phase by dt [s]."""
        self.phase = (self.phase + math.tau * FREQUENCY * dt) % math.tau

    def command(self) -> NDArray[np.float64]:
        """Command (18,) at the current phase, leg by leg coxa, femur, tibia [action unit]."""
        sine = math.sin(self.phase)
        # forward while sin(phase) > 0, when the foot is in the air
        coxa = -_YAW * math.cos(self.phase)
        swing, other = max(0.0, sine), max(0.0, -sine)
        one = coxa, _LIFT * swing, _EXTEND * swing
        opposite = -coxa, _LIFT * other, _EXTEND * other
        return np.array((*one, *opposite) * 3)


_CELL = 0.05  # [m] spacing of the height samples
Ground = Literal["bumps", "steps", "stairs"]
_CEILING = 0.1  # [m] height of the value 1 in MuJoCo's height field
_FLIGHT = 3  # risers of stairs, up and then down again
BASE = 0.2  # [m] thickness of the ground below its lowest point
_SPACING = 5  # [cells] spacing of the lattice of bumps, 25 cm
_PATCH = 3  # [cells] half width of the patch whose mean is the local ground
_CLEARING = (0.25, 0.5)  # [m] flat within the first radius of the start, rough beyond the second


@dataclass(frozen=True)
class Field:
    """Size of the ground.

    length: [m] along x
    width: [m] along y
    start: [m] (x, y) of the robot at reset; the field is centred on the origin
    """

    length: float
    width: float
    start: tuple[float, float]

    @property
    def shape(self) -> tuple[int, int]:
        """(rows along y, columns along x)."""
        return round(self.width / _CELL) + 1, round(self.length / _CELL) + 1


class Terrain:
    """The ground of one model.

    height: (rows, columns) [m] in this episode
    mean: (rows, columns) [m] averaged over a patch of 35 cm around each sample
    """

    def __init__(self, field: Field, model: mujoco.MjModel, ground: Ground = "bumps") -> None:
        self.field, self._ground = field, ground
        rows, columns = field.shape
        self._heights = model.hfield_data.reshape(rows, columns)
        self._ceiling = float(model.hfield_size[0, 2])
        y = np.linspace(-field.width / 2, field.width / 2, rows)[:, None]
        x = np.linspace(-field.length / 2, field.length / 2, columns)[None, :]
        near, far = _CLEARING
        distance = np.hypot(x - field.start[0], y - field.start[1])
        self._rough = np.clip((distance - near) / (far - near), 0.0, 1.0)
        # treads as long as bumps, from where the ground is rough on
        tread = np.ceil((x - field.start[0] - far) / (_SPACING * _CELL)).clip(min=0) % (2 * _FLIGHT)
        self._stairs = np.broadcast_to(np.minimum(tread, 2 * _FLIGHT - tread), (rows, columns))
        self.height: NDArray[np.float64] = np.zeros((rows, columns))
        self.mean: NDArray[np.float64] = np.zeros((rows, columns))

    def roughen(self, bump: float, rng: np.random.Generator) -> None:
        """Draw new ground of up to `bump` [m].

        Steps are blocks of 25 cm, each of a height of its own; stairs have treads of 25 cm and
        risers of `bump`, three up and three down, again and again.
        """
        if self._ground == "stairs":
            level = 0.5 + self._stairs
        elif self._ground == "steps":
            level = _lattice(self.field.shape, rng).repeat(_SPACING, 0).repeat(_SPACING, 1)
            level = level[: self.field.shape[0], : self.field.shape[1]]
        else:
            noise = _bumps(self.field.shape, rng)
            lowest = noise.min()
            level = (noise - lowest) / (noise.max() - lowest)
        # height = bump level, fading to the middle height at the start
        self.height = bump * (0.5 + self._rough * (level - 0.5))
        self.mean = _box_mean(self.height, _PATCH)
        self._heights[:] = self.height / self._ceiling

    def ground(self, x: float, y: float) -> float:
        """Mean height of the ground around a point [m], bilinear, constant beyond the edge."""
        rows, columns = self.mean.shape
        u = min(max((x + self.field.length / 2) / _CELL, 0.0), columns - 1.001)
        v = min(max((y + self.field.width / 2) / _CELL, 0.0), rows - 1.001)
        i, j = math.floor(v), math.floor(u)
        v, u = v - i, u - j
        item = self.mean.item
        low = (1.0 - u) * item(i, j) + u * item(i, j + 1)
        high = (1.0 - u) * item(i + 1, j) + u * item(i + 1, j + 1)
        height: float = (1.0 - v) * low + v * high
        return height


def _bumps(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float64]:
    """Random heights on a lattice of 25 cm, interpolated to every sample and smoothed."""
    rows, columns = shape
    fine = _blur(_stretch(_stretch(_lattice(shape, rng)).T).T)
    return fine[:rows, :columns]


def _lattice(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float64]:
    """Random levels in [0, 1], a lattice of 25 cm that reaches over all samples."""
    rows, columns = shape
    return rng.random((rows // _SPACING + 2, columns // _SPACING + 2))


def _stretch(lattice: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear interpolation along the first axis, SPACING samples from one row to the next."""
    weight = np.arange(_SPACING)[None, :, None] / _SPACING
    between = lattice[:-1, None] * (1.0 - weight) + lattice[1:, None] * weight
    return between.reshape(-1, lattice.shape[1])


def _blur(height: NDArray[np.float64]) -> NDArray[np.float64]:
    for axis in (0, 1):
        neighbours = np.roll(height, 1, axis) + np.roll(height, -1, axis)
        height = 0.5 * height + 0.25 * neighbours
    return height


def _box_mean(height: NDArray[np.float64], half: int) -> NDArray[np.float64]:
    """Mean over a square of 2 half + 1 samples, edges repeated."""
    side = 2 * half + 1
    padded = np.pad(height, half, mode="edge")
    total = np.pad(padded.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    square = (
        total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]
    )
    mean: NDArray[np.float64] = square / side**2
    return mean


mujoco.set_mju_user_warning(logging.getLogger(__name__).warning)  # instead of MUJOCO_LOG.TXT

_XML = Path(__file__).with_name("hexapod.xml")
GRAVITY = 9.81  # [m/s^2]
SUBSTEPS = 5  # of 4 ms each
STANCE = np.tile([0.0, 0.35, -1.45], 6)  # (18,) [rad] nominal pose
_STANDING = 0.108  # [m] height of the torso's centre above flat ground in the nominal pose
ACTION_UNIT = 0.6  # [rad]
_TOUCH = 0.5  # [N] load above which a foot is in contact

FloatArray = NDArray[np.float64]
_Row = tuple[float, float, float]


class Motion(NamedTuple):
    """State of the robot at the end of a control step.

    position: (3,) [m] centre of the torso, world
    gravity: (3,) [1] direction of gravity in the body's frame, (0, 0, -1) when upright;
        on a slope upright is not across the ground
    heading: [rad] of the body's x axis in the world
    velocity: (3,) [m/s] of the torso, world
    body_velocity: (3,) [m/s] of the torso in the body's frame
    angular_velocity: (3,) [rad/s] in the body's frame
    joints: (18,) [rad]
    joint_velocity: (18,) [rad/s]
    load: (6,) [N] normal force on each foot
    contact: (6,) bool
    slip: [m/s] mean horizontal speed of the feet in contact
    power: [W] sum of |torque x joint velocity| at the end of the control step
    mean_power: [W] the same, averaged over the control step
    """

    position: tuple[float, float, float]
    gravity: tuple[float, float, float]
    heading: float
    velocity: tuple[float, float, float]
    body_velocity: tuple[float, float, float]
    angular_velocity: tuple[float, float, float]
    joints: FloatArray
    joint_velocity: FloatArray
    load: FloatArray
    contact: NDArray[np.bool_]
    slip: float
    power: float
    mean_power: float


class Robot:
    """A torso on six legs with eighteen position servos.

    model, data: MuJoCo's objects
    mass: [kg] in this episode, payload included
    support_force: [1] fraction of the full upward force, 0.6 of the weight, used in training only
    """

    def __init__(self, field: Field, ground: Ground = "bumps") -> None:
        ceiling = (_FLIGHT + 0.5) * _CEILING if ground == "stairs" else _CEILING
        self.model = mujoco.MjModel.from_xml_string(_xml(field, ceiling))
        self.data = mujoco.MjData(self.model)
        self.support_force = 0.0
        self._torso = self.model.body("torso").id
        self._feet = [self.model.geom(f"{leg}_foot").id for leg in LEGS]
        self._mass = self.model.body_mass.copy()
        self._inertia = self.model.body_inertia.copy()
        self._gain = self.model.actuator_gainprm[:, 0].copy()
        self._bias = self.model.actuator_biasprm[:, 1:3].copy()
        self.mass = float(self._mass.sum())
        # views of MuJoCo's memory, which stays where it is
        self._velocity, self._joint_velocity = self.data.qvel, self.data.qvel[6:]
        self._torque, self._readings = self.data.actuator_force, self.data.sensordata
        self._joint_powers = np.zeros((SUBSTEPS, 18))
        self._powers = [0.0] * SUBSTEPS
        self._down = 0.0, -1.0  # x and z of the direction of gravity in the world

    @property
    def feet(self) -> FloatArray:
        """Centres (6, 3) [m] of the feet in the world."""
        return np.asarray(self.data.geom_xpos[self._feet])

    def rebuild(
        self, mass: float, payload: float, friction: float, servo_gain: float, slope: float = 0.0
    ) -> None:
        """Set the episode's factor on all masses, payload [kg], foot friction and servo gain.

        slope: [rad] by which the ground rises along x: gravity is tilted, and the world stays level
        """
        model = self.model
        model.body_mass[:] = mass * self._mass
        model.body_inertia[:] = mass * self._inertia
        model.body_mass[self._torso] += payload
        model.geom_friction[self._feet, 0] = friction
        model.actuator_gainprm[:, 0] = servo_gain * self._gain
        model.actuator_biasprm[:, 1:3] = servo_gain * self._bias
        self._down = (-math.sin(slope), -math.cos(slope)) if slope else (0.0, -1.0)
        model.opt.gravity[:] = GRAVITY * self._down[0], 0.0, GRAVITY * self._down[1]
        mujoco.mj_setConst(model, self.data)
        self.mass = float(model.body_mass.sum())

    def weaken(self, servos: Sequence[int], factor: float) -> None:
        """Scale the gain of some servos (0 to 17, leg by leg) until the next `rebuild`."""
        self.model.actuator_gainprm[servos, 0] *= factor
        self.model.actuator_biasprm[servos, 1:3] *= factor

    def place(self, x: float, y: float, ground: float, heading: float) -> None:
        """Put the robot at rest in the nominal pose."""
        mujoco.mj_resetData(self.model, self.data)
        half = 0.5 * heading
        pose = (x, y, ground + _STANDING, math.cos(half), 0.0, 0.0, math.sin(half))
        self.data.qpos[:7] = pose
        self.data.qpos[7:] = STANCE
        self.data.ctrl[:] = STANCE
        self._powers = [0.0] * SUBSTEPS
        mujoco.mj_forward(self.model, self.data)

    def drive(self, command: FloatArray) -> None:
        """Hold the servos at stance + 0.6 rad x command (18,) for one control step."""
        np.add(command * ACTION_UNIT, STANCE, out=self.data.ctrl)
        self.data.xfrc_applied[self._torso, 2] = self.support_force * 0.6 * self.mass * GRAVITY
        for powers in self._joint_powers:
            mujoco.mj_step(self.model, self.data)
            np.multiply(self._torque, self._joint_velocity, out=powers)
        # P = sum |torque x joint velocity|: braking servos recover no energy
        np.abs(self._joint_powers, out=self._joint_powers)
        self._powers = np.add.reduce(self._joint_powers, axis=1).tolist()

    def push(self, kick: tuple[float, float], spin: float) -> None:
        """Add kick (x, y) [m/s] and spin [rad/s] to the torso's velocity instantly."""
        self.data.qvel[0] += kick[0]
        self.data.qvel[1] += kick[1]
        self.data.qvel[5] += spin

    def sense(self) -> Motion:
        """Measure everything that observations and rewards use."""
        qpos, qvel = self.data.qpos, self._velocity
        if not all_finite(qvel):
            raise EnvError(
                f"the simulation diverged {self.data.time:.3f} s into the episode: "
                f"use weaker pushes or options closer to their defaults"
            )
        px, py, pz, w, x, y, z = qpos[:7].tolist()
        vx, vy, vz, wx, wy, wz = qvel[:6].tolist()
        # rows of the rotation matrix, body to world
        r00, r01, r02 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        r10, r11, r12 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        r20, r21, r22 = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        load = self._readings[:6].copy()
        return Motion(
            position=(px, py, pz),
            gravity=_gravity(self._down, (r00, r01, r02), (r20, r21, r22)),
            heading=math.atan2(r10, r00),
            velocity=(vx, vy, vz),
            body_velocity=(
                r00 * vx + r10 * vy + r20 * vz,
                r01 * vx + r11 * vy + r21 * vz,
                r02 * vx + r12 * vy + r22 * vz,
            ),
            angular_velocity=(wx, wy, wz),
            joints=qpos[7:].copy(),
            joint_velocity=self._joint_velocity.copy(),
            load=load,
            contact=load > _TOUCH,
            slip=_slip(self._readings.tolist()),
            power=self._powers[-1],
            mean_power=sum(self._powers) / SUBSTEPS,
        )


def _gravity(down: tuple[float, float], x: _Row, z: _Row) -> _Row:
    """Direction of gravity in the body's frame, from the first and last row of its rotation."""
    along, across = down
    if not along:
        return -z[0], -z[1], -z[2]
    return along * x[0] + across * z[0], along * x[1] + across * z[1], along * x[2] + across * z[2]


def _slip(readings: list[float]) -> float:
    """Mean horizontal speed [m/s] of the feet in contact, 0 if none is.

    readings: (24,) loads (6,) [N], then velocities (6, 3) [m/s]
    """
    total, count = 0.0, 0
    for foot in range(6):
        if readings[foot] > _TOUCH:
            vx, vy = readings[6 + 3 * foot], readings[7 + 3 * foot]
            total += math.sqrt(vx * vx + vy * vy)
            count += 1
    return total / count if count else 0.0


def _xml(field: Field, ceiling: float) -> str:
    root = ElementTree.parse(_XML).getroot()
    hfield = root.find("asset/hfield")
    if hfield is None:
        raise ValueError(f"{_XML.name} has no height field")
    rows, columns = field.shape
    hfield.set("nrow", str(rows))
    hfield.set("ncol", str(columns))
    hfield.set("size", f"{field.length / 2} {field.width / 2} {ceiling} {BASE}")
    return ElementTree.tostring(root, encoding="unicode")
