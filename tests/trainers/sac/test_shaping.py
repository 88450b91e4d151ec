import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig, differences, resolve
from spikedeploy.trainers.env_batch import EnvBatch
from spikedeploy.trainers.metrics import read
from spikedeploy.trainers.sac.learner import SacConfig
from spikedeploy.trainers.sac.sac import check_shaping, shaped
from spikedeploy.trainers.train import train
from tests.toy_pointing_env import QUICK, PointingEnv


class _NamedPointingEnv(PointingEnv):
    """The pointing world, whose reward has one named term."""

    def step(self, action):
        *outcome, info = super().step(action)
        return *outcome, {**info, "reward_terms": {"pointing": outcome[1]}}


@pytest.fixture
def named(monkeypatch):
    monkeypatch.setattr(envs, "make", lambda name, **options: _NamedPointingEnv())


def test_updates_see_the_reward_with_the_extra_weights():
    batch = EnvBatch(EnvConfig(count=2), np.random.default_rng(0))
    steps = batch.step(batch.uniform())
    for weights in ({}, {"power": 2.0, "jerk": -1.0}):
        extra = [
            sum(weight * info["reward_terms"][name] for name, weight in weights.items())
            for info in steps.infos
        ]
        np.testing.assert_allclose(shaped(weights, steps), steps.reward + extra)
    assert np.abs(shaped({"power": 2.0}, steps) - steps.reward).min() > 0


def test_shaping_changes_what_is_learned_and_not_what_is_reported(tmp_path, named):
    run = train("smoke", overrides=[*QUICK, "shaping.pointing=-2.0"], runs=tmp_path, quiet=True)
    rows = read(run / "metrics.csv")
    # with the sign of the reward reversed it learns to point away; random actions earn -2
    assert rows[-1]["eval_return"] < -8.0
    assert rows[-1]["episode_return"] < -2.0


def test_a_term_that_the_reward_lacks_is_refused_with_those_it_has():
    with pytest.raises(ConfigError, match=r"shaping names energy, .*alive, speed, .*jerk, power"):
        check_shaping({"energy": 1.0, "jerk": 1.0}, EnvConfig(name="hexapod-command"))


def test_a_reward_without_named_terms_cannot_be_shaped(monkeypatch):
    monkeypatch.setattr(envs, "make", lambda name, **options: PointingEnv())
    with pytest.raises(ConfigError, match="it has no named terms"):
        check_shaping({"jerk": 1.0}, EnvConfig())


def test_a_weight_is_set_by_its_name_and_shown_as_an_override():
    config = resolve(SacConfig, "hexapod-sac", overrides=["shaping.power=2.0"])
    assert config.shaping == {"power": 2.0}
    assert differences(config) == ["shaping.power=2.0"]
