"""The gradient updates of soft actor-critic, and the networks that it learns."""

import copy
import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from spikedeploy.trainers.adam import adam, load, tensors, under
from spikedeploy.trainers.critic import TwinCritic, move_towards
from spikedeploy.trainers.policies.neurons import excess_rate
from spikedeploy.trainers.policies.normaliser import Moments
from spikedeploy.trainers.policies.policy import Latent, Policy, full_precision
from spikedeploy.trainers.sac.config import SacConfig
from spikedeploy.trainers.sac.replay import ReplayBatch

_AVERAGED = 10  # at first the averaged policy spans the last 1/10 of the updates
_LOG_STD = (-20.0, 2.0)  # limits (Haarnoja et al. 2018)


class GaussianActor(nn.Module):
    """Stochastic actor: a tanh-squashed Gaussian around the policy's mean.

    A linear head maps the policy's last activations, hidden units of an MLP or output rates of a
    PopSAN, to the standard deviation. The head is not part of the policy and never deployed.
    """

    def __init__(self, policy: Policy, epsilon: float = 1e-6) -> None:
        super().__init__()
        self.policy = policy
        self.log_std = nn.Linear(policy.latent_size, policy.actions)
        self.epsilon = epsilon

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor, Latent]:
        """Return a sampled action (B, act), its log-probability (B,) and the policy's output."""
        latent: Latent = self.policy.latent(observation)
        log_std = full_precision(self.log_std, latent.hidden).clamp(*_LOG_STD)
        noise = torch.randn_like(latent.mean)
        action = torch.tanh(latent.mean + log_std.exp() * noise)
        # log p = sum(log N(noise) - log std - log(1 - a^2 + eps))
        density = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi)
        correction = torch.log(1 - action.square() + self.epsilon)
        return action, (density - correction).sum(-1), latent


class Temperature(nn.Module):
    """Weight of the entropy, learned (Haarnoja et al. 2018, "Algorithms and Applications").

    target: mean entropy [nats] to keep
    """

    def __init__(self, start: float, target: float) -> None:
        super().__init__()
        self.logarithm = nn.Parameter(torch.tensor(math.log(start)))
        self.target = target

    @property
    def value(self) -> float:
        """The weight."""
        return math.exp(self.logarithm.item())

    def loss(self, entropy: Tensor) -> Tensor:
        """Return the loss whose descent raises the weight while the entropy () is too low."""
        return self.logarithm.exp() * (entropy - self.target)


class SacLearner:
    """Actor, twin critics, their targets and optimisers.

    policy: running average of the actor's policy, which is saved and deployed
    temperature: None where it is scheduled
    """

    def __init__(self, config: SacConfig, policy: Policy) -> None:
        self._config = config
        sizes = policy.observations, policy.actions
        self.policy = policy.requires_grad_(False)
        self.actor = GaussianActor(copy.deepcopy(policy).requires_grad_(), config.epsilon)
        self.critic = TwinCritic(*sizes, config.critic_hidden)
        self.target = copy.deepcopy(self.critic).requires_grad_(False)
        self.temperature: Temperature | None = None
        if config.learn_temperature:
            self.temperature = Temperature(config.temperature.start, -float(policy.actions))
        self._optimise()

    def _optimise(self) -> None:
        """Make the optimisers of the networks where they are."""
        rate = self._config.learning_rate
        self.actor_optimizer = adam(self.actor, rate)
        self.critic_optimizer = adam(self.critic, rate)
        if self.temperature is not None:
            self.temperature_optimizer = adam(self.temperature, rate)

    @property
    def _averaged(self) -> Policy:
        """The averaged policy, where gradients are computed."""
        return self.policy

    def adopt(self, moments: Moments) -> None:
        """Normalise observations by these statistics."""
        for policy in (self._averaged, self.actor.policy):
            policy.normalizer.adopt(moments)

    def average(self, updates: int) -> None:
        """Update the averaged policy (Polyak and Juditsky 1992)."""
        # spans the last tenth of the updates at first, later the last 1 / averaging of them
        share = max(self._config.averaging, _AVERAGED / (updates + _AVERAGED - 1))
        move_towards(self._averaged, self.actor.policy, share)

    def explore(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return actions (B, act) drawn from the actor's distribution."""
        return self._drawn(self.actor, torch.from_numpy(observation).float())

    @torch.no_grad()
    def _drawn(self, actor: nn.Module, observation: Tensor) -> NDArray[np.float64]:
        action: Tensor = actor(observation)[0]
        return action.double().numpy()

    def settle(self) -> None:
        """Bring `policy` up to date, before it is validated or saved."""

    def update(self, batch: ReplayBatch, temperature: float) -> dict[str, Tensor]:
        """Take one gradient step and return the losses.

        temperature: the scheduled one, in place of which a learned one is used
        """
        learned = self.temperature
        return self._step(batch, temperature if learned is None else learned.value)

    def _step(self, batch: ReplayBatch, temperature: float | Tensor) -> dict[str, Tensor]:
        observation = self._normalized(batch.observation)
        with self._autocast():
            goal = self._goal(batch, temperature)
        # separate contexts, because each caches low-precision copies of the weights
        with self._autocast():
            critic_loss = self._critic_loss(observation, batch.action, goal)
        _descend(critic_loss, self.critic, self.critic_optimizer)
        with self._autocast():
            actor_loss, entropy = self._actor_loss(observation, batch, temperature)
        _descend(actor_loss, self.actor, self.actor_optimizer)
        if self.temperature is not None:
            _descend(self.temperature.loss(entropy), self.temperature, self.temperature_optimizer)
        move_towards(self.target, self.critic, self._config.tau)
        losses = {"critic_loss": critic_loss, "actor_loss": actor_loss, "entropy": entropy}
        return {name: loss.detach() for name, loss in losses.items()}

    def _normalized(self, observation: Tensor) -> Tensor:
        normalized: Tensor = self.actor.policy.normalizer(observation)
        return normalized

    @torch.no_grad()
    def _goal(self, batch: ReplayBatch, temperature: float | Tensor) -> Tensor:
        """Return the targets of the critics (B,)."""
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
        self, observation: Tensor, batch: ReplayBatch, temperature: float | Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the actor's loss and the policy's entropy."""
        action, log_prob, latent = self.actor(batch.observation)
        value = torch.minimum(*self.critic(observation, action))
        loss = (temperature * log_prob - value).mean() + self._penalty(latent)
        if self._config.smoothness:
            loss = loss + self._config.smoothness * self._action_change(latent, batch.following)
        return loss, -log_prob.detach().mean()

    def _action_change(self, latent: Latent, following: Tensor) -> Tensor:
        """Return the mean squared change of the policy's action to the following states."""
        # a policy whose action jumps between neighbouring states makes the joints chatter
        after = self.actor.policy.latent(following).mean
        change: Tensor = torch.tanh(after) - torch.tanh(latent.mean)
        return change.square().sum(-1).mean()

    def _penalty(self, latent: Latent) -> Tensor:
        """Return the penalties of saturated actions and of high firing rates."""
        # a large mean saturates tanh and leads to bang-bang control
        penalty = self._config.mean_penalty * latent.mean.square().sum(-1).mean()
        if self._config.rate_penalty:
            excess = excess_rate(latent.rates, self._config.rate_target)
            penalty = penalty + self._config.rate_penalty * excess
        return penalty

    def _autocast(self) -> torch.autocast:
        enabled = self._config.precision == "bfloat16"
        return torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled)

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name."""
        groups = {name: module.state_dict() for name, module in self._modules().items()}
        groups |= {name: tensors(optimizer) for name, optimizer in self._optimizers().items()}
        return {f"{name}.{key}": t for name, group in groups.items() for key, t in group.items()}

    def load(self, named: dict[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        self.policy.load_state_dict(under("policy", named))
        for name, module in self._modules().items():
            module.load_state_dict(under(name, named))
        for name, optimizer in self._optimizers().items():
            load(optimizer, under(name, named))

    def _modules(self) -> dict[str, nn.Module]:
        found = {"actor": self.actor, "critic": self.critic, "target": self.target}
        return found if self.temperature is None else {**found, "temperature": self.temperature}

    def _optimizers(self) -> dict[str, torch.optim.Adam]:
        found = {"actor_adam": self.actor_optimizer, "critic_adam": self.critic_optimizer}
        if self.temperature is None:
            return found
        return {**found, "temperature_adam": self.temperature_optimizer}


def _descend(loss: Tensor, module: nn.Module, optimizer: torch.optim.Adam) -> None:
    """Take one gradient step on the loss, in the parameters of the module only."""
    parameters = list(module.parameters())
    for parameter, gradient in zip(parameters, torch.autograd.grad(loss, parameters), strict=True):
        parameter.grad = gradient
    optimizer.step()
