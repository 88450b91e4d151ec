"""Karts: dynamics in numbers, the course of an episode, observations and rewards."""

import itertools
import math

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.kart.env import PathReward
from spikedeploy.envs.kart.gap import GapDriver
from spikedeploy.envs.kart.karts import KartSteerEnv
from spikedeploy.envs.kart.track import Track, segments
from spikedeploy.envs.kart.world import KartState
from spikedeploy.runtime.errors import EnvError

KARTS = ("kart-grid", "kart-gazebo", "kart-steer")
everyone = pytest.mark.parametrize("name", KARTS)
DT = 1 / 60


def hall(gates=((9000.0, -400.0, 9000.0, 400.0),), size=10_000.0, heading=(0.0, 0.0)):
    """A hall so large that nothing is near, with its gates far to the right."""
    corners = size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]], float)
    return Track(
        name="hall",
        walls=segments([corners]),
        gates=np.array(gates, float).reshape(-1, 2, 2),
        start=np.zeros(2),
        spread=0.0,
        heading=heading,
    )


def kart(name, **options):
    """A kart at rest in the middle of the hall, looking to the right."""
    env = envs.make(name, **{"track": hall(), **options}).unwrapped
    env.reset(seed=0)
    return env


def do(env, name, times=1):
    for _ in range(times):
        result = env.step(env.ACTIONS.index(name))
    return result


def driven(env, seed):
    """The infos of an episode of the gap driver."""
    driver = GapDriver.for_env(env)
    observation, info = env.reset(seed=seed)
    infos, over = [info], False
    while not over:
        observation, _, terminated, truncated, info = env.step(int(driver.act(observation)))
        infos.append(info)
        over = terminated or truncated
    return infos


# -- grid


def test_a_grid_kart_is_at_400_px_s_after_23_steps_and_not_before():
    env = kart("kart-grid")
    speeds = [do(env, "right")[4]["speed"] for _ in range(23)]
    assert speeds[21] < 400 <= speeds[22]
    # v = (v + 30) / 1.05 from rest: 600 (1 - 1.05^-n)
    assert speeds[9] == pytest.approx(600 * (1 - 1.05**-10))


def test_no_push_acts_at_400_px_s_not_even_one_that_brakes():
    env = kart("kart-grid")
    fast = do(env, "right", 23)[4]["speed"]
    assert do(env, "left")[4]["speed"] == pytest.approx(fast / 1.05)
    assert do(env, "left")[4]["speed"] == pytest.approx((fast / 1.05 - 30) / 1.05)


# -- gazebo


def test_a_gazebo_kart_moves_a_step_after_its_command():
    env = kart("kart-gazebo")
    assert do(env, "forward")[4]["x"] == 0.0
    assert env.speed == pytest.approx(440.0)
    assert do(env, "forward")[4]["x"] == pytest.approx(440 / 60)
    assert do(env, "stop")[4]["x"] == pytest.approx(2 * 440 / 60)
    assert do(env, "stop")[4]["x"] == pytest.approx(2 * 440 / 60)
    assert env.speed == 0.0


def test_a_gazebo_kart_turns_by_0_0947_rad_a_step_clockwise_to_the_right():
    env = kart("kart-gazebo")
    assert do(env, "right")[4]["heading"] == 0.0
    assert do(env, "right")[4]["heading"] == pytest.approx(5.68 / 60)
    do(env, "left")
    assert do(env, "left")[4]["heading"] == pytest.approx(5.68 / 60)


# -- steer


def test_a_steer_kart_is_at_599_px_s_after_103_steps_and_not_before():
    env = kart("kart-steer")
    speeds = [do(env, "accelerate")[4]["speed"] for _ in range(104)]
    assert speeds[0] == pytest.approx(7.488 / 1.005)
    assert speeds[101] < 599 <= speeds[102]
    assert speeds[103] < speeds[102]  # no throttle above the top speed


def test_a_steer_kart_has_no_lateral_slip():
    env = kart("kart-steer")
    do(env, "accelerate", 40)
    for name in ["right", "accelerate", "left", "left", "brake"] * 6:
        do(env, name)
        vx, vy = env.velocity
        heading = env.pose[2]
        assert vx * math.sin(heading) - vy * math.cos(heading) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "action"),
    [("none", (0, 0)), ("accelerate", (1, 0)), ("brake", (-1, 0)), ("left", (0, -1)),
     ("right", (0, 1))],
)  # fmt: skip
def test_full_continuous_actions_do_what_discrete_ones_do(name, action):
    one, other = kart("kart-steer"), kart("kart-steer", actions="continuous")
    do(one, "accelerate", 20)
    for _ in range(20):
        other.step(np.array([1.0, 0.0]))
    do(one, name)
    other.step(np.array(action, float))
    np.testing.assert_allclose(one.pose, other.pose)
    np.testing.assert_allclose(one.velocity, other.velocity)


# -- episodes


@everyone
def test_a_wall_ends_the_episode_when_the_rim_touches_it(name):
    start = np.array([[[100.0, -90.0], [100.0, 90.0]]])
    walls = np.concatenate([hall().walls, start])
    course = Track("t", walls, hall().gates, np.zeros(2), 0.0, (0.0, 0.0))
    env = kart(name, track=course)
    forward = {"kart-grid": "right", "kart-gazebo": "forward", "kart-steer": "accelerate"}[name]
    for _ in range(200):
        before = env.pose[0]
        _, _, terminated, truncated, info = do(env, forward)
        if terminated:
            break
    assert before + 19.2 < 100.0 <= info["x"] + 19.2
    assert (info["crash"], info["finish"], info["success"], info["stalled"], truncated) == (
        True, False, False, False, False,
    )  # fmt: skip


@everyone
def test_gates_count_when_the_rim_touches_them_and_the_last_one_is_the_finish(name):
    gates = ((60.0, -50.0, 60.0, 50.0), (150.0, -50.0, 150.0, 50.0))
    env = kart(name, track=hall(gates))
    forward = {"kart-grid": "right", "kart-gazebo": "forward", "kart-steer": "accelerate"}[name]
    passed = []
    for steps in itertools.count(1):  # noqa: B007
        before = env.pose[0]
        _, _, terminated, truncated, info = do(env, forward)
        if info["gates"] > len(passed):
            passed.append((before, info["x"]))
        if terminated:
            break
    for (before, after), place in zip(passed, (60.0, 150.0), strict=True):
        assert before + 19.2 < place <= after + 19.2
    assert info["finish"]
    assert info["success"]
    assert not info["crash"]
    assert not truncated
    assert info["lap_time"] == pytest.approx(steps / 60)
    assert info["progress"] == 1.0


def test_a_gate_that_is_touched_already_counts_once_it_is_next():
    # the kart stands on gate 2 when it reaches gate 1
    gates = ((40.0, -50.0, 40.0, 50.0), (35.0, -50.0, 35.0, 50.0), (900.0, -50.0, 900.0, 50.0))
    env = kart("kart-gazebo", track=hall(gates))
    counts = [do(env, "forward")[4]["gates"] for _ in range(6)]
    assert sorted(set(counts)) == [0, 2]


def test_crash_and_finish_in_one_step_is_a_finish():
    line = np.array([[[100.0, -90.0], [100.0, 90.0]]])
    course = Track("t", np.concatenate([hall().walls, line]), line, np.zeros(2), 0.0, (0.0, 0.0))
    env = kart("kart-gazebo", track=course)
    info = do(env, "forward", 13)[4]
    assert info["finish"]
    assert not info["crash"]


@everyone
def test_standing_still_for_two_seconds_is_a_failure(name):
    env = kart(name)
    for step in range(1, 121):
        _, _, terminated, truncated, info = env.step(0)
        assert (terminated, truncated) == (step == 120, False)
    assert info["stalled"]
    assert not info["success"]
    assert info["reward_terms"]["crash"] == -5.0


@everyone
def test_a_kart_that_makes_progress_is_truncated_and_that_is_no_failure(name):
    env = kart(name, max_steps=40)
    forward = {"kart-grid": "right", "kart-gazebo": "forward", "kart-steer": "accelerate"}[name]
    *_, terminated, truncated, info = do(env, forward, 39)
    assert not terminated
    assert not truncated
    _, _, terminated, truncated, info = do(env, forward)
    assert (terminated, truncated) == (False, True)
    assert not any(info[key] for key in ("success", "finish", "crash", "stalled"))


@everyone
def test_the_same_seed_gives_the_same_drive_and_another_one_another(name):
    env, other = envs.make(name).unwrapped, envs.make(name).unwrapped
    driven(other, 3)  # what was before does not matter
    first, second = driven(env, 7), driven(other, 7)
    assert first == second
    assert driven(env, 8) != first


@everyone
def test_starts_fill_the_spread_and_the_headings(name):
    env = envs.make(name).unwrapped
    infos = [env.reset(seed=seed)[1] for seed in range(200)]
    offsets = np.array([(info["x"] - 150, info["y"] - 200) for info in infos])
    assert np.abs(offsets).max() <= 50
    assert (offsets.max(axis=0) > 45).all()
    assert (offsets.min(axis=0) < -45).all()
    headings = np.array([info["heading"] for info in infos])
    if name == "kart-grid":
        assert not headings.any()
    else:
        assert headings.min() < -1.4
        assert 1.4 < headings.max() <= math.pi / 2


def test_a_picture_needs_a_render_mode():
    with pytest.raises(EnvError, match='render_mode="rgb_array"'):
        kart("kart-steer").render()


# -- bad input


@everyone
@pytest.mark.parametrize("action", [-1, 5, 1.0, np.float64(2.0), [0], "up", None, True])
def test_an_action_that_is_none_of_the_karts_is_refused(name, action):
    env = kart(name)
    with pytest.raises(
        EnvError, match=f"is none of the .* of this kart: 0 to .*, {env.ACTIONS[0]}"
    ):
        env.step(action)


@pytest.mark.parametrize("action", [0, [0.0], [0.0, math.nan], [0.0, 0.0, 0.0]])
def test_a_continuous_action_of_another_form_is_refused(action):
    with pytest.raises(EnvError, match="two finite numbers are needed, throttle and steering"):
        kart("kart-steer", actions="continuous").step(action)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": "middle"}, "start 'middle' is unknown; known: 'random', 'fixed'"),
        ({"render_mode": "ansi"}, "render_mode 'ansi' is unknown"),
        ({"max_steps": 0}, "max_steps must be a whole number from 1, found 0"),
        ({"max_steps": 10.5}, "max_steps must be a whole number from 1, found 10.5"),
        ({"track": "big_s"}, "unknown track 'big_s'; did you mean 'big_S'"),
        ({"observe": ["sonar"]}, "unknown component 'sonar'; known: lidar, position"),
        ({"observe": ["lidar", "lidar"]}, "name each component once"),
        ({"observe": []}, "nothing: name each component once"),
        ({"lidar": {"rays": 3}}, "lidar.rays is unknown"),
        ({"lidar": {"count": 0}}, "lidar.count: 0"),
        ({"reward": "none"}, "reward 'none': give weights by name"),
        ({"reward": {"style": 1.0}}, "unknown term 'style'; known: progress, gate, finish"),
        ({"reward": {"time": "much"}}, "the weight of time is 'much', not a finite number"),
        ({"actions": "analog"}, "actions 'analog' is unknown; known: 'discrete', 'continuous'"),
    ],
)
def test_an_invalid_option_is_refused_in_one_line(options, message):
    with pytest.raises(EnvError) as caught:
        KartSteerEnv(**options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@everyone
def test_a_picture_shows_the_kart_move(name):
    env = envs.make(name, render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    assert first.ndim == 3
    assert first.dtype == np.uint8
    for _ in range(20):
        env.step(1)
    assert not np.array_equal(env.render(), first)


# -- what karts observe


def made(name, **options):
    env = envs.make(name, **options).unwrapped
    env.reset(seed=0)
    return env


def observed(env, x, y, heading, velocity, turn, next_gate):
    """The observation of a state."""
    state = KartState(x, y, heading, velocity, turn, next_gate)
    return env._observe(state, env.lidar.distances(x, y, heading))


@everyone
def test_the_position_is_relative_to_the_tracks_own_box(name):
    for course in ("big_S", "small_S"):
        env = made(name, track=course)
        left, top, right, bottom = env.track.box
        place = env.OBSERVATION["position"]
        corner = observed(env, left, top, 0.0, (0.0, 0.0), 0.0, 0)[place]
        middle = observed(env, (left + right) / 2, bottom, 0.0, (0.0, 0.0), 0.0, 0)[place]
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
    seen = observed(env, 300.0, 200.0, 0.0, velocity, turn, 0)
    np.testing.assert_allclose(seen[env.OBSERVATION["velocity"]], expected, atol=1e-4)


def test_the_next_gate_is_observed_relative_to_the_heading():
    env = made("kart-steer", observe=["gate"], lidar={"range": 400.0})
    # the middle of gate 1 is at (448, 205)
    seen = observed(env, 448.0, 105.0, math.pi / 2, (0.0, 0.0), 0.0, 0)
    np.testing.assert_allclose(seen, [1, 0, 0.5], atol=1e-12)
    seen = observed(env, 348.0, 205.0, math.pi / 2, (0.0, 0.0), 0.0, 0)
    np.testing.assert_allclose(seen, [0, -1, 0.5], atol=1e-12)
    far = observed(env, 448.0, 905.0, 0.0, (0.0, 0.0), 0.0, 0)
    assert far[2] == -1.0


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
    here = observed(env, *env.pose, env.velocity, env.turn, 0)
    np.testing.assert_array_equal(here, clean.reset(seed=5)[0])


# -- what karts are paid


def episode(env, seed, choose):
    """Info of the start, and (reward, terms, info) of every step."""
    observation, first = env.reset(seed=seed)
    steps, over = [], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(choose(observation))
        steps.append((reward, info["reward_terms"], info))
        over = terminated or truncated
    return first, steps


def total(steps, term):
    return sum(terms[term] for _, terms, _ in steps)


@everyone
def test_the_reward_is_the_sum_of_its_terms(name):
    env, rng = envs.make(name).unwrapped, np.random.default_rng(0)
    _, steps = episode(env, 1, lambda _: int(rng.integers(env.action_space.n)))
    for reward, terms, _ in steps:
        assert reward == pytest.approx(sum(terms.values()))


@everyone
def test_progress_of_a_lap_sums_to_the_path_from_its_start(name):
    env = envs.make(name).unwrapped
    driver = GapDriver.for_env(env)
    first, steps = episode(env, 10_000, lambda seen: int(driver.act(seen)))
    assert steps[-1][2]["finish"]
    way = env.track.remaining(first["x"], first["y"], 0)
    assert total(steps, "progress") == pytest.approx(way / 100)
    assert total(steps, "finish") == 10.0
    assert total(steps, "crash") == 0.0
    assert total(steps, "time") == pytest.approx(-0.01 * len(steps))


def test_weights_are_changed_by_name_and_the_others_stay():
    reward = PathReward({"gate": 2.0, "time": 0})
    terms = reward.terms(gained=50.0, gates=1, finish=False, failed=False)
    assert terms == {"progress": 0.5, "gate": 2.0, "finish": 0.0, "crash": 0.0, "time": 0.0}
