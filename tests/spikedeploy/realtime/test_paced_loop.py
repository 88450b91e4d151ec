"""`run --rate`: the closed loop by the clock, its deadlines, and options that make no sense."""

import gc
import json
import math
import time

import gymnasium
import numpy as np
import pytest

from spikedeploy.comparison.evaluation import run_policy
from spikedeploy.realtime.paced_loop import Metronome, PacedLoop, Pacing, duration, pacing
from spikedeploy.runtime.errors import ConfigError


class Counting(gymnasium.Env):
    """An environment of so many steps, of which each takes so long."""

    observation_space = gymnasium.spaces.Box(-1, 1, (1,))
    action_space = gymnasium.spaces.Box(-1, 1, (1,))

    def __init__(self, steps, takes=0.0):
        self.steps, self.takes = steps, takes

    def reset(self, *, seed=None, options=None):
        self.left = self.steps
        return np.zeros(1), {}

    def step(self, action):
        time.sleep(self.takes)
        self.left -= 1
        return np.zeros(1), 1.0, False, self.left == 0, {}


class Acting:
    """A policy whose action takes so long, sleeping or computing."""

    def __init__(self, sleeps=0.0, computes=0.0):
        self.sleeps, self.computes, self.collected = sleeps, computes, []

    def reset(self, seed):
        pass

    def act(self, observation):
        self.collected.append(gc.isenabled())
        time.sleep(self.sleeps)
        until = time.thread_time() + self.computes
        while time.thread_time() < until:
            pass
        return np.zeros(1)


def played(loop, env, policy):
    """What a loop measured of one episode."""
    loop.rollout(env, policy, 0)
    return loop.measured()


def test_steps_keep_the_rate_and_none_begins_before_its_period():
    found = played(PacedLoop(Pacing(100, 10)), Counting(20), Acting())
    assert found.seconds >= 19 / 100
    assert (found.times["late"] >= 0).all()
    assert len(found.times["step"]) == 20


def test_waiting_for_a_core_is_told_from_the_policys_own_computation():
    found = played(PacedLoop(Pacing(100, 0.005)), Counting(5), Acting(sleeps=0.006))
    assert (found.missed("policy"), found.missed("policy_cpu")) == (5, 0)
    found = played(PacedLoop(Pacing(100, 0.005)), Counting(5), Acting(computes=0.006))
    assert found.missed("policy_cpu") == 5


def test_a_slow_environment_misses_deadlines_that_the_policy_keeps():
    found = played(PacedLoop(Pacing(100, 60)), Counting(4, takes=0.012), Acting())
    assert found.missed("step") == 0  # a deadline may be longer than the period
    found = played(PacedLoop(Pacing(100, 0.01)), Counting(4, takes=0.012), Acting())
    assert (found.missed("policy_cpu"), found.missed("step")) == (0, 4)


def test_periods_that_have_passed_are_skipped_and_not_caught_up_with():
    metronome = Metronome(0.01)
    metronome.start()
    first, began = metronome.wait(), metronome.due
    time.sleep(0.035)
    assert metronome.wait() - first >= 0.035
    assert metronome.skipped >= 2
    assert metronome.wait() >= metronome.due  # and the next has begun
    assert (metronome.due - began) / 0.01 == pytest.approx(round((metronome.due - began) / 0.01))


def test_no_garbage_is_collected_within_an_episode_and_afterwards_as_before():
    policy = Acting()
    assert gc.isenabled()
    played(PacedLoop(Pacing(1000, 1)), Counting(3), policy)
    assert policy.collected[1:] == [False] * 3  # the first is not of the episode
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def test_a_duration_plays_whole_episodes_until_it_has_passed():
    loop = PacedLoop(Pacing(200, 1, duration=0.12))
    seeds = []
    for seed in loop.seeds(range(7, 8)):
        seeds.append(seed)
        loop.rollout(Counting(10), Acting(), seed)
    assert seeds == list(range(7, 7 + len(seeds)))
    assert 1 <= len(seeds) <= 3
    assert loop.measured().seconds >= 0.12
    assert len(loop.measured().times["step"]) == 10 * len(seeds)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("20ms", 0.02), ("500us", 5e-4), ("0.5 s", 0.5), ("1min", 60), ("5µs", 5e-6)],
)
def test_times_have_units(text, seconds):
    assert duration("--deadline", text) == pytest.approx(seconds)


BAD_TIMES = ["20", "ms", "-20ms", "0ms", "20 hours", "", "nan s", "1e9s", "99999999s", "²ms"]


@pytest.mark.parametrize(("options", "said"), [
    *(((50, text, None), "--deadline") for text in BAD_TIMES),
    *(((rate, None, None), "must be from") for rate in (0, -50, math.nan, math.inf, 1e9, 1e-9)),
    ((None, "20ms", None), "--deadline goes with --rate"),
    ((None, None, "60s"), "--duration goes with --rate"),
])  # fmt: skip
def test_a_rate_or_a_time_that_is_none_is_refused_in_a_sentence(options, said):
    with pytest.raises(ConfigError, match=said):
        pacing(*options)


def test_a_paced_run_has_the_return_and_the_costs_of_one_that_is_not():
    plain = run_policy("kart-steer/sparse", None, None, range(10_000, 10_001))
    loop = PacedLoop(Pacing(10_000, 1))
    paced = run_policy("kart-steer/sparse", None, None, range(10_000, 10_001), loop=loop)
    assert paced.as_json() == plain.as_json()
    assert len(loop.measured().times["policy"]) == plain.rows[0].episodes[0].steps


def test_run_prints_deadlines_and_has_them_in_its_json(command):
    words = ["run", "random", "--env", "kart-steer", "--rate", "2000", "--deadline", "1min"]
    words += ["--duration", "1ms"]
    code, out, _ = command(*words)
    said = "Deadlines of 60000 ms missed: 0 by the policy (0 by its own computation)"
    assert (code, said in " ".join(out.split())) == (0, True)
    found = json.loads(command(*words, "--json")[1])["real_time"]
    assert found["missed"] == {"policy": 0, "policy_cpu": 0, "step": 0}
    assert found["deadline_s"] == 60.0
    assert found["times_s"].keys() == {"late", "policy", "policy_cpu", "step"}
    assert found["times_s"]["policy"].keys() == {"p50", "p95", "p99", "max"}


@pytest.mark.parametrize(
    ("more", "said"),
    [(["--duration", "1s", "--episodes", "3"], "--episodes"), (["--video", "a.mp4"], "--video")],
)
def test_options_that_contradict_a_rate_are_refused(more, said, command):
    code, _, err = command("run", "random", "--env", "kart-steer", "--rate", "50", *more)
    assert (code, said in err) == (2, True)
