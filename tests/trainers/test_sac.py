import numpy as np
import pytest
import torch

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig, differences, resolve
from spikedeploy.trainers.env_batch import EnvBatch
from spikedeploy.trainers.metrics_file import read_metrics
from spikedeploy.trainers.policies import MlpPolicy
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.runner import Validator
from spikedeploy.trainers.sac import (
    GaussianActor,
    ReplayBatch,
    ReplayBuffer,
    SacConfig,
    SacLearner,
    check_shaping,
    shape_reward,
)
from spikedeploy.trainers.train import train
from tests.toy_pointing_env import QUICK, PointingEnv


@pytest.fixture
def pointing(monkeypatch):
    PointingEnv.seeds = ()
    monkeypatch.setattr(envs, "make", lambda name, **options: PointingEnv())


@pytest.mark.parametrize("recipe", ["smoke", "smoke-popsan"])
def test_it_learns_to_point_in_a_few_hundred_updates(recipe, tmp_path, pointing):
    overrides = [*QUICK, "rate_penalty=0.01"]
    run = train(recipe, overrides=overrides, runs=tmp_path, quiet=True)
    returns = [
        row["eval_return"] for row in read_metrics(run / "metrics.csv") if "eval_return" in row
    ]
    assert len(returns) == 2
    # random actions earn -2, perfect ones 10
    assert max(returns) > 5.0
    policy = RunFolder(run).policy()
    goals = torch.rand(200, 2) * 1.6 - 0.8
    assert (policy(goals) - goals).abs().mean() < 0.2


def test_training_never_touches_the_seeds_of_validation_and_evaluation(pointing):
    batch = EnvBatch(EnvConfig(count=3), np.random.default_rng(0))
    for _ in range(200):
        batch.step(batch.uniform())
    assert len(set(PointingEnv.seeds)) > 30
    assert max(PointingEnv.seeds) < 5_000


def test_validation_uses_the_same_seeds_every_time(pointing):
    config = resolve(SacConfig, "smoke", overrides=["validation.episodes=3"]).validation
    validate = Validator(EnvConfig(), config)
    PointingEnv.seeds = ()
    first, second = validate(MlpPolicy(2, 2, ())), validate(MlpPolicy(2, 2, ()))
    assert PointingEnv.seeds == (5000, 5001, 5002) * 2
    assert first["eval_speed"] == second["eval_speed"] == 0.5
    assert first["eval_falls"] == 0.0


def test_the_support_force_reaches_the_environment_in_training_only(pointing):
    batch = EnvBatch(EnvConfig(count=1), np.random.default_rng(0))
    batch.support_force(0.75)
    assert batch._envs[0].support_force == 0.75
    validate = Validator(EnvConfig(), resolve(SacConfig, "smoke").validation)
    validate(MlpPolicy(2, 2, ()))
    assert not any(hasattr(env, "support_force") for env in validate._envs)


def learner(*overrides):
    torch.manual_seed(0)
    config = resolve(SacConfig, "smoke", overrides=["precision=float32", *overrides])
    return SacLearner(config, MlpPolicy(2, 2, (16,)))


def random_batch(size=64, **changes):
    generator = torch.manual_seed(1)
    parts = {
        "observation": torch.rand(size, 2, generator=generator),
        "action": torch.rand(size, 2, generator=generator),
        "reward": torch.ones(size),
        "terminated": torch.zeros(size),
        "following": torch.rand(size, 2, generator=generator),
    }
    return ReplayBatch(**{**parts, **changes})


def test_the_value_after_a_terminal_state_is_zero():
    sac = learner()
    goal = sac._goal(random_batch(terminated=torch.ones(64)), temperature=0.05)
    assert torch.equal(goal, torch.ones(64))


def test_critics_converge_to_a_known_return():
    sac = learner("learning_rate=0.01")
    batch = random_batch(terminated=torch.ones(64), reward=torch.full((64,), 3.0))
    for _ in range(200):
        losses = sac.update(batch, temperature=0.0)
    assert losses["critic_loss"] < 0.01
    assert abs(sac.critic(batch.observation, batch.action)[0].mean() - 3.0) < 0.2


def test_targets_follow_by_tau():
    sac = learner("tau=0.25")
    before = [parameter.clone() for parameter in sac.target.parameters()]
    sac.update(random_batch(), temperature=0.05)
    for old, new, source in zip(
        before, sac.target.parameters(), sac.critic.parameters(), strict=True
    ):
        torch.testing.assert_close(new, old + 0.25 * (source - old))


def test_smoothness_makes_the_policy_act_alike_in_neighbouring_states():
    changes = []
    for weight in (0.0, 10.0):
        sac = learner(f"smoothness={weight}", "learning_rate=0.01", "mean_penalty=0")
        batch = random_batch()
        for _ in range(50):
            sac.update(batch, temperature=0.05)
        policy = sac.actor.policy
        changes.append((policy(batch.following) - policy(batch.observation)).square().mean())
    assert changes[1] < 0.2 * changes[0]


def test_the_log_probability_is_that_of_a_squashed_gaussian():
    torch.manual_seed(0)
    actor = GaussianActor(MlpPolicy(2, 1, ()), epsilon=0.0).double().requires_grad_(False)
    observation = torch.zeros(1, 2, dtype=torch.float64)
    action, log_prob, latent = actor(observation)
    std = actor.log_std(latent.hidden).exp()
    gauss = torch.distributions.Normal(latent.mean, std)
    squashed = torch.distributions.TransformedDistribution(
        gauss, [torch.distributions.TanhTransform()]
    )
    torch.testing.assert_close(log_prob, squashed.log_prob(action).sum(-1))


def test_the_saved_policy_averages_the_actors_weights():
    sac = learner("averaging=0.5")
    first = sac.actor.policy.layers[0].weight
    steps = []
    for updates in range(1, 4):
        with torch.no_grad():
            first += 1.0
        steps.append(first.detach().clone())
        sac.average(updates)
    # 10 / (1 + 9) = 1, 10 / (2 + 9) and 10 / (3 + 9) of the newest weights, each above 0.5
    kept = steps[0].lerp(steps[1], 10 / 11).lerp(steps[2], 10 / 12)
    torch.testing.assert_close(sac.policy.layers[0].weight, kept)


@pytest.mark.parametrize(("spread", "falls"), [(0.0, True), (-6.0, False)])
def test_a_learned_temperature_moves_the_entropy_towards_minus_one_nat_an_action(spread, falls):
    sac = learner("learn_temperature=true", "learning_rate=0.001")
    torch.nn.init.constant_(sac.actor.log_std.bias, spread)
    before = sac.temperature.value
    entropy = sac.update(random_batch(), before)["entropy"]
    assert (entropy > -2.0) == falls
    assert (sac.temperature.value < before) == falls


def test_a_learned_temperature_is_part_of_a_checkpoint():
    first, second = (learner("learn_temperature=true") for _ in range(2))
    for _ in range(3):
        first.update(random_batch(), first.temperature.value)
    named = first.tensors() | {f"policy.{k}": v for k, v in first.policy.state_dict().items()}
    second.load(named)
    for sac in (first, second):
        torch.manual_seed(3)
        sac.update(random_batch(), sac.temperature.value)
    assert first.temperature.value == second.temperature.value != 0.05


@pytest.mark.parametrize(("settings", "word"), [
    (["learn_temperature=true", "temperature.start=0"], "begin above 0"),
    (["precision=bfloat16", "device=cuda"], "precision=float32"),
    pytest.param(["device=cuda"], "no CUDA device", marks=pytest.mark.skipif(
        torch.cuda.is_available(), reason="there is a CUDA device")),
])  # fmt: skip
def test_what_cannot_be_trained_is_refused(settings, word):
    with pytest.raises(ConfigError, match=word):
        learner(*settings)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_it_learns_on_a_gpu(tmp_path, pointing):
    overrides = [*QUICK, "device=cuda", "precision=float32"]
    run = train("smoke", overrides=overrides, runs=tmp_path, quiet=True)
    assert max(row.get("eval_return", 0) for row in read_metrics(run / "metrics.csv")) > 5.0


def fill(buffer, numbers):
    for number in numbers:
        buffer.add(
            np.full((1, 3), number), np.full((1, 2), -number), np.array([10.0 * number]),
            np.array([number % 2 == 0]), np.full((1, 3), number + 0.5),
        )  # fmt: skip


def held(buffer):
    return sorted(buffer.rows[: buffer.size, 0])


def test_a_sample_keeps_transitions_together():
    buffer = ReplayBuffer(100, 3, 2)
    fill(buffer, range(1, 21))
    batch = buffer.sample(64, np.random.default_rng(0))
    number = batch.observation[:, 0]
    assert len(number.unique()) > 10
    assert (batch.action == -number[:, None]).all()
    assert (batch.reward == 10 * number).all()
    assert (batch.terminated == (number % 2 == 0)).all()
    assert (batch.following == number[:, None] + 0.5).all()


def taken_up(buffer, capacity):
    copy = ReplayBuffer(capacity, 3, 2)
    copy.load(buffer.tensors()["replay"].numpy(), buffer.next)
    return copy


@pytest.mark.parametrize("count", [0, 3, 4, 6, 7])
def test_what_is_saved_comes_back_in_its_places(count):
    buffer = ReplayBuffer(4, 3, 2)
    fill(buffer, range(count))
    copy = taken_up(buffer, 4)
    for each in (9, 10):
        assert np.array_equal(copy.rows, buffer.rows)
        assert (copy.size, copy.next) == (buffer.size, buffer.next)
        fill(buffer, [each])
        fill(copy, [each])


def test_what_is_saved_comes_back_oldest_first_in_a_ring_of_another_size():
    buffer = ReplayBuffer(4, 3, 2)
    fill(buffer, range(6))
    for capacity, expected in ((3, [3, 4, 5]), (6, [2, 3, 4, 5])):
        copy = taken_up(buffer, capacity)
        assert held(copy) == expected
    fill(copy, [6])
    assert held(copy) == [2, 3, 4, 5, 6]


def test_updates_see_the_reward_with_the_extra_weights():
    batch = EnvBatch(EnvConfig(count=2), np.random.default_rng(0))
    steps = batch.step(batch.uniform())
    for weights in ({}, {"power": 2.0, "jerk": -1.0}):
        extra = [
            sum(weight * info["reward_terms"][name] for name, weight in weights.items())
            for info in steps.infos
        ]
        np.testing.assert_allclose(shape_reward(weights, steps), steps.reward + extra)
    assert np.abs(shape_reward({"power": 2.0}, steps) - steps.reward).min() > 0


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
