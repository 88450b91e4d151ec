import mujoco
import numpy as np
import pytest

from spikedeploy.envs.hexapod.robot import Field, Robot, Terrain

FIELD = Field(length=6.0, width=4.0, start=(-1.0, 0.5))


@pytest.fixture
def terrain():
    return Terrain(FIELD, Robot(FIELD).model)


def test_bumps_rise_from_nothing_to_the_stated_height(terrain):
    terrain.roughen(0.03, np.random.default_rng(0))
    assert terrain.height.min() == pytest.approx(0.0, abs=1e-12)
    assert terrain.height.max() == pytest.approx(0.03)


def test_the_ground_is_flat_where_the_robot_starts(terrain):
    terrain.roughen(0.08, np.random.default_rng(0))
    assert terrain.ground(*FIELD.start) == pytest.approx(0.04)
    assert terrain.ground(1.5, -1.0) != pytest.approx(0.04)


def test_the_robot_walks_on_the_ground_that_is_measured(terrain):
    robot = Robot(FIELD)
    terrain = Terrain(FIELD, robot.model)
    terrain.roughen(0.08, np.random.default_rng(1))
    robot.place(0.0, 0.0, 2.0, 0.0)  # out of the way
    top = 1.0
    for x, y in ((1.0, 1.0), (-2.0, -1.5), (2.0, 0.3)):
        row, column = round((y + 2.0) / 0.05), round((x + 3.0) / 0.05)
        hit = np.zeros(1, np.int32)
        fall = mujoco.mj_ray(robot.model, robot.data, [x, y, top], [0, 0, -1], None, 1, -1, hit)
        assert top - fall == pytest.approx(terrain.height[row, column], abs=1e-4)


def test_steps_are_blocks_of_their_own_heights():
    terrain = Terrain(FIELD, Robot(FIELD).model, "steps")
    terrain.roughen(0.09, np.random.default_rng(0))
    blocks = terrain.height[70:80, 110:120].reshape(2, 5, 2, 5)  # far from the start
    assert np.ptp(blocks, axis=(1, 3)).max() < 1e-12
    assert len(np.unique(blocks.round(9))) == 4
    assert 0.0 <= terrain.height.min() < 0.01 < 0.08 < terrain.height.max() <= 0.09


def test_stairs_go_three_risers_up_and_three_down():
    robot = Robot(FIELD, "stairs")
    terrain = Terrain(FIELD, robot.model, "stairs")
    terrain.roughen(0.07, np.random.default_rng(0))
    levels = (terrain.height[0, 48::5] / 0.07).round(6)  # a sample of each tread
    assert levels.tolist() == [0.5 + k for k in (0, 1, 2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1, 2)]
    assert terrain.ground(*FIELD.start) == pytest.approx(0.035)
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
