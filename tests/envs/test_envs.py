"""What every environment in the table must keep."""

import functools
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from spikedeploy import envs
from spikedeploy.runtime.errors import EnvError
from tests.paths import ROOT

WALKERS = ("hexapod", "hexapod-command")
KARTS = ("kart-grid", "kart-gazebo", "kart-steer")
everyone = pytest.mark.parametrize("name", envs.ENVS)
walkers = pytest.mark.parametrize("name", WALKERS)
WALK_INFO = {"episode_return", "fall"}
DRIVE_INFO = {"finish", "crash", "stalled", "gates", "lap_time", "x", "y", "heading", "speed"}
INFO = dict.fromkeys(WALKERS, WALK_INFO) | dict.fromkeys(KARTS, DRIVE_INFO)
TASK_INFO = {"reward_terms", "success"}


def action_of(name, value=0.0):
    """The same action in all 18 joints, or a kart's first one that does something."""
    return np.full(18, value) if name in WALKERS else 1


@everyone
def test_gymnasiums_checker_passes(name):
    check_env(envs.make(name).unwrapped, skip_render_check=True)


@everyone
def test_the_id_and_the_short_name_make_the_same_environment(name):
    entry = envs.spec(name)
    assert envs.spec(entry.id) is entry
    assert entry.short == name
    module, _, attribute = entry.target.partition(":")
    kind = getattr(sys.modules.get(module) or __import__(module, fromlist=["_"]), attribute)
    assert type(gymnasium.make(entry.id).unwrapped) is kind
    assert type(envs.make(name).unwrapped) is kind


@everyone
def test_the_layout_names_every_value_once(name):
    env = envs.make(name).unwrapped
    places = list(env.OBSERVATION.values())
    assert places[0].start == 0
    assert [place.start for place in places[1:]] == [place.stop for place in places[:-1]]
    assert places[-1].stop == env.observation_space.shape[0]


@walkers
def test_the_observed_phase_is_sine_and_cosine(name):
    env = envs.make(name).unwrapped
    observation, _ = env.reset(seed=0)
    for _ in range(5):
        sine, cosine = observation[env.OBSERVATION["phase"]]
        assert sine == pytest.approx(np.sin(env._gait.phase))
        assert cosine == pytest.approx(np.cos(env._gait.phase))
        observation, *_ = env.step(np.zeros(18))


@everyone
def test_random_actions_keep_to_the_declared_spaces(name):
    env = envs.make(name)
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    assert observation.dtype == np.float64
    for _ in range(100):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation)
        assert type(reward) is float
        assert type(terminated) is bool
        assert type(truncated) is bool
        assert info.keys() >= TASK_INFO | INFO[name]
        if terminated or truncated:
            env.reset()


@everyone
def test_an_observation_is_not_overwritten_by_the_next_step(name):
    env = envs.make(name)
    observation, _ = env.reset(seed=0)
    kept = observation.copy()
    env.step(action_of(name, 1.0))
    np.testing.assert_array_equal(observation, kept)


@everyone
def test_vector_environments_agree_with_a_single_one(name):
    single = envs.make(name)
    vector = gymnasium.vector.SyncVectorEnv([functools.partial(envs.make, name)] * 2)
    observation, _ = single.reset(seed=6)
    observations, _ = vector.reset(seed=[5, 6])
    np.testing.assert_array_equal(observations[1], observation)
    for _ in range(20):
        observation, reward, *_ = single.step(action_of(name, 0.05))
        observations, rewards, *_ = vector.step(np.stack([action_of(name, 0.05)] * 2))
    np.testing.assert_array_equal(observations[1], observation)
    assert rewards[1] == reward
    vector.close()


@walkers
def test_a_frame_shows_the_robot(name):
    env = envs.make(name, render_mode="rgb_array")
    env.reset(seed=0)
    try:
        first = env.render()
    except EnvError as error:
        pytest.skip(f"this machine cannot draw: {error}")
    for _ in range(40):
        env.step(np.zeros(18))
    second = env.render()
    env.reset(seed=1)
    third = env.render()
    env.close()
    assert first.shape == (480, 640, 3)
    assert first.dtype == np.uint8
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 500
    assert not np.array_equal(first, second)
    assert not np.array_equal(first, third)


def test_the_table_is_read_without_loading_the_physics():
    code = (
        "import sys; from spikedeploy import envs; envs.spec('hexapod'); "
        "sys.exit(bool({'mujoco', 'pymunk', 'pygame'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
