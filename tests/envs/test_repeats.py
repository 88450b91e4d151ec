"""Environments that carry something from one episode to the next, or never repeat."""

import gymnasium
import numpy as np
import pytest

from spikedeploy.envs.repeats import check_repeats
from spikedeploy.runtime.errors import EnvError
from tests import own_env
from tests.own_env import Reach


class Measures(gymnasium.RewardWrapper):
    """Subtracts the mean of all rewards so far."""

    total, count = 0.0, 0

    def reward(self, reward):
        self.total, self.count = self.total + reward, self.count + 1
        return reward - self.total / self.count


def running():
    """A function with a state, in gymnasium's own wrapper."""
    level = [0.0]

    def smooth(reward):
        level[0] = 0.9 * level[0] + reward
        return level[0]

    return gymnasium.wrappers.TransformReward(Reach(), smooth)


class Harder(Reach):
    """Every tenth episode is harder than those before."""

    episodes = 0

    def reset(self, **given):
        self.episodes += 1
        return super().reset(**given)

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, reward * (1 + self.episodes // 10), *rest


class Shorter(Reach):
    """Each episode is shorter than the one before."""

    def reset(self, **given):
        self._steps = max(self._steps - 1, 1)
        return super().reset(**given)


class Unseeded(Reach):
    """Has a generator of its own, which the seed does not set."""

    def __init__(self):
        super().__init__()
        self._own = np.random.default_rng(0)

    def _seen(self):
        self._np_random = self._own
        return super()._seen()


class Noisy(Reach):
    """Draws from NumPy's global generator."""

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, reward + np.random.uniform(), *rest  # noqa: NPY002


class Built(Reach):
    """Draws once, when it is made."""

    def __init__(self):
        super().__init__()
        self._gain = np.random.default_rng().uniform()

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, reward * self._gain, *rest


class Shared(Reach):
    """Counts the episodes of all its instances."""

    episodes = 0

    def reset(self, **given):
        Shared.episodes += 1
        return super().reset(**given)

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, reward * self.episodes, *rest


def named(monkeypatch, maker):
    monkeypatch.setattr(own_env, "Kept", maker, raising=False)
    return "tests.own_env:Kept"


@pytest.mark.parametrize(
    "maker",
    [lambda: Measures(Reach()), running, Harder, Shorter, Unseeded],
    ids=["statistics", "running", "harder", "shorter", "unseeded"],
)
def test_an_environment_with_a_memory_is_refused_with_what_differs(monkeypatch, maker):
    what = r"(the (reward|observation|terminated|truncated)|number \d+ of).* at step \d+ was"
    with pytest.raises(EnvError, match=f"carries something from one episode.*{what}.*reset"):
        check_repeats(named(monkeypatch, maker), {})


@pytest.mark.parametrize(
    ("maker", "when"), [(Noisy, "each time"), (Built, "in each instance"), (Shared, "each time")]
)
def test_one_that_never_repeats_is_told(monkeypatch, maker, when):
    found = check_repeats(named(monkeypatch, maker), {})
    assert f"plays another episode {when}" in found
    assert "np_random" in found


def recorded():
    """Wrappers that keep what they saw, and change nothing."""
    timed = gymnasium.wrappers.TimeLimit(Reach(), 5)
    return gymnasium.wrappers.RecordEpisodeStatistics(timed)


@pytest.mark.parametrize("name", ["CartPole-v1", "Pendulum-v1", "tests.own_env:Levels", "hexapod"])
def test_an_environment_that_repeats_is_not_mentioned(name):
    assert check_repeats(name, {}) == ""


def test_wrappers_that_record_and_disturbances_repeat(monkeypatch):
    assert check_repeats(named(monkeypatch, recorded), {}) == ""
    options = {"disturb": ["noise:2", "command-loss:3"]}
    assert check_repeats("Pendulum-v1", options) == ""
