import numpy as np
import pytest
import torch
from torch.distributions import Categorical, Normal, kl_divergence

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import PopsanConfig, resolve
from spikedeploy.trainers.metrics_file import read_metrics
from spikedeploy.trainers.policies import build, from_config
from spikedeploy.trainers.ppo import (
    CategoricalHead,
    GaussianHead,
    Ppo,
    PpoConfig,
    PpoLearner,
    RolloutBatch,
    advantages,
    minibatches,
)
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.train import train
from tests.toy_pointing_env import PointingEnv
from tests.toy_quadrant_env import QuadrantEnv

QUICK = [
    "env.count=8", "steps=4096", "horizon=64", "minibatch=64", "validation.every=2048",
    "validation.episodes=4", "gamma=0.0", "actor_rate.start=3e-3", "actor_rate.end=3e-3",
    "critic_hidden=[16]", "checkpoint_every=2048", "validation.limit=10",
]  # fmt: skip
SPIKING = ["policy.hidden=[32]", "policy.timesteps=8"]


@pytest.fixture(params=[QuadrantEnv, PointingEnv])
def world(request, monkeypatch):
    monkeypatch.setattr(envs, "make", lambda name, **options: request.param())
    return request.param


@pytest.mark.parametrize(
    ("recipe", "settings"),
    [
        ("kart-grid-ann", ["policy.hidden=[32]"]),
        ("smoke-kart", SPIKING),
        ("smoke-kart", [*SPIKING, "policy.coding=bernoulli", "policy.timesteps=16"]),
        ("smoke-kart", [*SPIKING, "policy.coding=population", "rate_penalty=0.01"]),
    ],
)
def test_it_learns_within_seconds_with_every_head_and_code(recipe, settings, tmp_path, world):
    run = train(recipe, overrides=[*QUICK, *settings], runs=tmp_path, quiet=True)
    first, *_, last = (row["episode_return"] for row in read_metrics(run / "metrics.csv"))
    # of 10: random choices earn 2.5, random pointing about -1.3
    assert last > first + 1.5
    policy = RunFolder(run).policy()
    seen = torch.rand(200, 2) * 1.6 - 0.8
    if world is QuadrantEnv:
        right = (seen[:, 0] > 0).long() + 2 * (seen[:, 1] > 0).long()
        assert (policy(seen) == right).float().mean() > 0.5
    else:
        assert (policy(seen) - seen).abs().mean() < 0.45


def test_a_random_code_is_learned_from_the_spikes_that_were_acted_on():
    torch.manual_seed(0)
    policy = build(
        {"kind": "spiking-mlp", "observations": 3, "actions": 4, "coding": "bernoulli",
         "head": "discrete"}
    )  # fmt: skip
    learner = PpoLearner(resolve(PpoConfig, "smoke-kart"), policy)
    observation = torch.zeros(5, 3)
    encoded, drawn, log_probability = learner.explore(observation)
    assert encoded.dtype == torch.uint8
    assert not torch.equal(encoded, policy.sample_encoding(observation))
    again = learner.head.log_probability(policy.forward_encoded(encoded).mean, drawn)
    assert torch.equal(again, log_probability)


@pytest.mark.parametrize("world", [QuadrantEnv], indirect=True)
def test_the_normaliser_is_updated_until_it_is_frozen(tmp_path, world):
    config = resolve(PpoConfig, "smoke-kart", overrides=[*QUICK, *SPIKING, "normaliser.finish=600"])
    learner = Ppo(config, RunFolder.create(tmp_path, config))
    seen = []
    for _ in range(3):
        learner._envs.step(np.zeros(8, np.int64))
        seen.append(learner.policy.normalizer.std.clone())
        learner.collect()
    assert torch.equal(seen[0], torch.ones(2))
    assert not torch.equal(seen[1], seen[0])


def test_sac_refuses_discrete_actions(tmp_path):
    with pytest.raises(ConfigError, match=r"sac learns continuous actions, and .*Grid"):
        train("smoke", overrides=["env.name=kart-grid"], runs=tmp_path, quiet=True)


def test_a_popsan_refuses_discrete_actions():
    with pytest.raises(ConfigError, match="a popsan has continuous actions"):
        from_config(PopsanConfig(), 3, 4, head="discrete")


MEAN = torch.tensor([[0.3, -1.0, 2.0], [0.0, 0.0, 0.0]])


def test_discrete_actions_have_the_probabilities_of_a_softmax():
    head, reference = CategoricalHead(), Categorical(logits=MEAN)
    drawn = torch.tensor([2, 0])
    torch.testing.assert_close(head.log_probability(MEAN, drawn), reference.log_prob(drawn))
    torch.testing.assert_close(head.entropy(MEAN), reference.entropy())


def test_continuous_actions_have_the_probabilities_of_a_gaussian_before_tanh():
    head, reference = GaussianHead(3, 0.6), Normal(MEAN, 0.6)
    drawn = MEAN + 0.2
    logs = reference.log_prob(drawn).sum(-1)
    torch.testing.assert_close(head.log_probability(MEAN, drawn), logs)
    torch.testing.assert_close(head.entropy(MEAN), reference.entropy().sum(-1))
    assert head.action(drawn).abs().max() < 1.0


def test_the_divergence_that_ends_the_epochs_is_that_of_the_two_policies():
    torch.manual_seed(0)
    head, old = CategoricalHead(), MEAN[:1].expand(200_000, 3)
    new = old + torch.tensor([0.4, 0.0, -0.2])
    drawn = head.draw(old)
    change = head.log_probability(new, drawn) - head.log_probability(old, drawn)
    estimate = (change.exp() - 1.0 - change).mean().item()
    exact = kl_divergence(Categorical(logits=old[0]), Categorical(logits=new[0])).item()
    assert estimate == pytest.approx(exact, rel=0.03)


def test_a_low_temperature_draws_the_best_action_only():
    torch.manual_seed(0)
    head = CategoricalHead()
    head.temperature = 0.01
    assert (head.draw(MEAN[:1].expand(1000, 3)) == 2).all()
    assert head.entropy(MEAN[:1]).item() == pytest.approx(0.0, abs=1e-6)


GAMMA, TRACE = 0.9, 0.5


def column(*values, kind=torch.float32):
    return torch.tensor(values, dtype=kind)[:, None]


def test_advantages_equal_a_trace_worked_out_by_hand():
    # V = 1, 2, 3 before and 2, 3, 4 after three steps that pay 1, 0, 2
    # delta = 1 + .9 * 2 - 1 = 1.8 ; 0 + .9 * 3 - 2 = .7 ; 2 + .9 * 4 - 3 = 2.6
    # A2 = 2.6 ; A1 = .7 + .45 * 2.6 = 1.87 ; A0 = 1.8 + .45 * 1.87 = 2.6415
    never = column(False, False, False, kind=torch.bool)
    found = advantages(
        column(1, 0, 2), column(1, 2, 3), column(2, 3, 4), never, never, GAMMA, TRACE
    )
    assert found.flatten().tolist() == pytest.approx([2.6415, 1.87, 2.6])


def test_a_terminal_state_ends_the_return_and_truncation_does_not():
    reward, value, following = column(0, 0), column(5, 5), column(7, 7)
    ended = column(True, False, kind=torch.bool)
    for terminated, expected in ((True, 0 - 5), (False, 0.9 * 7 - 5)):
        flags = column(terminated, False, kind=torch.bool)
        found = advantages(reward, value, following, flags, ended, GAMMA, TRACE)
        assert found[0].item() == pytest.approx(expected)


def test_minibatches_hold_every_step_once():
    numbers = torch.arange(70.0)
    batch = RolloutBatch(*[numbers] * 6)
    parts = list(minibatches(batch, 70 // 32))
    assert [len(part.target) for part in parts] == [35, 35]
    assert sorted(torch.cat([part.advantage for part in parts]).tolist()) == numbers.tolist()
    assert all(torch.equal(part.advantage, part.target) for part in parts)
