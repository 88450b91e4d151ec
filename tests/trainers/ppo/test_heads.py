import pytest
import torch
from torch.distributions import Categorical, Normal, kl_divergence

from spikedeploy.trainers.ppo import CategoricalHead, GaussianHead

MEAN = torch.tensor([[0.3, -1.0, 2.0], [0.0, 0.0, 0.0]])


def test_discrete_actions_have_the_probabilities_of_a_softmax():
    head, reference = CategoricalHead(), Categorical(logits=MEAN)
    drawn = torch.tensor([2, 0])
    torch.testing.assert_close(head.log_probability(MEAN, drawn), reference.log_prob(drawn))
    torch.testing.assert_close(head.entropy(MEAN), reference.entropy())


def test_discrete_actions_are_drawn_as_often_as_they_should_be():
    torch.manual_seed(0)
    drawn = CategoricalHead().draw(MEAN[:1].expand(20_000, 3))
    shares = torch.bincount(drawn, minlength=3) / 20_000
    torch.testing.assert_close(shares, MEAN[0].softmax(-1), atol=0.01, rtol=0)


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
