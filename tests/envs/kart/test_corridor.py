"""Random corridors: every one can be driven, and all shapes of kart-simulator's occur."""

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.kart.gap import GapDriver
from spikedeploy.envs.kart.track import check, corridor, length_of
from spikedeploy.runtime.errors import EnvError


def drawn(count, seeds=range(40)):
    return [corridor(count, np.random.default_rng(seed)) for seed in seeds]


@pytest.mark.parametrize("count", [2, 3, 8])
def test_every_corridor_keeps_the_rules_of_tracks(count):
    for seed, found in enumerate(drawn(count, range(15))):
        check(found, f"corridor of seed {seed}")


@pytest.mark.parametrize("count", [2, 3, 8, 64])
def test_a_corridor_of_n_cells_has_n_gates_two_walls_a_cell_and_one_behind_the_start(count):
    for found in drawn(count, range(5)):
        assert len(found.gates) == count
        assert len(found.walls) == 2 * count + 1
        assert found.length == pytest.approx(50 + 100 * (count - 1), rel=0.3)


def test_all_twelve_corridors_of_three_cells_turn_up_about_as_often():
    shapes = [found.midpoints for found in drawn(3, range(1200))]
    counts = {shape: shapes.count(shape) for shape in set(shapes)}
    assert len(counts) == 12
    assert min(counts.values()) > 60
    assert max(counts.values()) < 140


@pytest.mark.parametrize("name", ["corridor-1", "corridor-65", "corridor-0"])
def test_a_corridor_too_short_or_too_long_is_refused(name):
    with pytest.raises(EnvError, match=f"track '{name}': a corridor has 2 to 64 cells"):
        length_of(name)


def test_every_episode_has_its_own_corridor_and_the_seed_decides_which():
    env = envs.make("kart-steer", track="corridor-6").unwrapped
    env.reset(seed=3)
    first = env.track.walls
    env.reset()
    assert not np.array_equal(env.track.walls, first)
    env.reset(seed=3)
    np.testing.assert_array_equal(env.track.walls, first)


def test_physics_and_lidar_use_the_corridor_of_the_episode():
    env = envs.make("kart-gazebo", track="corridor-12").unwrapped
    driver = GapDriver.for_env(env)
    passed = []
    for seed in range(8):
        observation, info = env.reset(seed=seed)
        np.testing.assert_array_equal(env.scan, env.lidar.distances(*env.pose))
        over = False
        while not over:
            observation, _, terminated, truncated, info = env.step(int(driver.act(observation)))
            over = terminated or truncated
        passed.append(info["gates"])
    assert max(passed) >= 3  # blind, or behind yesterday's walls, it would not leave the first
