from types import SimpleNamespace

import numpy as np
import pytest
import torch

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.runner import _metrics as runner_metrics
from spikedeploy.trainers.runner import mean_outcome
from spikedeploy.trainers.sparse.batch_controllers import FloatController, controller_of
from spikedeploy.trainers.sparse.walks import (
    Episodes,
    Stateless,
    Walk,
    WalkPool,
    walk_tensors,
    walks_of,
)
from tests import toy_race_env, toy_stroll_env
from tests.delta_policies import delta_policy, pruned_mlp, walk

DECAY = 0.9
ENCODER = DeltaEncoder(np.array([0.3, 0.5, np.inf]), most=2)


def numbered(steps, first, crashed=False):
    """A walk whose labels count from `first`."""
    label = np.arange(first, first + steps, dtype=np.float32)[:, None]
    return Walk(walk(steps, 3, seed=first).astype(np.float32), label, crashed)


@pytest.fixture
def pool():
    found = WalkPool()
    found.add([numbered(40, 0), numbered(25, 100, crashed=True), numbered(6, 200)])
    found.encode([each.observation.astype(float) for each in found.walks], ENCODER, DECAY)
    return found


def sampled(pool, count=400, window=10, burn_in=4, first=0.0, crash=0.0, crash_steps=5):
    rng = np.random.default_rng(0)
    return pool.sample(rng, count, window, burn_in, first, crash, crash_steps)


def by_steps(observation):
    """Moves and held currents (S, obs) of one walk, step by step."""
    levels, held = ENCODER.start(0), np.zeros(3)
    moves, holds = [], []
    for row in observation:
        events = ENCODER.events(row[None].astype(float), 1, levels)[0, 0]
        assert not events[2]  # its step is infinite
        moves.append(events * [0.3, 0.5, 0.0])
        held = DECAY * held + moves[-1]
        holds.append(held)
    return np.array(moves), np.array(holds)


def test_windows_hold_what_an_encoder_sends_from_the_walks_beginning(pool):
    moves, holds = (dict(enumerate(each)) for each in zip(*map(by_steps, (
        each.observation for each in pool.walks
    )), strict=True))  # fmt: skip
    found = sampled(pool)
    checked = 0
    for k in range(len(found.label)):
        label = found.label[k, 4:, 0].numpy().astype(int)
        which, start = label[0] // 100, label[0] % 100
        if which == 2 or start + 6 > len(pool.walks[which].label):
            continue
        steps = np.arange(start - 4, start + 6)
        inside = steps >= 0
        checked += 1
        np.testing.assert_array_equal(label, 100 * which + steps[4:])
        for got, want in ((found.moved, moves), (found.seen, holds)):
            np.testing.assert_allclose(
                got[k].numpy()[inside], want[which][steps[inside]], atol=1e-6
            )
            assert not got[k].numpy()[~inside].any()
    assert checked > 200


def test_windows_hold_every_timestep_of_their_control_steps():
    pool, timesteps = WalkPool([numbered(12, 0)]), 3
    seen = pool.walks[0].observation.astype(float)
    pool.encode([seen], ENCODER, DECAY, 1, timesteps)
    levels = ENCODER.start(0)
    events = np.concatenate([ENCODER.events(row[None], timesteps, levels)[0] for row in seen])
    assert np.count_nonzero(events[1::3])
    arriving = np.concatenate([np.zeros((1, 3)), events[:-1] * [0.3, 0.5, 0.0]])
    found = pool.windows(np.zeros(2, int), np.array([-2, 5]), 6)
    assert not found.moved[0, :6].any()
    np.testing.assert_allclose(found.moved[0, 6:], arriving[:12], atol=1e-6)
    np.testing.assert_allclose(found.moved[1], arriving[15:33], atol=1e-6)
    assert found.label[1, :, 0].tolist() == [5, 6, 7, 8, 9, 10]
    assert pool.event_rate[0] * 12 == np.abs(events[:, 0]).sum()  # unary: spikes are events


def test_a_window_that_begins_before_its_walk_starts_with_the_episode(pool):
    found = sampled(pool, first=0.3)
    first = found.label[:, 4, 0].numpy().astype(int) % 100
    assert torch.equal(found.begins, torch.from_numpy(first == 0))
    assert 0.3 < found.begins.float().mean() < 0.8
    assert not found.moved[found.begins][:, :4].any()


def test_windows_lie_before_crashes(pool):
    found = sampled(pool, crash=1.0)
    last = found.label[:, -1, 0].numpy().astype(int)
    # the walk of 25 steps: windows end in its last five steps
    assert set(last) == set(range(120, 125))


def test_behind_a_walks_end_its_last_label_stays(pool):
    found = sampled(pool, window=20)
    short = found.label[:, -1, 0] == 205
    assert short.any()
    assert found.label[short][:, 4:, 0].max() == 205
    assert found.begins[short].all()


def test_rates_are_means_over_the_steps_of_walks(pool):
    events = [np.count_nonzero(by_steps(each.observation)[0], axis=0) for each in pool.walks]
    assert pool.steps == 71
    # unary: as many spikes as events
    sizes = [np.abs(by_steps(each.observation)[0])[:, :2] / ENCODER.step[:2] for each in pool.walks]
    expected = np.append(sum(s.sum(0) for s in sizes) / 71, 0.0)
    np.testing.assert_allclose(pool.event_rate.numpy(), expected, rtol=1e-5)
    moves = [np.abs(np.diff(each.observation.astype(float), axis=0)).sum(0) for each in pool.walks]
    np.testing.assert_allclose(pool.mean_move, sum(moves) / 71, rtol=1e-6)
    one_hot = DeltaEncoder(ENCODER.step, 2, "one-hot")
    pool.encode([each.observation.astype(float) for each in pool.walks], one_hot, DECAY)
    np.testing.assert_allclose(pool.event_rate.numpy(), sum(events) / 71, rtol=1e-5)


def test_states_are_drawn_with_their_labels_and_near_crashes(pool):
    rng = np.random.default_rng(0)
    observation, label = pool.states(rng, 300, 0.0, 5)
    for seen, wanted in zip(observation.numpy(), label[:, 0].numpy().astype(int), strict=True):
        np.testing.assert_array_equal(seen, pool.walks[wanted // 100].observation[wanted % 100])
    _, near = pool.states(rng, 300, 1.0, 5)
    assert set(near[:, 0].tolist()) == {120, 121, 122, 123, 124}


def test_walks_are_read_as_they_were_written(pool):
    for one, other in zip(pool.walks, walks_of(walk_tensors(pool.walks)), strict=True):
        np.testing.assert_array_equal(one.observation, other.observation)
        np.testing.assert_array_equal(one.label, other.label)
        assert (one.crashed, type(other.crashed)) == (other.crashed, bool)


@pytest.fixture(autouse=True)
def stroll(monkeypatch):
    toy_stroll_env.install(monkeypatch)


def episodes(count=3, limit=None, name="stroll"):
    return Episodes(EnvConfig(name=name), count, limit)


def label(observation):
    return observation[:, :2]


def test_episodes_side_by_side_are_those_one_after_another():
    # in integers: the sums of a matrix product in floats may depend on the number of its rows
    policy = controller_of(delta_policy(obs=3), chip("loihi1"))
    together = episodes(3).play([1, 2, 3, 4, 5], policy, label)
    alone = episodes(1).play([1, 2, 3, 4, 5], policy, label)
    for one, other in zip(together[0], alone[0], strict=True):
        np.testing.assert_array_equal(one.observation, other.observation)
    assert together[1:] == alone[1:]


def test_a_walk_is_a_whole_episode_with_its_labels():
    walks, returns, infos = episodes(2).play([7, 8, 9], Stateless(lambda o: o[:, :2]), label)
    assert [len(walk.label) for walk in walks] == [20, 20, 20]
    for each in walks:
        np.testing.assert_array_equal(each.label, each.observation[:, :2])
        assert (each.observation.dtype, each.crashed) == (np.float32, False)
    assert len(returns) == len(infos) == 3
    limited, _, _ = episodes(limit=5).play([7], Stateless(lambda o: o[:, :2]), label)
    np.testing.assert_array_equal(limited[0].observation, walks[0].observation[:5])
    assert episodes().play([7], Stateless(lambda o: o[:, :2]))[0][0].label.shape[1] == 0


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
    by_chip = played.play([1, 2, 3], controller_of(policy, chip(target)), label)[0]
    tolerance = 1e-5 if target == "ideal" else 0.2
    for one, other in zip(by_torch, by_chip, strict=True):
        np.testing.assert_allclose(one.observation, other.observation, atol=tolerance)


@pytest.mark.parametrize(
    "policy",
    [delta_policy(obs=3), pruned_mlp(obs=3)],
    ids=lambda policy: policy.kind,
)
def test_operations_are_those_of_each_robot_until_its_episode_ends(policy):
    seen, lengths = np.random.default_rng(0).normal(size=(9, 3, 3)), [9, 2, 5, 4, 7]
    alone = 0.0
    for robot, steps in enumerate(lengths):
        counted = controller_of(policy, chip("loihi1"))
        counted.reset(1)
        for row in seen[:steps, robot % 3]:
            counted.act_batch(row[None])
        alone += steps * counted.operations([steps])
    together = controller_of(policy, chip("loihi1"))
    for first, count in ((0, 3), (3, 2)):
        together.reset(count)
        for row in seen[: max(lengths[first : first + count])]:
            together.act_batch(row[:count])
    assert together.operations(lengths) == pytest.approx(alone / sum(lengths))
    assert alone > 0


@pytest.mark.parametrize(
    ("infos", "known"),
    [
        ([{"success": True}, {"success": False}], {"eval_success": 0.5}),
        ([{"success": True}, {}], {}),
        ([{}, {"success": True, "fall": False}], {}),
        ([{}, {}], {}),
    ],
)
def test_what_only_some_episodes_say_has_no_mean(infos, known):
    assert mean_outcome([1.0, 2.0], infos) == {"eval_return": 1.5, **known}
    episodes = [SimpleNamespace(total=k + 1.0, infos=[{}, info]) for k, info in enumerate(infos)]
    assert runner_metrics(episodes) == {"eval_return": 1.5, **known}
