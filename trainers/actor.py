"""The stochastic actor of training: a policy, and the spread that explores around it."""

import math

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policy import Latent, Policy, full_precision

LOG_STD = (-20.0, 2.0)  # limits (Haarnoja et al. 2018)


class GaussianActor(nn.Module):
    """A tanh-squashed Gaussian around the policy's mean.

    The spread is read by a linear head from the policy's last activities: hidden units of an MLP,
    output rates of a PopSAN. The head belongs to training and is never deployed.
    """

    def __init__(self, policy: Policy, epsilon: float = 1e-6) -> None:
        super().__init__()
        self.policy = policy
        self.log_std = nn.Linear(policy.latent_size, policy.actions)
        self.epsilon = epsilon

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor, Latent]:
        """Return a sampled action (B, act), its log-probability (B,) and the policy's state."""
        latent: Latent = self.policy.latent(observation)
        log_std = full_precision(self.log_std, latent.hidden).clamp(*LOG_STD)
        noise = torch.randn_like(latent.mean)
        action = torch.tanh(latent.mean + log_std.exp() * noise)
        # log p = sum(log N(noise) - log std - log(1 - a^2 + eps))
        density = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi)
        correction = torch.log(1 - action.square() + self.epsilon)
        return action, (density - correction).sum(-1), latent
