"""Soft actor-critic (Haarnoja et al. 2018): the algorithm, its networks, its gradient update."""

import copy
import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from spikedeploy.trainers.adam import adam, load, tensors, under
from spikedeploy.trainers.critic import TwinCritic, move_towards
from spikedeploy.trainers.policies import from_config
from spikedeploy.trainers.policies.neurons import excess_rate
from spikedeploy.trainers.policies.normaliser import Moments
from spikedeploy.trainers.policies.policy import Latent, Policy, full_precision
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.runner import EnvRunner
from spikedeploy.trainers.sac.config import SacConfig
from spikedeploy.trainers.sac.replay import ReplayBatch, ReplayBuffer
from spikedeploy.trainers.sac.shaping import check_shaping, shaped

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


class SacLearner:
    """Actor, twin critics, their targets and optimisers.

    policy: running average of the actor's policy, which is saved and deployed
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
        """Normalise observations by these statistics."""
        for policy in (self.policy, self.actor.policy):
            policy.normalizer.adopt(moments)

    def average(self, updates: int) -> None:
        """Update the averaged policy (Polyak and Juditsky 1992)."""
        # spans the last tenth of the updates at first, later the last 1 / averaging of them
        share = max(self._config.averaging, _AVERAGED / (updates + _AVERAGED - 1))
        move_towards(self.policy, self.actor.policy, share)

    def update(self, batch: ReplayBatch, temperature: float) -> dict[str, Tensor]:
        """Take one gradient step and return the losses."""
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
        move_towards(self.target, self.critic, self._config.tau)
        losses = {"critic_loss": critic_loss, "actor_loss": actor_loss, "entropy": entropy}
        return {name: loss.detach() for name, loss in losses.items()}

    def _normalized(self, observation: Tensor) -> Tensor:
        normalized: Tensor = self.actor.policy.normalizer(observation)
        return normalized

    @torch.no_grad()
    def _goal(self, batch: ReplayBatch, temperature: float) -> Tensor:
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
        self, observation: Tensor, batch: ReplayBatch, temperature: float
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
        return {"actor": self.actor, "critic": self.critic, "target": self.target}

    def _optimizers(self) -> dict[str, torch.optim.Adam]:
        return {"actor_adam": self.actor_optimizer, "critic_adam": self.critic_optimizer}


def _descend(loss: Tensor, module: nn.Module, optimizer: torch.optim.Adam) -> None:
    """Take one gradient step on the loss, in the parameters of the module only."""
    parameters = list(module.parameters())
    for parameter, gradient in zip(parameters, torch.autograd.grad(loss, parameters), strict=True):
        parameter.grad = gradient
    optimizer.step()


class Sac(EnvRunner[SacConfig]):
    """One run of soft actor-critic.

    updates: gradient updates so far
    """

    Config = SacConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "env_steps",
        "updates",
        "episodes",
        "episode_return",
        "support_force",
        "temperature",
        "actor_loss",
        "critic_loss",
        "entropy",
        "steps_per_s",
        "eval_return",
        "eval_speed",
        "eval_cot",
        "eval_falls",
        "eval_speed_rmse",
        "eval_turn_rmse",
    )
    COUNTERS = ("env_steps", "updates", "episodes", "best")
    VALIDATES_AT_END = False
    learner: SacLearner

    def __init__(self, config: SacConfig, run: RunFolder) -> None:
        super().__init__(
            config,
            run,
            total=config.steps,
            log_every=config.log_every,
            checkpoint_every=config.checkpoint_every,
        )
        self._envs.require_continuous("sac")
        check_shaping(config.shaping, config.env)
        sizes = self._envs.observation.shape[1], self._envs.actions
        self.policy = from_config(config.policy, *sizes, config.normaliser.clip, self._envs.columns)
        self.learner = SacLearner(config, self.policy)
        self._buffer = ReplayBuffer(min(config.buffer, config.steps), *sizes)
        self.updates = 0
        self._losses: Mapping[str, Tensor] = {}

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        self._collect()
        self._update()
        return True

    @property
    def _temperature(self) -> float:
        return self._config.temperature.at(self.env_steps)

    @property
    def _support_force(self) -> float:
        return self._config.support_force.at(self.env_steps)

    def _collect(self) -> None:
        """Take one step in every environment, and store it."""
        self._envs.support_force(self._support_force)
        steps = self._envs.step(self._actions())
        reward = shaped(self._config.shaping, steps)
        self._buffer.add(steps.observation, steps.action, reward, steps.terminated, steps.following)
        if self.env_steps < self._config.normaliser.finish:
            self._moments.add(steps.observation)
            self.learner.adopt(self._moments)
        self.env_steps += len(self._envs)

    @torch.no_grad()
    def _actions(self) -> NDArray[np.float64]:
        """Return exploring actions (B, act): uniform during warm-up, then the actor's."""
        if self.env_steps < self._config.warm_up:
            return self._envs.uniform()
        observation = torch.from_numpy(self._envs.observation).float()
        action: Tensor = self.learner.actor(observation)[0]
        return action.double().numpy()

    def _update(self) -> None:
        """Make the updates that are due after the steps so far."""
        wanted = (self.env_steps - self._config.warm_up) // self._config.update_every
        while self.updates < wanted:
            batch = self._buffer.sample(self._config.batch, self._rng)
            self._losses = self.learner.update(batch, self._temperature)
            self.updates += 1
            self.learner.average(self.updates)

    def _row(self) -> dict[str, float]:
        self._count_episodes()
        return super()._row()

    def _metrics(self) -> dict[str, float]:
        return {
            "env_steps": self.env_steps,
            "updates": self.updates,
            "episodes": self.episodes,
            "support_force": self._support_force,
            "temperature": self._temperature,
            **{name: float(loss) for name, loss in self._losses.items()},
        }

    def _checkpoint(self) -> None:
        """Save everything that resuming needs; a finished run needs no replay."""
        if not self.finished:
            self._buffer.save(self._run.replay)
        super()._checkpoint()
        if self.finished:
            self._run.replay.unlink(missing_ok=True)

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        super()._restore(state, tensors)
        self.updates = state["updates"]
        if not self.finished:
            self._buffer.load(self._run.replay)
