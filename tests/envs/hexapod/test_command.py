import numpy as np
import pytest

from spikedeploy.envs.hexapod.command import FOLLOWED, HOLD, HexapodCommandEnv, draw_command

STILL = np.zeros(18)


@pytest.fixture(scope="module")
def env():
    return HexapodCommandEnv()


def run(env, seed, steps=1000):
    env.reset(seed=seed)
    infos = []
    for _ in range(steps):
        _, _, terminated, truncated, info = env.step(STILL)
        infos.append(info)
        if terminated or truncated:
            break
    return infos


@pytest.fixture(scope="module")
def walks(env):
    return [run(env, seed) for seed in range(4)]


def test_commands_are_within_reach_of_the_outer_legs():
    rng = np.random.default_rng(0)
    commands = np.array([draw_command(rng) for _ in range(4000)])
    speed, turn = np.abs(commands).T
    assert commands[:, 0].min() < -0.24
    assert commands[:, 0].max() > 0.44
    assert turn.max() > 0.75
    assert turn.max() <= 0.8
    assert (speed + 0.2 * turn <= 0.5 + 1e-12).all()


def test_a_command_is_held_for_two_to_four_seconds(walks):
    for infos in walks:
        commands = np.array([(info["command_speed"], info["command_turn"]) for info in infos])
        changes = np.flatnonzero((np.diff(commands, axis=0) != 0.0).any(axis=1)) + 1
        held = np.diff([0, *changes])
        assert held.min() >= HOLD[0]
        # two commands to stand in a row look like one
        assert held.max() <= 2 * HOLD[1]


def test_the_observed_command_is_the_one_that_the_next_step_is_scored_by(env):
    observation, _ = env.reset(seed=3)
    for _ in range(450):
        seen = observation[env.OBSERVATION["command"]] * [0.45, 0.8]
        observation, _, _, _, info = env.step(STILL)
        np.testing.assert_allclose(seen, [info["command_speed"], info["command_turn"]], atol=1e-12)


def test_the_gait_alone_neither_falls_nor_follows(walks):
    assert not any(infos[-1]["fall"] for infos in walks)
    assert all(len(infos) == 1000 for infos in walks)
    returns = [infos[-1]["episode_return"] for infos in walks]
    assert 300.0 < np.mean(returns) < 1600.0
    assert not any(infos[-1]["success"] for infos in walks)


def test_success_is_an_rmse_below_a_fifth_of_the_largest_command_in_speed_and_turn(walks):
    assert pytest.approx([0.45 / 5, 0.8 / 5]) == FOLLOWED
    followed = []
    for infos in walks:
        errors = np.array([(info["speed_error"], info["turn_error"]) for info in infos])
        steps = np.arange(1, len(errors) + 1)[:, None]
        rmse = np.sqrt(np.cumsum(errors**2, axis=0) / steps)
        followed += (rmse < FOLLOWED).all(axis=1).tolist()
    assert followed == [info["success"] for infos in walks for info in infos]
    assert 0 < sum(followed) < len(followed)


def test_a_fall_is_no_success_however_well_it_followed(env):
    env.reset(seed=0)
    env.steer(0.0, 0.0)
    assert env.step(STILL)[-1]["success"]
    env.LOWEST_HEIGHT = 1.0  # of this copy: wherever it stands, it has fallen
    try:
        _, _, terminated, _, info = env.step(STILL)
    finally:
        del env.LOWEST_HEIGHT
    assert terminated
    assert abs(info["speed_error"]) < FOLLOWED[0]
    assert not info["success"]


def test_a_steered_robot_keeps_the_command_that_its_legs_can_follow(env):
    env.reset(seed=3)
    env.steer(0.4, -2.0)
    for _ in range(HOLD[1] + 1):
        _, _, _, _, info = env.step(STILL)
        assert (info["command_speed"], info["command_turn"]) == pytest.approx((0.4, -0.5))
    assert env.command == pytest.approx((0.4, -0.5))
