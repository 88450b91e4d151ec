import math

import numpy as np
import pytest

from spikedeploy.envs.hexapod.env import HexapodEnv
from spikedeploy.runtime.errors import EnvError

STILL = np.zeros(18)


@pytest.fixture(scope="module")
def env():
    return HexapodEnv()


def episode(env, seed, act=lambda _: STILL):
    observation, _ = env.reset(seed=seed)
    while True:
        observation, _, terminated, truncated, info = env.step(act(observation))
        if terminated or truncated:
            return info, terminated


@pytest.fixture(scope="module")
def walks(env):
    return [episode(env, seed) for seed in range(4)]


def test_the_gait_alone_walks_slowly_and_never_falls(walks):
    assert not any(fell for _, fell in walks)
    speed = np.mean([info["distance"] / 20.0 for info, _ in walks])
    assert speed == pytest.approx(0.155, abs=0.015)


def test_the_gait_alone_costs_about_as_much_as_an_insect_of_its_size(walks):
    assert np.mean([info["cot"] for info, _ in walks]) == pytest.approx(1.2, abs=0.15)


def test_the_same_seed_gives_the_same_bits_whatever_came_before(env):
    fresh = HexapodEnv()
    episode(env, 3, lambda _: np.full(18, 0.4))
    rng, twin = np.random.default_rng(0), np.random.default_rng(0)
    first, _ = env.reset(seed=42)
    second, _ = fresh.reset(seed=42)
    np.testing.assert_array_equal(first, second)
    for _ in range(150):
        first, reward, *_ = env.step(rng.uniform(-1.0, 1.0, 18))
        second, twin_reward, *_ = fresh.step(twin.uniform(-1.0, 1.0, 18))
        np.testing.assert_array_equal(first, second)
        assert reward == twin_reward


def test_terms_sum_to_the_reward_and_rewards_to_the_return(env):
    rng = np.random.default_rng(0)
    env.reset(seed=5)
    total = 0.0
    for _ in range(100):
        _, reward, _, _, info = env.step(rng.uniform(-1.0, 1.0, 18))
        assert sum(info["reward_terms"].values()) == pytest.approx(reward, abs=1e-9)
        total += reward
    assert info["episode_return"] == pytest.approx(total, abs=1e-9)


def test_servos_get_six_tenths_of_the_new_command_and_four_of_the_last(env):
    env.reset(seed=0)
    action = np.linspace(-1.0, 1.0, 18)
    filtered = np.zeros(18)
    for _ in range(3):
        command = env._gait.command() + 0.5 * action
        filtered = 0.6 * command + 0.4 * filtered
        observation, *_ = env.step(action)
        np.testing.assert_allclose(observation[env.OBSERVATION["previous"]], filtered, atol=1e-12)
        np.testing.assert_allclose(
            env._robot.data.ctrl, np.tile([0.0, 0.35, -1.45], 6) + 0.6 * filtered, atol=1e-12
        )


@pytest.mark.parametrize("wrong", [np.zeros(17), np.zeros((1, 18)), np.full(18, np.nan)])
def test_an_invalid_action_is_refused_with_its_step(env, wrong):
    env.reset(seed=0)
    env.step(STILL)
    with pytest.raises(EnvError, match="action of step 1"):
        env.step(wrong)


def test_success_needs_the_return_and_the_feet(env):
    env.reset(seed=0)
    env._return = 2600.0
    assert env.step(STILL)[4]["success"]
    env._robot.data.qpos[3:7] = [0.0, 1.0, 0.0, 0.0]
    assert not env.step(STILL)[4]["success"]


def test_the_support_force_is_off_until_training_raises_it(env):
    env.reset(seed=0)
    assert env.support_force == 0.0
    env.support_force = 0.5
    try:
        for _ in range(50):
            observation, *_ = env.step(STILL)
        assert observation[env.OBSERVATION["load"]][0] < 0.9
    finally:
        env.support_force = 0.0
    with pytest.raises(EnvError, match="support_force"):
        env.support_force = 1.5


def test_the_first_push_comes_after_two_to_five_seconds(env):
    calm = HexapodEnv(pushes=0.0)
    env.reset(seed=0)
    calm.reset(seed=0)
    same = [np.array_equal(env.step(STILL)[0], calm.step(STILL)[0]) for _ in range(260)]
    assert 100 <= same.index(False) <= 250


def test_a_simulation_that_diverges_is_an_error(env):
    env.reset(seed=0)
    env._robot.data.qvel[3] = np.nan
    with pytest.raises(EnvError, match="diverged"):
        env.step(STILL)


@pytest.mark.parametrize(
    ("option", "wrong"),
    [
        ("terrain", 0.5),
        ("pushes", -1.0),
        ("pushes", (0.0, 1.0)),
        ("mass", (1.1, 0.9)),
        ("payload", 50.0),
        ("friction", 0.0),
        ("servo_gain", math.nan),
        ("max_steps", 0),
        ("render_mode", "ascii"),
    ],
)
def test_a_wrong_option_is_refused_by_name(option, wrong):
    with pytest.raises(EnvError, match=option):
        HexapodEnv(**{option: wrong})


def test_drawing_needs_a_render_mode(env):
    env.reset(seed=0)
    with pytest.raises(EnvError, match="render_mode"):
        env.render()
