"""The scripted driver: its geometry by hand, and that it really drives."""

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.kart.gap import WIDTH, GapDriver
from spikedeploy.envs.rollout import rollout
from spikedeploy.policies.registry import find, open_policy
from spikedeploy.runtime.errors import EnvError

KARTS = [name for name, spec in envs.ENVS.items() if "gap" in spec.controls]
FOUR = np.array([0.0, 0.5, 1.0, 1.5]) * np.pi  # ahead, right, back, left


def driver(*actions):
    columns = {"lidar": slice(0, 4), "velocity": slice(4, 6)}
    return GapDriver(FOUR, 100.0, columns, {name: k for k, name in enumerate(actions)})


@pytest.mark.parametrize("name", KARTS)
def test_it_finishes_nine_of_ten_unseen_starts(name):
    world = envs.make(name)
    player = open_policy(find("gap"), None, world)
    assert sum(rollout(world, player, seed).success for seed in range(10_000, 10_010)) >= 9


@pytest.mark.parametrize("options", [{}, {"actions": "continuous"}])
def test_replaying_the_observations_gives_the_same_actions(options):
    world = envs.make("kart-steer", max_steps=100, **options)
    player = open_policy(find("gap"), None, world)
    played = rollout(world, player, 10_000)
    np.testing.assert_array_equal(player.replay(played.observation[:-1]), played.action)
    assert played.action.shape[1:] == world.action_space.shape


def test_walls_closer_to_the_lane_than_half_a_kart_block_it():
    angles = np.array([0.0, 0.2])
    columns = {"lidar": slice(0, 2), "velocity": slice(2, 4)}
    robot = GapDriver(angles, 300.0, columns, {"stop": 0, "forward": 1})
    distance = 0.9 * WIDTH / np.sin(0.2)  # so that it stands 0.9 WIDTH beside the way ahead
    assert robot.free(np.array([300.0, distance]))[0] == pytest.approx(distance * np.cos(0.2))
    distance = 1.1 * WIDTH / np.sin(0.2)
    assert robot.free(np.array([300.0, distance]))[0] == 300


def test_it_turns_towards_the_gap_and_then_drives():
    robot = driver("stop", "forward", "left", "right")
    seen = [1 - 2 * d / 100 for d in (50, 100, 50, 50)]
    assert robot.act(np.array([*seen, -1.0, 0.0])) == 3
    seen = [1 - 2 * d / 100 for d in (100, 50, 50, 50)]
    assert robot.act(np.array([*seen, -1.0, 0.0])) == 1


def test_it_brakes_where_it_is_too_fast_for_the_free_length():
    kart = driver("none", "accelerate", "brake", "left", "right")
    seen = [1 - 2 * d / 100 for d in (100, 50, 50, 50)]
    assert kart.act(np.array([*seen, -1.0, 0.0])) == 1
    assert kart.act(np.array([*seen, 1.0, 0.0])) == 2  # 100 px are not enough at top speed


def test_a_kart_without_heading_is_pushed_along_the_missing_velocity():
    kart = driver("none", "up", "down", "left", "right")
    seen = [1 - 2 * d / 100 for d in (100, 50, 50, 50)]
    assert kart.act(np.array([*seen, 0.0, 0.0])) == 4
    assert kart.act(np.array([*seen, 0.4, 0.5])) == 1  # drifting down, it is pushed up


@pytest.mark.parametrize("env", ["hexapod", "kart-grid"])
def test_without_a_lidar_it_says_so(env):
    world = envs.make(env, **({"observe": ["position"]} if env == "kart-grid" else {}))
    with pytest.raises(EnvError, match="the gap driver needs a kart that observes lidar"):
        open_policy(find("gap"), None, world)
