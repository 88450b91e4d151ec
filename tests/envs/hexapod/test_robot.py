"""The robot's servos and sensors, its gait and the ground."""

import math

import mujoco
import numpy as np
import pytest

from spikedeploy.envs.hexapod.robot import (
    GRAVITY,
    LEGS,
    STANCE,
    SUBSTEPS,
    Field,
    Gait,
    Robot,
    Terrain,
)

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


def gait_at(phase):
    gait = Gait()
    gait.reset(phase)
    return gait.command().reshape(len(LEGS), 3)


def test_the_two_tripods_do_the_same_half_a_cycle_apart():
    first = [LEGS.index(leg) for leg in ("RF", "RR", "LM")]
    second = [LEGS.index(leg) for leg in ("RM", "LF", "LR")]
    for phase in np.linspace(0.0, math.tau, 17):
        now, later = gait_at(phase), gait_at(phase + math.pi)
        np.testing.assert_allclose(now[first], later[second], atol=1e-12)
        np.testing.assert_allclose(now[first], np.broadcast_to(now[first[0]], (3, 3)), atol=1e-12)


def test_a_quarter_cycle_by_hand():
    # phase pi/2: sine 1, cosine 0; RF is at the top of its swing, RM in the middle of its stance
    command = gait_at(math.pi / 2)
    np.testing.assert_allclose(command[LEGS.index("RF")], [0.0, 0.45, 0.20], atol=1e-12)
    np.testing.assert_allclose(command[LEGS.index("RM")], [0.0, 0.0, 0.0], atol=1e-12)


def test_a_foot_is_lifted_only_while_it_swings_forward():
    step = 1e-4
    for phase in np.linspace(0.01, math.tau - 0.01, 50):
        coxa_speed = gait_at(phase + step)[:, 0] - gait_at(phase)[:, 0]
        np.testing.assert_array_equal(gait_at(phase)[:, 1] > 0.0, coxa_speed > 0.0)


HALL = Field(length=6.0, width=4.0, start=(-1.0, 0.5))


@pytest.fixture
def terrain():
    return Terrain(HALL, Robot(HALL).model)


def test_bumps_rise_from_nothing_to_the_stated_height(terrain):
    terrain.roughen(0.03, np.random.default_rng(0))
    assert terrain.height.min() == pytest.approx(0.0, abs=1e-12)
    assert terrain.height.max() == pytest.approx(0.03)


def test_the_ground_is_flat_where_the_robot_starts(terrain):
    terrain.roughen(0.08, np.random.default_rng(0))
    assert terrain.ground(*HALL.start) == pytest.approx(0.04)
    assert terrain.ground(1.5, -1.0) != pytest.approx(0.04)


def test_the_robot_walks_on_the_ground_that_is_measured(terrain):
    robot = Robot(HALL)
    terrain = Terrain(HALL, robot.model)
    terrain.roughen(0.08, np.random.default_rng(1))
    robot.place(0.0, 0.0, 2.0, 0.0)  # out of the way
    top = 1.0
    for x, y in ((1.0, 1.0), (-2.0, -1.5), (2.0, 0.3)):
        row, column = round((y + 2.0) / 0.05), round((x + 3.0) / 0.05)
        hit = np.zeros(1, np.int32)
        fall = mujoco.mj_ray(robot.model, robot.data, [x, y, top], [0, 0, -1], None, 1, -1, hit)
        assert top - fall == pytest.approx(terrain.height[row, column], abs=1e-4)


def test_steps_are_blocks_of_their_own_heights():
    terrain = Terrain(HALL, Robot(HALL).model, "steps")
    terrain.roughen(0.09, np.random.default_rng(0))
    blocks = terrain.height[70:80, 110:120].reshape(2, 5, 2, 5)  # far from the start
    assert np.ptp(blocks, axis=(1, 3)).max() < 1e-12
    assert len(np.unique(blocks.round(9))) == 4
    assert 0.0 <= terrain.height.min() < 0.01 < 0.08 < terrain.height.max() <= 0.09


def test_stairs_go_three_risers_up_and_three_down():
    robot = Robot(HALL, "stairs")
    terrain = Terrain(HALL, robot.model, "stairs")
    terrain.roughen(0.07, np.random.default_rng(0))
    levels = (terrain.height[0, 48::5] / 0.07).round(6)  # a sample of each tread
    assert levels.tolist() == [0.5 + k for k in (0, 1, 2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1, 2)]
    assert terrain.ground(*HALL.start) == pytest.approx(0.035)
    robot.place(0.0, 0.0, 2.0, 0.0)
    hit = np.zeros(1, np.int32)
    fall = mujoco.mj_ray(robot.model, robot.data, [0.15, 1, 1], [0, 0, -1], None, 1, -1, hit)
    assert 1.0 - fall == pytest.approx(terrain.height[60, 63], abs=1e-4)
    assert terrain.height[60, 63] > 0.2


def test_the_local_mean_is_that_of_seven_by_seven_samples(terrain):
    terrain.roughen(0.08, np.random.default_rng(2))
    x, y = 1.0, 1.0
    row, column = round((y + 2.0) / 0.05), round((x + 3.0) / 0.05)
    patch = terrain.height[row - 3 : row + 4, column - 3 : column + 4]
    assert terrain.ground(x, y) == pytest.approx(patch.mean())


def test_the_ground_is_constant_beyond_the_edge(terrain):
    terrain.roughen(0.08, np.random.default_rng(2))
    assert terrain.ground(1e6, 1e6) == pytest.approx(terrain.mean[-1, -1], abs=1e-4)
    assert terrain.ground(-1e6, -1e6) == pytest.approx(terrain.mean[0, 0], abs=1e-4)
