"""What karts are paid: sums that telescope, and kart-simulator's terms in numbers."""

import math

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.kart.env import PathReward, StepOutcome
from spikedeploy.envs.kart.gap import GapDriver
from spikedeploy.envs.kart.karts import KartGazeboEnv, KartGridEnv, KartSteerEnv
from spikedeploy.envs.kart.track import Track, segments

KARTS = ("kart-grid", "kart-gazebo", "kart-steer")
FORWARD = {"kart-grid": 4, "kart-gazebo": 1, "kart-steer": 1}
everyone = pytest.mark.parametrize("name", KARTS)
REST = StepOutcome(
    gained=0.0, approach=0.0, gates=0, since=0, finish=False, failed=False, speed=0.0, steering=0
)


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
    env = envs.make(name).unwrapped
    rng = np.random.default_rng(0)
    for preset in ("default", "classic"):
        env = envs.make(name, preset=preset).unwrapped
        _, steps = episode(env, 1, lambda _, env=env: int(rng.integers(env.action_space.n)))
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
    terms = reward.terms(REST._replace(gained=50.0, gates=1))
    assert terms == {"progress": 0.5, "gate": 2.0, "finish": 0.0, "crash": 0.0, "time": 0.0}


# -- classic: kart-simulator's numbers


@pytest.mark.parametrize(
    ("kind", "speed", "expected"),
    [(KartGridEnv, 400.0, 0.38), (KartGazeboEnv, 440.0, 0.75), (KartSteerEnv, 599.0, 12.5)],
)
def test_classic_progress_at_full_speed_is_kart_simulators(kind, speed, expected):
    outcome = REST._replace(approach=speed / 60, speed=speed)
    assert kind.CLASSIC.terms(outcome)["progress"] == pytest.approx(expected, rel=0.01)


def test_a_classic_grid_kart_pays_half_more_for_going_back():
    back, forth = (
        KartGridEnv.CLASSIC.terms(REST._replace(approach=way, speed=100.0))["progress"]
        for way in (-1.0, 1.0)
    )
    assert back == pytest.approx(-1.5 * forth)


@pytest.mark.parametrize(
    ("since", "expected"), [(0, 365.5), (50, 221.7), (100, 134.5), (200, 49.5), (500, 2.46)]
)
def test_a_classic_gate_pays_less_the_longer_it_took(since, expected):
    outcome = REST._replace(gates=1, since=since)
    assert KartGridEnv.CLASSIC.terms(outcome)["gate"] == pytest.approx(expected, rel=2e-3)
    assert KartGazeboEnv.CLASSIC.terms(outcome)["gate"] == pytest.approx(2 * expected, rel=2e-3)


@pytest.mark.parametrize(("kind", "crash"), [(KartGridEnv, -500), (KartGazeboEnv, -1000),
                                             (KartSteerEnv, -500)])  # fmt: skip
def test_classic_ends_pay_kart_simulators_sums_once(kind, crash):
    assert kind.CLASSIC.terms(REST._replace(failed=True))["crash"] == crash
    assert kind.CLASSIC.terms(REST._replace(finish=True))["finish"] == 500_000


def test_classic_steering_counts_by_the_side_of_the_gate():
    env = envs.make("kart-steer", preset="classic", start="fixed").unwrapped
    env.reset(seed=0)
    right, left = env.ACTIONS.index("right"), env.ACTIONS.index("left")
    # the first gate's middle is ahead, 5 px down: a little to the right
    assert env.step(right)[4]["reward_terms"]["steer"] == pytest.approx(0.07)
    assert env.step(right)[4]["reward_terms"]["steer"] == pytest.approx(-0.14)
    assert env.step(left)[4]["reward_terms"]["steer"] == pytest.approx(0.07)


@pytest.mark.parametrize(("name", "steps"), [("kart-gazebo", 100), ("kart-steer", 120)])
def test_classic_karts_may_stand_still_as_long_as_in_kart_simulator(name, steps):
    env = envs.make(name, preset="classic").unwrapped
    _, done = episode(env, 0, lambda _: 0)
    assert len(done) == steps
    assert done[-1][2]["stalled"]


@pytest.mark.parametrize(("name", "action"), [("kart-grid", "left"), ("kart-steer", "accelerate")])
def test_classic_karts_that_move_away_from_the_gate_are_stopped_after_30_steps(name, action):
    corners = 2000.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    gate = np.array([[[900.0, -50.0], [900.0, 50.0]]])
    away = (math.pi, math.pi)
    course = Track("hall", segments([corners]), gate, np.zeros(2), 0.0, away, 0.0, (corners,))
    env = envs.make(name, preset="classic", track=course).unwrapped
    _, steps = episode(env, 0, lambda _: env.ACTIONS.index(action))
    assert len(steps) == 30
    assert steps[-1][2]["stalled"]
    assert steps[-1][1]["crash"] == -500.0
