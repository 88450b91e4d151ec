"""Hexapod-v0: episodes, rewards, pushes and options."""

import math

import numpy as np
import pytest

from spikedeploy.envs.hexapod.env import (
    HexapodEnv,
    Pushes,
    PushTable,
    check,
    command_terms,
    course_terms,
    kernel,
    regularisers,
    sample,
)
from spikedeploy.envs.hexapod.robot import Motion
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


RESTING = Motion(
    position=(0.0, 0.0, 0.1),
    gravity=(0.0, 0.0, -1.0),
    heading=0.0,
    velocity=(0.0, 0.0, 0.0),
    body_velocity=(0.0, 0.0, 0.0),
    angular_velocity=(0.0, 0.0, 0.0),
    joints=np.zeros(18),
    joint_velocity=np.zeros(18),
    load=np.zeros(6),
    contact=np.zeros(6, bool),
    slip=0.0,
    power=0.0,
    mean_power=0.0,
)


def test_the_kernel_by_hand():
    # 1 at no error, 0 at one width, then a quarter as steep: -1/4 at two widths, -1 from five on
    assert kernel(0.0, 0.3) == 1.0
    assert kernel(0.15, 0.3) == pytest.approx(0.5)
    assert kernel(-0.3, 0.3) == pytest.approx(0.0)
    assert kernel(0.6, 0.3) == pytest.approx(-0.25)
    assert kernel(-1.5, 0.3) == pytest.approx(-1.0)
    assert kernel(9.0, 0.3) == -1.0


def test_the_course_pays_four_a_step_at_most():
    assert sum(course_terms(0.40, 0.0, 0.0).values()) == pytest.approx(4.0)


@pytest.mark.parametrize(("speed", "paid"), [(0.0, 0.0), (0.2, 1.5), (0.6, 1.5), (2.0, -3.0)])
def test_too_fast_is_paid_like_too_slow(speed, paid):
    assert course_terms(speed, 0.0, 0.0)["speed"] == pytest.approx(paid)


def test_leaving_the_course_costs_half_a_point_at_most_each_way():
    terms = course_terms(0.4, -0.2, 7.0)
    assert terms["heading"] == pytest.approx(-0.1)
    assert terms["lateral"] == pytest.approx(-0.5)


def test_commands_pay_five_and_a_half_a_step_at_most():
    assert sum(command_terms(0.0, 0.0, 0.0).values()) == pytest.approx(5.5)
    terms = command_terms(0.06, -0.15, -0.2)
    assert list(terms.values()) == pytest.approx([1.0, 1.25, 1.0, -0.1])


def test_every_regulariser_by_hand():
    moving = RESTING._replace(
        gravity=(0.1, -0.2, -0.97),
        velocity=(0.4, 0.0, -0.3),
        angular_velocity=(1.0, 2.0, 9.0),
        slip=0.1,
        power=8.0,
        mean_power=99.0,
    )
    terms = regularisers(moving, 0.07, 0.09, np.full(18, 0.5), 0.02)
    assert terms == pytest.approx(
        {
            "tilt": -2.0 * 0.05,
            "jerk": -0.02 * 18 * 0.25,
            "power": -0.2,
            "bounce": -0.15,
            "slip": -0.05,
            "wobble": -0.1,
            "crouch": -0.1,
        }
    )


TABLE = PushTable(kick=(0.1, 0.2), spin=0.5, interval=(10, 20))


def schedule(scale, seed=0, steps=500):
    rng = np.random.default_rng(seed)
    pushes = Pushes(TABLE, scale)
    pushes.reset(rng)
    found = ((step, pushes.due(step, rng)) for step in range(steps))
    return [(step, push) for step, push in found if push is not None]


def test_pushes_come_at_the_stated_intervals_and_strengths():
    found = schedule(1.0)
    gaps = np.diff([0, *(step for step, _ in found)])
    assert gaps.min() >= 10
    assert gaps.max() <= 20
    speeds = [math.hypot(*kick) for _, (kick, _) in found]
    assert min(speeds) >= 0.1
    assert max(speeds) <= 0.2


def test_scale_zero_keeps_the_schedule_and_removes_the_force():
    full, none = schedule(1.0), schedule(0.0)
    assert [step for step, _ in full] == [step for step, _ in none]
    assert all(push == ((0.0, 0.0), 0.0) for _, push in none)


def test_a_number_is_kept_and_a_pair_is_drawn_from():
    rng = np.random.default_rng(0)
    assert sample(0.7, rng) == 0.7
    drawn = [sample((0.5, 1.0), rng) for _ in range(200)]
    assert 0.5 <= min(drawn) < 0.55
    assert 0.95 < max(drawn) <= 1.0


@pytest.mark.parametrize("wrong", [-0.1, 3.0, (0.5, 0.2), (0.0, 9.0), math.nan, math.inf])
def test_an_option_out_of_range_is_refused_with_its_name_and_limits(wrong):
    with pytest.raises(EnvError, match=r"option payload: .*from 0 to 2"):
        check("payload", wrong, 0.0, 2.0)


@pytest.mark.parametrize("wrong", ["rough", None, (1.0,), (0.1, 0.2, 0.3), ("a", "b"), True])
def test_an_option_that_is_no_number_is_refused(wrong):
    with pytest.raises(EnvError, match="option terrain"):
        check("terrain", wrong, 0.0, 2.0)
