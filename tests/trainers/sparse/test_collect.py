import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.sparse.pool import Episodes, Stateless
from spikedeploy.trainers.sparse.student import FloatController, on_chip
from tests import toy_race_env, toy_stroll_env
from tests.delta_policies import delta_policy, pruned_mlp


@pytest.fixture(autouse=True)
def stroll(monkeypatch):
    toy_stroll_env.install(monkeypatch)


def episodes(count=3, limit=None, name="stroll"):
    return Episodes(EnvConfig(name=name), count, limit)


def label(observation):
    return observation[:, :2]


def test_episodes_side_by_side_are_those_one_after_another():
    # in integers: the sums of a matrix product in floats may depend on the number of its rows
    policy = on_chip(delta_policy(obs=3), chip("loihi1"))
    together = episodes(3).play([1, 2, 3, 4, 5], policy, label)
    alone = episodes(1).play([1, 2, 3, 4, 5], policy, label)
    for one, other in zip(together[0], alone[0], strict=True):
        np.testing.assert_array_equal(one.observation, other.observation)
    assert together[1:] == alone[1:]


def test_a_walk_is_a_whole_episode_with_its_labels():
    walks, returns, infos = episodes(2).play([7, 8, 9], Stateless(lambda o: o[:, :2]), label)
    assert [len(walk.label) for walk in walks] == [20, 20, 20]
    for walk in walks:
        np.testing.assert_array_equal(walk.label, walk.observation[:, :2])
        assert (walk.observation.dtype, walk.crashed) == (np.float32, False)
    assert len(returns) == len(infos) == 3
    limited, _, _ = episodes(limit=5).play([7], Stateless(lambda o: o[:, :2]), label)
    np.testing.assert_array_equal(limited[0].observation, walks[0].observation[:5])
    assert episodes().play([7], Stateless(lambda o: o[:, :2]))[0] == []


def test_an_end_that_is_no_success_is_a_crash(monkeypatch):
    step = toy_race_env.RaceEnv.step

    def short(self, action):
        found = step(self, action)
        return (*found[:2], self._step == 4, *found[3:])

    toy_race_env.install(monkeypatch)
    monkeypatch.setattr(toy_race_env.RaceEnv, "step", short)
    found = episodes(2, name="race").play([0, 1], Stateless(lambda o: np.zeros(len(o), int)), label)
    assert [(walk.crashed, len(walk.label)) for walk in found[0]] == [(True, 4), (True, 4)]


@pytest.mark.parametrize("target", ["ideal", "loihi1"])
def test_a_policy_walks_on_the_chip_as_in_float_or_nearly(target):
    policy, played = delta_policy(obs=3, left=1.0), episodes()
    by_torch = played.play([1, 2, 3], FloatController(policy), label)[0]
    by_chip = played.play([1, 2, 3], on_chip(policy, chip(target)), label)[0]
    tolerance = 1e-5 if target == "ideal" else 0.2
    for one, other in zip(by_torch, by_chip, strict=True):
        np.testing.assert_allclose(one.observation, other.observation, atol=tolerance)


def test_a_float_policy_walks_as_it_is():
    policy = pruned_mlp(obs=3)
    one, other = (
        episodes().play([1], each, label)[0][0].observation
        for each in (FloatController(policy), on_chip(policy, chip("loihi1")))
    )
    np.testing.assert_array_equal(one, other)
