"""The hexapod: MuJoCo model, servos and sensors."""

from __future__ import annotations

import logging
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.hexapod.gait import LEGS
from spikedeploy.envs.hexapod.terrain import BASE, CEILING, Field

mujoco.set_mju_user_warning(logging.getLogger(__name__).warning)  # instead of MUJOCO_LOG.TXT

_XML = Path(__file__).with_name("hexapod.xml")
GRAVITY = 9.81  # [m/s^2]
SUBSTEPS = 5  # of 4 ms each
STANCE = np.tile([0.0, 0.35, -1.45], 6)  # (18,) [rad] nominal pose
_STANDING = 0.108  # [m] height of the torso's centre above flat ground in the nominal pose
_ACTION_UNIT = 0.6  # [rad]
_TOUCH = 0.5  # [N] load above which a foot is in contact

FloatArray = NDArray[np.float64]
_Row = tuple[float, float, float]


class Motion(NamedTuple):
    """State of the robot at the end of a control step.

    position          (3,) [m] centre of the torso, world
    gravity           (3,) [1] direction of gravity in the body's frame, (0, 0, -1) when upright;
                      on a slope upright is not across the ground
    heading           [rad] of the body's x axis in the world
    velocity          (3,) [m/s] of the torso, world
    body_velocity     (3,) [m/s] of the torso in the body's frame
    angular_velocity  (3,) [rad/s] in the body's frame
    joints            (18,) [rad]
    joint_velocity    (18,) [rad/s]
    load              (6,) [N] normal force on each foot
    contact           (6,) bool
    slip              [m/s] mean horizontal speed of the feet in contact
    power             [W] sum of |torque x joint velocity| at the end of the control step
    mean_power        [W] the same, averaged over the control step
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

    model, data    MuJoCo's objects
    mass           [kg] in this episode, payload included
    support_force  [1] fraction of the full upward force, 0.6 of the weight, used in training only
    """

    def __init__(self, field: Field) -> None:
        self.model = mujoco.MjModel.from_xml_string(_xml(field))
        self.data = mujoco.MjData(self.model)
        self.support_force = 0.0
        self._torso = self.model.body("torso").id
        self._feet = [self.model.geom(f"{leg}_foot").id for leg in LEGS]
        self._mass = self.model.body_mass.copy()
        self._inertia = self.model.body_inertia.copy()
        self._gain = self.model.actuator_gainprm[:, 0].copy()
        self._bias = self.model.actuator_biasprm[:, 1:3].copy()
        self.mass = float(self._mass.sum())
        self._powers = [0.0] * SUBSTEPS
        self._down = 0.0, -1.0  # x and z of the direction of gravity in the world

    def rebuild(
        self, mass: float, payload: float, friction: float, servo_gain: float, slope: float = 0.0
    ) -> None:
        """Set the episode's factor on all masses, payload [kg], foot friction and servo gain.

        slope  [rad] by which the ground rises along x: gravity is tilted, and the world stays level
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
        np.multiply(command, _ACTION_UNIT, out=self.data.ctrl)
        self.data.ctrl += STANCE
        self.data.xfrc_applied[self._torso, 2] = self.support_force * 0.6 * self.mass * GRAVITY
        for substep in range(SUBSTEPS):
            mujoco.mj_step(self.model, self.data)
            self._powers[substep] = self._power()

    def push(self, kick: tuple[float, float], spin: float) -> None:
        """Add kick (x, y) [m/s] and spin [rad/s] to the torso's velocity instantly."""
        self.data.qvel[0] += kick[0]
        self.data.qvel[1] += kick[1]
        self.data.qvel[5] += spin

    def sense(self) -> Motion:
        """Measure everything that observations and rewards use."""
        qpos, qvel, sensors = self.data.qpos, self.data.qvel, self.data.sensordata
        if not np.isfinite(qvel).all():
            raise EnvError(
                f"the simulation diverged {self.data.time:.3f} s into the episode: "
                f"use weaker pushes or options closer to their defaults"
            )
        px, py, pz, w, x, y, z = qpos[:7].tolist()
        vx, vy, vz, *angular = qvel[:6].tolist()
        # rows of the rotation matrix, body to world
        r00, r01, r02 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        r10, r11, r12 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        r20, r21, r22 = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        load = sensors[:6].copy()
        contact = load > _TOUCH
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
            angular_velocity=(angular[0], angular[1], angular[2]),
            joints=qpos[7:].copy(),
            joint_velocity=qvel[6:].copy(),
            load=load,
            contact=contact,
            slip=_slip(sensors[6:].reshape(6, 3), contact),
            power=self._powers[-1],
            mean_power=sum(self._powers) / SUBSTEPS,
        )

    def _power(self) -> float:
        # P = sum |torque x joint velocity|: braking servos recover no energy
        return float(np.abs(self.data.actuator_force * self.data.qvel[6:]).sum())


def _gravity(down: tuple[float, float], x: _Row, z: _Row) -> _Row:
    """Direction of gravity in the body's frame, from the first and last row of its rotation."""
    along, across = down
    if not along:
        return -z[0], -z[1], -z[2]
    return along * x[0] + across * z[0], along * x[1] + across * z[1], along * x[2] + across * z[2]


def _slip(velocity: FloatArray, contact: NDArray[np.bool_]) -> float:
    """Mean horizontal speed [m/s] of the feet (6, 3) in contact, 0 if none is."""
    count = int(contact.sum())
    if count == 0:
        return 0.0
    speed = np.sqrt(velocity[:, 0] ** 2 + velocity[:, 1] ** 2)
    return float(speed @ contact) / count


def _xml(field: Field) -> str:
    """The model's XML with its height field sized for this ground."""
    root = ElementTree.parse(_XML).getroot()
    hfield = root.find("asset/hfield")
    if hfield is None:
        raise ValueError(f"{_XML.name} has no height field")
    rows, columns = field.shape
    hfield.set("nrow", str(rows))
    hfield.set("ncol", str(columns))
    hfield.set("size", f"{field.length / 2} {field.width / 2} {CEILING} {BASE}")
    return ElementTree.tostring(root, encoding="unicode")
