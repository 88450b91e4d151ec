"""What every disturbance in the table must keep, in every environment that has it."""

import json

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.disturbances import DISTURBANCES, disturbances, kinds_of
from spikedeploy.envs.rollout import Rollout, rollout
from spikedeploy.runtime.errors import EnvError

EVERY = [(env, name) for env, spec in envs.ENVS.items() for name in kinds_of(spec.world)]
each = pytest.mark.parametrize(("env", "name"), EVERY)
LONG_ENOUGH_FOR_A_PUSH = {"max_steps": 255}


class Waving:
    """A controller of any world that moves, by its seed."""

    def __init__(self, env):
        self.space = env.action_space

    def reset(self, seed):
        self.rng = np.random.default_rng(seed)

    def act(self, observation):
        if hasattr(self.space, "n"):
            return np.asarray(self.rng.integers(1, self.space.n))
        return self.rng.uniform(-0.5, 0.5, self.space.shape)


def played(name, seed=3, **options):
    """A short episode of a controller that waves."""
    env = envs.make(name, **{"max_steps": 60, **options})
    found = rollout(env, Waving(env), seed)
    env.close()
    return found


def same(left, right):
    """Whether two rollouts are equal bit for bit."""
    return all(
        np.array_equal(getattr(left, part), getattr(right, part))
        for part in ("observation", "action", "reward")
    )


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_kind_has_three_rising_levels_within_its_bounds(name):
    found = DISTURBANCES[name]
    lowest, highest = found.bounds
    for levels in found.levels.values():
        assert lowest <= levels[0] < levels[1] < levels[2] <= highest
    assert found.meaning
    assert found.unit
    assert found.source
    assert bool(found.option) != bool(found.wrap)


@each
def test_a_seed_decides_the_bits_level_0_is_nothing_and_observations_stay_in_range(env, name):
    length = LONG_ENOUGH_FOR_A_PUSH if name == "pushes" else {}
    first, calm = played(env, disturb=[f"{name}:3"], **length), played(env, **length)
    assert same(first, played(env, disturb=[f"{name}:3"], **length))
    assert same(calm, played(env, disturb=[f"{name}:0"], **length))
    assert not same(first, calm)
    space = envs.make(env).observation_space
    assert ((first.observation >= space.low) & (first.observation <= space.high)).all()


@pytest.mark.parametrize("env", envs.ENVS)
def test_all_disturbances_at_once_are_one_environment(env):
    texts = [f"{name}:1" for name in kinds_of(envs.spec(env).world)]
    assert played(env, disturb=texts).options["disturb"] == texts


def test_a_rollout_keeps_its_disturbances_and_the_environment_can_be_made_again(tmp_path):
    first = played("kart-steer", disturb=["noise:2", "grip=0.5"], track="small_S")
    first.save(tmp_path / "drive.npz")
    loaded = Rollout.load(tmp_path / "drive.npz")
    assert loaded.options["disturb"] == ["noise:2", "grip=0.5"]
    again = envs.make(loaded.env_id, **json.loads(json.dumps(loaded.options)))
    assert same(first, rollout(again, Waving(again), 3))


def test_a_rollout_holds_what_the_policy_saw():
    calm, noisy = played("hexapod"), played("hexapod", disturb=["noise=0.1"])
    places = envs.make("hexapod").unwrapped.OBSERVATION
    # the same walk: the controller looks at nothing
    assert np.array_equal(calm.reward, noisy.reward)
    apart = noisy.observation - calm.observation
    for own in ("previous", "phase", "contact"):
        assert not apart[:, places[own]].any()
    assert apart[:, places["joints"]].std() == pytest.approx(0.1, rel=0.1)


def test_a_delayed_observation_is_one_of_before_and_the_phase_is_of_now():
    calm, late = played("hexapod"), played("hexapod", disturb=["delay:2"])
    places = envs.make("hexapod").unwrapped.OBSERVATION
    joints, phase = places["joints"], places["phase"]
    assert np.array_equal(late.observation[2:, joints], calm.observation[:-2, joints])
    assert np.array_equal(late.observation[:, phase], calm.observation[:, phase])


def test_dropout_of_everything_shows_the_first_measurement_for_ever():
    blind = played("kart-gazebo", disturb=["dropout=1"])
    lidar = envs.make("kart-gazebo").unwrapped.OBSERVATION["lidar"]
    rest = np.delete(blind.observation, np.r_[lidar], axis=1)
    assert (rest == rest[0]).all()
    assert not (blind.observation[:, lidar] == blind.observation[0, lidar]).all()


def test_a_dead_leg_is_another_one_in_another_episode_and_whole_again_without():
    env = envs.make("hexapod", disturb=["dead-leg:3"])
    model = env.unwrapped._robot.model
    legs = set()
    for seed in range(8):
        env.reset(seed=seed)
        dead = np.flatnonzero(model.actuator_gainprm[:, 0] == 0)
        assert len(dead) == 3
        assert dead[0] % 3 == 0
        legs.add(int(dead[0]))
    assert len(legs) > 2


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["lidar-noise:1"], "hexapod has no 'lidar-noise'; it has noise, bias"),
        (["noise:4"], "'4' is no level from 0 to 3; a number is written noise=4"),
        (["noise"], "--disturb takes name:level or name=number"),
        (["noise=-1"], "is not a number from 0 to 10"),
        (["noise=much"], "is not a number"),
        (["noise:1", "noise:2"], "--disturb noise is given twice"),
        ("noise:1", "is no list"),
    ],
)
def test_a_request_that_cannot_be_met_says_what_can(texts, said):
    with pytest.raises(EnvError, match=said):
        disturbances(texts, "hexapod")


@pytest.mark.parametrize("text", ["delay=1.5", "dead-joint=0.5"])
def test_what_is_counted_takes_whole_numbers(text):
    with pytest.raises(EnvError, match="whole number"):
        envs.make("hexapod", disturb=[text]).reset(seed=0)
