import zipfile

import gymnasium
import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.rollout import EpisodeRecorder, Rollout, rollout
from spikedeploy.runtime.errors import EnvError
from tests.toy_quadrant_env import QuadrantEnv


class Constant:
    def __init__(self, action):
        self.action = np.asarray(action, dtype=np.float64)

    def reset(self, seed):
        self.seed = seed

    def act(self, observation):
        return self.action


class FailsAtThird(Constant):
    def reset(self, seed):
        self.count = 0

    def act(self, observation):
        self.count += 1
        return self.action if self.count == 3 else np.zeros(18)


class Broken(gymnasium.ObservationWrapper):
    def observation(self, observation):
        return np.where(np.arange(77) == 5, np.nan, observation)


@pytest.fixture(scope="module")
def env():
    return envs.make("hexapod", max_steps=30)


@pytest.fixture(scope="module")
def walk(env):
    return rollout(env, Constant(np.zeros(18)), 7)


def test_a_rollout_holds_every_step(walk):
    assert (walk.env_id, walk.seed, walk.options) == (
        "spikedeploy/Hexapod-v0",
        7,
        {"max_steps": 30},
    )
    assert walk.steps == 30
    assert walk.observation.shape == (31, 77)
    assert walk.action.shape == (30, 18)
    assert walk.truncated
    assert not walk.terminated
    assert {values.shape for values in walk.info.values()} == {(30,)}


def test_named_reward_terms_sum_to_the_reward(walk):
    terms = [values for name, values in walk.info.items() if name.startswith("reward/")]
    np.testing.assert_allclose(np.sum(terms, axis=0), walk.reward, atol=1e-9)
    assert walk.total == pytest.approx(walk.info["episode_return"][-1])


def test_success_is_that_of_the_last_info(walk):
    assert walk.success is False
    won = Rollout(**{**vars(walk), "info": {"success": np.array([0.0, 1.0])}})
    assert won.success is True


def test_what_is_saved_is_loaded_bit_for_bit(walk, tmp_path):
    path = tmp_path / "walk.npz"
    walk.save(path)
    loaded = Rollout.load(path)
    assert (loaded.env_id, loaded.seed) == (walk.env_id, walk.seed)
    assert (loaded.terminated, loaded.truncated) == (False, True)
    np.testing.assert_array_equal(loaded.observation, walk.observation)
    np.testing.assert_array_equal(loaded.action, walk.action)
    np.testing.assert_array_equal(loaded.reward, walk.reward)
    assert loaded.info.keys() == walk.info.keys()
    for name, values in walk.info.items():
        np.testing.assert_array_equal(loaded.info[name], values)
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk.npz"]


def test_other_and_missing_files_are_refused(walk, tmp_path):
    walk.save(tmp_path / "cut.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "cut.npz").read_bytes()[:-200])
    with pytest.raises(EnvError, match=r"cut\.npz: not a whole rollout"):
        Rollout.load(tmp_path / "cut.npz")
    path = tmp_path / "other.npz"
    np.savez(path, weights=np.zeros(3))
    with pytest.raises(EnvError, match="not a rollout file"):
        Rollout.load(path)
    with pytest.raises(EnvError, match="no such rollout"):
        Rollout.load(tmp_path / "none.npz")


def test_a_member_that_is_no_array_is_refused(walk, tmp_path):
    walk.save(tmp_path / "walk.npz")
    with zipfile.ZipFile(tmp_path / "walk.npz") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(tmp_path / "walk.npz", "w") as archive:
        for name, content in members.items():
            archive.writestr(name, b"text" if name == "reward.npy" else content)
    with pytest.raises(EnvError, match="'reward' is no array"):
        Rollout.load(tmp_path / "walk.npz")


def test_an_action_that_is_not_finite_names_step_and_place(env):
    action = np.zeros(18)
    action[4] = np.inf
    with pytest.raises(EnvError, match=r"action of step 2: not a finite number at \[4\]"):
        rollout(env, FailsAtThird(action), 0)
    with pytest.raises(EnvError, match=r"action of step 2: shape \(6,\) instead of \(18,\)"):
        rollout(env, FailsAtThird(np.zeros(6)), 0)


def test_an_observation_that_is_not_finite_is_refused(env):
    with pytest.raises(EnvError, match=r"observation of step 0: not a finite number at \[5\]"):
        rollout(Broken(env), Constant(np.zeros(18)), 0)


class Paying(gymnasium.Wrapper):
    """Pays something odd, and reports odd infos."""

    def __init__(self, env, reward, **info):
        super().__init__(env)
        self.reward, self.info = reward, info

    def step(self, action):
        observation, _, terminated, truncated, _ = super().step(action)
        return observation, self.reward, terminated, truncated, self.info


@pytest.mark.parametrize("reward", [np.nan, np.inf, -1e101, 10**400, "high", None])
def test_a_reward_that_is_no_number_names_the_step(env, reward):
    with pytest.raises(EnvError, match=r"reward of step 1: .* is no number of at most 1e\+100"):
        rollout(Paying(env, reward), Constant(np.zeros(18)), 0)


def test_infos_that_no_float64_holds_are_left_out(env):
    odd = Paying(env, 1, huge=10**400, text="a", small=np.float32(0.5), reward_terms=[1, 2])
    found = EpisodeRecorder(odd, 0)
    found.step(np.zeros(18))
    assert {name: list(of) for name, of in found.rollout().info.items()} == {"small": [0.5]}


class Quadrant(Constant):
    def act(self, observation):
        return np.int64(observation[0] > 0) + 2 * np.int64(observation[1] > 0)


def test_a_discrete_action_is_recorded_as_its_index(tmp_path):
    played = rollout(QuadrantEnv(), Quadrant(0), 3)
    assert played.total == 10.0  # the best action at every step
    assert played.action.shape == (10,)
    assert played.action.dtype == np.int64
    played.save(tmp_path / "played.npz")
    loaded = Rollout.load(tmp_path / "played.npz")
    np.testing.assert_array_equal(loaded.action, played.action)
    assert loaded.action.dtype == np.int64


@pytest.mark.parametrize("wrong", [4, -1, 0.5])
def test_a_discrete_action_out_of_range_is_refused(wrong):
    with pytest.raises(EnvError, match=f"action of step 0: {wrong} is none of 0 to 3"):
        rollout(QuadrantEnv(), Constant(wrong), 0)


def test_an_unfinished_episode_counts_as_truncated(env):
    take = EpisodeRecorder(env, 5)
    for _ in range(3):
        take.step(np.zeros(18))
    broken_off = take.rollout()
    assert (broken_off.steps, take.over) == (3, False)
    assert (broken_off.terminated, broken_off.truncated) == (False, True)
