"""The networks of soft actor-critic and one gradient update of them (Haarnoja et al. 2018)."""

import copy

import torch
from torch import Tensor, nn

from spikedeploy.trainers.actor import GaussianActor
from spikedeploy.trainers.adam import adam, load, tensors, under
from spikedeploy.trainers.buffers import ReplayBatch
from spikedeploy.trainers.config import SacConfig
from spikedeploy.trainers.critic import TwinCritic, follow
from spikedeploy.trainers.normalizer import Moments
from spikedeploy.trainers.policy import Latent, Policy
from spikedeploy.trainers.rates import excess

AVERAGED = 10  # share of the history, one in so many, that the averaged policy spans at first


class SacLearner:
    """Actor, twin critics, their targets and optimisers.

    policy: what is kept, the average of the actor's policies of late
    """

    def __init__(self, config: SacConfig, policy: Policy) -> None:
        self._config = config
        sizes = policy.observations, policy.actions
        self.policy = policy.requires_grad_(False)
        self.actor = GaussianActor(copy.deepcopy(policy).requires_grad_(), config.epsilon)
        self.critic = TwinCritic(*sizes, config.critic_hidden)
        self.target = copy.deepcopy(self.critic).requires_grad_(False)
        self.actor_optimizer = adam(self.actor, config.learning_rate)
        self.critic_optimizer = adam(self.critic, config.learning_rate)

    def adopt(self, moments: Moments) -> None:
        """Normalise observations by these statistics from now on."""
        for policy in (self.policy, self.actor.policy):
            policy.normalizer.adopt(moments)

    def average(self, updates: int) -> None:
        """Move the policy that is kept towards the actor's (Polyak and Juditsky 1992)."""
        # over the last tenth of the updates at first, then over the last 1 / averaging of them
        share = max(self._config.averaging, AVERAGED / (updates + AVERAGED - 1))
        follow(self.policy, self.actor.policy, share)

    def update(self, batch: ReplayBatch, temperature: float) -> dict[str, Tensor]:
        """Take one gradient step and return the losses."""
        observation = self._normalized(batch.observation)
        with self._autocast():
            goal = self._goal(batch, temperature)
        # a context of its own for each: it keeps low-precision copies of weights until it ends
        with self._autocast():
            critic_loss = self._critic_loss(observation, batch.action, goal)
        _descend(critic_loss, self.critic, self.critic_optimizer)
        with self._autocast():
            actor_loss, entropy = self._actor_loss(observation, batch, temperature)
        _descend(actor_loss, self.actor, self.actor_optimizer)
        follow(self.target, self.critic, self._config.tau)
        losses = {"critic_loss": critic_loss, "actor_loss": actor_loss, "entropy": entropy}
        return {name: loss.detach() for name, loss in losses.items()}

    def _normalized(self, observation: Tensor) -> Tensor:
        normalized: Tensor = self.actor.policy.normalizer(observation)
        return normalized

    @torch.no_grad()
    def _goal(self, batch: ReplayBatch, temperature: float) -> Tensor:
        """Return what the critics should say (B,)."""
        action, log_prob, _ = self.actor(batch.following)
        value = torch.minimum(*self.target(self._normalized(batch.following), action))
        # y = r + gamma (1 - terminated) (min Q'(s', a') - temperature log p(a'))
        value = value - temperature * log_prob
        goal: Tensor = batch.reward + self._config.gamma * (1 - batch.terminated) * value
        return goal

    def _critic_loss(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        first, second = self.critic(observation, action)
        return nn.functional.mse_loss(first, goal) + nn.functional.mse_loss(second, goal)

    def _actor_loss(
        self, observation: Tensor, batch: ReplayBatch, temperature: float
    ) -> tuple[Tensor, Tensor]:
        """Return the actor's loss and the policy's entropy."""
        action, log_prob, latent = self.actor(batch.observation)
        value = torch.minimum(*self.critic(observation, action))
        loss = (temperature * log_prob - value).mean() + self._penalty(latent)
        return loss, -log_prob.detach().mean()

    def _penalty(self, latent: Latent) -> Tensor:
        """Return what saturated actions and busy neurons cost."""
        # a large mean saturates tanh, and the gait becomes bang-bang
        penalty = self._config.mean_penalty * latent.mean.square().sum(-1).mean()
        if self._config.rate_penalty:
            busy = excess(latent.rates, self._config.rate_target)
            penalty = penalty + self._config.rate_penalty * busy
        return penalty

    def _autocast(self) -> torch.autocast:
        enabled = self._config.precision == "bfloat16"
        return torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled)

    def tensors(self) -> dict[str, Tensor]:
        """Return what a checkpoint needs beside the policy that is kept."""
        groups = {name: module.state_dict() for name, module in self._modules().items()}
        groups |= {name: tensors(optimizer) for name, optimizer in self._optimizers().items()}
        return {f"{name}.{key}": t for name, group in groups.items() for key, t in group.items()}

    def load(self, named: dict[str, Tensor]) -> None:
        """Take over the tensors of a checkpoint, the policy's under "policy." among them."""
        self.policy.load_state_dict(under("policy", named))
        for name, module in self._modules().items():
            module.load_state_dict(under(name, named))
        for name, optimizer in self._optimizers().items():
            load(optimizer, under(name, named))

    def _modules(self) -> dict[str, nn.Module]:
        return {"actor": self.actor, "critic": self.critic, "target": self.target}

    def _optimizers(self) -> dict[str, torch.optim.Adam]:
        return {"actor_adam": self.actor_optimizer, "critic_adam": self.critic_optimizer}


def _descend(loss: Tensor, module: nn.Module, optimizer: torch.optim.Adam) -> None:
    """Take one step down the loss, in the module's own parameters only."""
    parameters = list(module.parameters())
    for parameter, gradient in zip(parameters, torch.autograd.grad(loss, parameters), strict=True):
        parameter.grad = gradient
    optimizer.step()
