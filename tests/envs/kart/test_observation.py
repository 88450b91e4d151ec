"""What karts observe: places and scales of every component, kart-simulator's among them."""

import math

import numpy as np
import pytest

from spikedeploy import envs

KARTS = ("kart-grid", "kart-gazebo", "kart-steer")
everyone = pytest.mark.parametrize("name", KARTS)


def made(name, **options):
    env = envs.make(name, **options).unwrapped
    env.reset(seed=0)
    return env


@pytest.mark.parametrize(("name", "size"), [("kart-grid", 62), ("kart-gazebo", 64),
                                            ("kart-steer", 64)])  # fmt: skip
def test_the_classic_preset_has_kart_simulators_59_rays_and_sizes(name, size):
    env = made(name, preset="classic")
    assert env.observation_space.shape == (size,)
    angles = np.degrees(env.lidar.angles)
    assert len(angles) == 59
    assert angles[0] == -180.0
    np.testing.assert_allclose(np.diff(angles), 6.1017, atol=1e-4)
    assert angles[-1] == pytest.approx(173.9, abs=0.01)
    assert np.abs(angles).min() == pytest.approx(3.05, abs=0.01)


@pytest.mark.parametrize(("name", "rim", "reach"), [("kart-steer", 0.89, 350.0),
                                                    ("kart-grid", 0.94, 600.0)])  # fmt: skip
def test_classic_rays_without_a_hit_have_kart_simulators_value(name, rim, reach):
    env = made(name, preset="classic")
    place = env.OBSERVATION["lidar"]
    scan = np.linspace(19.2, reach, 59)
    seen = env._observe(env._state, scan)[place]
    assert seen[0] == pytest.approx(rim, abs=0.005)
    most = reach + reach / 600  # c = metres / 6, added to px
    hit = scan <= reach - 2
    np.testing.assert_allclose(seen[hit], 1 - 2 * scan[hit] / most)
    assert (seen[~hit] == -1.0).all()
    assert (~hit).any()


@everyone
def test_the_position_is_relative_to_the_tracks_own_box(name):
    for course in ("big_S", "small_S"):
        env = made(name, track=course)
        left, top, right, bottom = env.track.box
        place = env.OBSERVATION["position"]
        corner = env.observe_at(left, top, 0.0, (0.0, 0.0), 0.0, 0)[place]
        middle = env.observe_at((left + right) / 2, bottom, 0.0, (0.0, 0.0), 0.0, 0)[place]
        np.testing.assert_allclose(corner, [-1, -1])
        np.testing.assert_allclose(middle, [0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "velocity", "turn", "expected"),
    [
        ("kart-grid", (200.0, -400.0), 0.0, (0.5, -1.0)),
        ("kart-gazebo", (0.0, 0.0), 5.68, (-1.0, 1.0)),
        ("kart-gazebo", (440.0, 0.0), 0.0, (1.0, 0.0)),
        ("kart-steer", (0.0, 299.5), 3.8268, (0.0, 1.0)),
        ("kart-steer", (602.0, 0.0), -1.9134, (1.0, -0.5)),
    ],
)
def test_the_velocity_is_scaled_by_each_karts_own_limits(name, velocity, turn, expected):
    env = made(name)
    seen = env.observe_at(300.0, 200.0, 0.0, velocity, turn, 0)
    np.testing.assert_allclose(seen[env.OBSERVATION["velocity"]], expected, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "speed", "expected"),
    [
        ("kart-grid", 100.0, -0.5),
        ("kart-gazebo", 0.0, -1.0),
        ("kart-gazebo", 440.0, 1.0),
        ("kart-gazebo", 5.0, 1.0),  # binary: 440 px/s were divided by 4.4
        ("kart-steer", 299.5, 0.0),
    ],
)
def test_the_classic_speed_is_kart_simulators(name, speed, expected):
    env = made(name, preset="classic")
    seen = env.observe_at(300.0, 200.0, 0.0, (0.0, speed), 0.0, 0)
    np.testing.assert_allclose(seen[env.OBSERVATION["speed"]], expected)


def test_the_next_gate_is_observed_relative_to_the_heading():
    env = made("kart-steer", observe=["gate"], lidar={"range": 400.0})
    # the middle of gate 1 is at (448, 205)
    seen = env.observe_at(448.0, 105.0, math.pi / 2, (0.0, 0.0), 0.0, 0)
    np.testing.assert_allclose(seen, [1, 0, 0.5], atol=1e-12)
    seen = env.observe_at(348.0, 205.0, math.pi / 2, (0.0, 0.0), 0.0, 0)
    np.testing.assert_allclose(seen, [0, -1, 0.5], atol=1e-12)
    far = env.observe_at(448.0, 905.0, 0.0, (0.0, 0.0), 0.0, 0)
    assert far[2] == -1.0


@everyone
@pytest.mark.parametrize("preset", ["default", "classic"])
def test_observe_at_equals_the_observation_and_changes_nothing(name, preset):
    env, quiet = made(name, preset=preset), made(name, preset=preset)
    rng = np.random.default_rng(2)
    for action in rng.integers(env.action_space.n, size=60):
        observation, reward, terminated, _, info = env.step(action)
        expected, same, _, _, told = quiet.step(action)
        np.testing.assert_array_equal(observation, expected)
        assert (reward, info) == (same, told)
        here = env.observe_at(*env.pose, env.velocity, env.turn, env.next_gate)
        np.testing.assert_array_equal(here, observation)
        env.observe_at(500.0, 500.0, 1.0, (5.0, 5.0), 1.0, 3)
        if terminated:
            break


@everyone
def test_noise_and_dropout_come_from_the_seed(name):
    options = {"lidar": {"noise": 4.0, "dropout": 0.1}}
    env = made(name, **options)
    first, second = (env.reset(seed=s)[0] for s in (5, 5))
    np.testing.assert_array_equal(first, second)
    clean = made(name)
    lidar = env.OBSERVATION["lidar"]
    assert not np.array_equal(clean.reset(seed=5)[0][lidar], first[lidar])
    np.testing.assert_array_equal(clean.reset(seed=5)[0][24:], first[24:])
    # what is observed elsewhere has no noise: it may draw nothing
    here = env.observe_at(*env.pose, env.velocity, env.turn, 0)
    np.testing.assert_array_equal(here, clean.reset(seed=5)[0])
