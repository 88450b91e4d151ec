import mujoco
import numpy as np
import pytest

from spikedeploy.envs.hexapod.robot import GRAVITY, STANCE, SUBSTEPS, Field, Robot

FIELD = Field(length=4.0, width=4.0, start=(0.0, 0.0))
FLAT = {"mass": 1.0, "payload": 0.0, "friction": 0.9, "servo_gain": 1.0}


@pytest.fixture
def robot():
    robot = Robot(FIELD)
    robot.rebuild(**FLAT)
    robot.place(0.0, 0.0, 0.0, 0.3)
    return robot


def settle(robot, steps=100):
    for _ in range(steps):
        robot.drive(np.zeros(18))
    return robot.sense()


def test_standing_feet_carry_the_weight_and_the_torso_is_level(robot):
    motion = settle(robot)
    assert motion.load.sum() == pytest.approx(robot.mass * GRAVITY, rel=0.01)
    assert motion.contact.all()
    assert motion.position[2] == pytest.approx(0.105, abs=0.003)
    assert motion.gravity == pytest.approx((0.0, 0.0, -1.0), abs=0.02)
    assert motion.heading == pytest.approx(0.3, abs=0.02)
    assert motion.slip < 0.01


def test_the_full_support_force_carries_six_tenths_of_the_weight(robot):
    robot.support_force = 1.0
    assert settle(robot).load.sum() == pytest.approx(0.4 * robot.mass * GRAVITY, rel=0.01)


def test_payload_and_mass_factor_add_up_and_come_off_again(robot):
    robot.rebuild(mass=1.04, payload=0.3, friction=0.6, servo_gain=0.9)
    assert robot.mass == pytest.approx(2.45 * 1.04 + 0.3)
    foot = robot.model.geom("RF_foot")
    assert foot.friction[0] == 0.6
    assert robot.model.actuator_gainprm[:, 0] == pytest.approx(np.full(18, 12.0 * 0.9))
    robot.rebuild(**FLAT)
    fresh = Robot(FIELD).model
    np.testing.assert_array_equal(robot.model.body_mass, fresh.body_mass)
    np.testing.assert_array_equal(robot.model.actuator_biasprm, fresh.actuator_biasprm)


def test_the_body_frame_is_that_of_mujoco(robot):
    rng = np.random.default_rng(0)
    robot.data.qpos[3:7] = [0.8, 0.3, -0.4, 0.34]
    robot.data.qpos[3:7] /= np.linalg.norm(robot.data.qpos[3:7])
    robot.data.qvel[:6] = rng.normal(size=6)
    mujoco.mj_forward(robot.model, robot.data)
    rotation = robot.data.body("torso").xmat.reshape(3, 3)
    motion = robot.sense()
    np.testing.assert_allclose(motion.gravity, rotation.T @ [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(motion.body_velocity, rotation.T @ robot.data.qvel[:3], atol=1e-12)
    assert motion.heading == pytest.approx(np.arctan2(rotation[1, 0], rotation[0, 0]))


def test_power_is_averaged_over_the_substeps(robot):
    twin = Robot(FIELD)
    twin.rebuild(**FLAT)
    twin.place(0.0, 0.0, 0.0, 0.3)
    command = np.linspace(-0.5, 0.5, 18)
    robot.drive(command)
    twin.data.ctrl[:] = STANCE + 0.6 * command
    powers = []
    for _ in range(SUBSTEPS):
        mujoco.mj_step(twin.model, twin.data)
        powers.append(np.abs(twin.data.actuator_force * twin.data.qvel[6:]).sum())
    motion = robot.sense()
    assert motion.mean_power == pytest.approx(np.mean(powers))
    assert motion.power == pytest.approx(powers[-1])
