"""Proximal policy optimisation: act in a batch of environments, learn from the newest steps.

For discrete and continuous actions; on-policy (Schulman et al. 2017).
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.nn import functional

from spikedeploy.trainers.config import (
    Batch,
    EnvConfig,
    NormaliserConfig,
    Positive,
    Ramp,
    Rate,
    RunConfig,
    Share,
    ValidationConfig,
    Width,
)
from spikedeploy.trainers.policies import Policy, from_config
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.runner import Critic, EnvRunner, Learner, adam, descend, set_rate
from spikedeploy.trainers.surrogate_neurons import excess_rate

_HALF_LOG_2_PI = 0.5 * math.log(2.0 * math.pi)
_SMALL = 0.01  # initial scale of the last layer: nearly equal actions (Andrychowicz et al. 2021)
_EPS = 1e-8


class PpoConfig(RunConfig):
    """Proximal policy optimisation with a clipped surrogate (Schulman et al. 2017).

    steps: environment steps in total, of all copies together
    horizon: steps of each copy between two updates; a batch has `env.count` times as many
    epochs, minibatch: passes over a batch, and rows per gradient update
    trace: lambda of generalised advantage estimation
    clip: limit on the change of an action's probability ratio
    entropy: weight of the policy's entropy in its loss, along environment steps
    temperature: divisor of a discrete head's logits when actions are sampled, along environment
        steps. It ends low, so that training visits the states that greedy actions lead to, such as
        turning left and right forever, which a policy that samples its actions never does
    target_kl: mean divergence from the acting policy after which the epochs end; 0 for no limit
    gradient_norm: limit on the norm of the gradient, for actor and critic each
    actor_rate: learning rate of the policy, along environment steps
    critic_rate: learning rate of the critic
    spread: initial standard deviation of a continuous head's exploration, before tanh
    rate_penalty, rate_target: weight and threshold of the hinge on mean firing rates [spikes per
        neuron and timestep]; no effect on an MLP
    """

    env: EnvConfig = EnvConfig(name="kart-grid", count=16)
    normaliser: NormaliserConfig = NormaliserConfig(finish=0)
    validation: ValidationConfig = ValidationConfig(every=20_000, episodes=20)
    steps: Positive = 300_000
    horizon: Batch = 128
    epochs: Positive = 6
    minibatch: Batch = 256
    gamma: Share = 0.99
    trace: Share = 0.95
    clip: Rate = 0.2
    entropy: Ramp = Ramp(start=0.01, end=0.0, finish=200_000)
    temperature: Ramp = Ramp(start=1.0, end=0.1, begin=120_000, finish=200_000)
    target_kl: float = Field(default=0.03, ge=0)
    gradient_norm: Rate = 0.5
    actor_rate: Ramp = Ramp(start=1e-3, end=0.0, finish=300_000)
    critic_rate: Rate = 1e-3
    critic_hidden: tuple[Width, ...] = (128, 128)
    spread: Rate = 0.6
    rate_penalty: float = Field(default=0.0, ge=0)
    rate_target: Share = 0.2
    checkpoint_every: Positive = 50_000

    @model_validator(mode="after")
    def _temperatures_divide(self) -> "PpoConfig":
        if not self.temperature.start or not self.temperature.end:
            raise ValueError("temperature: start and end are above 0, as logits are divided by it")
        return self


# -- actions as distributions


class CategoricalHead(nn.Module):
    """Categorical distribution over discrete actions; `Latent.mean` holds their logits.

    temperature: divisor of the logits; near zero only the best action is drawn
    """

    temperature = 1.0

    def draw(self, mean: Tensor) -> Tensor:
        """Return the indices (B,) of actions drawn for the logits (B, act)."""
        return torch.multinomial((mean / self.temperature).softmax(-1), 1).squeeze(-1)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return the log-probability (B,) of drawn actions."""
        return self._logs(mean).gather(-1, drawn[:, None]).squeeze(-1)

    def entropy(self, mean: Tensor) -> Tensor:
        """Return the entropy (B,)."""
        logs = self._logs(mean)
        # H = -sum p log p
        return -(logs.exp() * logs).sum(-1)

    def action(self, drawn: Tensor) -> Tensor:
        """Return the action of the environment: the index itself."""
        return drawn

    def _logs(self, mean: Tensor) -> Tensor:
        """Return the log-probability of every action (B, act)."""
        return functional.log_softmax(mean / self.temperature, -1)


class GaussianHead(nn.Module):
    """Gaussian around `Latent.mean`, squashed by tanh, with a learned spread for each action.

    Ratios and divergences are those of the Gaussian before tanh: the correction of the
    log-probability by tanh depends on the action alone and cancels. The spread is learned, so that
    the temperature has no effect.
    """

    temperature = 1.0

    def __init__(self, actions: int, spread: float) -> None:
        super().__init__()
        self.log_std = nn.Parameter(torch.full((actions,), math.log(spread)))

    def draw(self, mean: Tensor) -> Tensor:
        """Return actions before tanh (B, act) drawn around the mean (B, act)."""
        return mean + self.log_std.exp() * torch.randn_like(mean)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return the log-probability (B,) of drawn actions."""
        # log p = sum(-1/2 ((u - mean) / std)^2 - log std - 1/2 log 2 pi)
        noise = (drawn - mean) / self.log_std.exp()
        return (-0.5 * noise.square() - self.log_std - _HALF_LOG_2_PI).sum(-1)

    def entropy(self, mean: Tensor) -> Tensor:
        """Return the entropy (B,)."""
        # H = sum(1/2 + 1/2 log 2 pi + log std)
        return (0.5 + _HALF_LOG_2_PI + self.log_std).sum().expand(len(mean))

    def action(self, drawn: Tensor) -> Tensor:
        """Return the action of the environment (B, act) in [-1, 1]."""
        return torch.tanh(drawn).double()


# -- what PPO learns from, shared with PPO after imitation


@dataclass(frozen=True)
class Transition:
    """One step of all B copies.

    encoded: (B, ...) encoding of the observation, see `Policy.sample_encoding`
    observation, following: (B, obs) before and after the step
    drawn: (B,) or (B, act) action as drawn by a head
    log_probability, reward: (B,)
    terminated: (B,) whether the episode ended in a terminal state
    ended: (B,) whether it ended, by a terminal state or the time limit
    """

    encoded: Tensor
    observation: Tensor
    following: Tensor
    drawn: Tensor
    log_probability: Tensor
    reward: Tensor
    terminated: Tensor
    ended: Tensor


@dataclass(frozen=True)
class RolloutBatch:
    """Steps in any order, N of them.

    advantage: (N,) of the action over the critic's value
    target: (N,) return that the critic learns
    """

    encoded: Tensor
    observation: Tensor
    drawn: Tensor
    log_probability: Tensor
    advantage: Tensor
    target: Tensor


def minibatches(batch: Any, count: int) -> Iterator[Any]:  # noqa: ANN401 - any such dataclass
    """Yield all rows of a dataclass of tensors once, shuffled, in minibatches, at least one."""
    columns = [getattr(batch, each.name) for each in fields(batch)]
    for chosen in torch.randperm(len(columns[0])).tensor_split(max(1, count)):
        yield type(batch)(*(column[chosen] for column in columns))


def stack_transitions(transitions: list[Transition]) -> Transition:
    """Return K transitions as one, with arrays (K, B, ...)."""
    names = [each.name for each in fields(Transition)]
    return Transition(
        *(torch.stack([getattr(step, name) for step in transitions]) for name in names)
    )


def advantages(
    reward: Tensor,
    value: Tensor,
    following: Tensor,
    terminated: Tensor,
    ended: Tensor,
    gamma: float,
    trace: float,
) -> Tensor:
    """Return generalised advantages (K, B) of K steps of B copies (Schulman et al. 2016).

    value, following: (K, B) the critic's values before and after each step

    Only `terminated` sets the value after a step to zero, so that truncated episodes are
    bootstrapped; `ended` stops the sum at the end of an episode.
    """
    # delta = r + gamma V' (1 - terminated) - V ; A = delta + gamma trace (1 - ended) A'
    delta = reward + gamma * following * ~terminated - value
    decay = gamma * trace * ~ended
    result = torch.empty_like(delta)
    later = torch.zeros_like(delta[0])
    for k in reversed(range(len(delta))):
        later = delta[k] + decay[k] * later
        result[k] = later
    return result


def clipped_gain(change: Tensor, advantage: Tensor, clip: float) -> tuple[Tensor, dict[str, float]]:
    """Return the clipped surrogate that is to be raised, and its metrics.

    change: (N,) of the log-probability of each action
    """
    ratio = change.exp()
    limited = ratio.clamp(1.0 - clip, 1.0 + clip)
    # L = E[min(ratio A, clip(ratio) A)]
    gain = torch.min(ratio * advantage, limited * advantage).mean()
    with torch.no_grad():
        # (r - 1) - log r is never negative, and its mean is the divergence
        divergence = float((ratio - 1.0 - change).mean())
        return gain, {"kl": divergence, "clipped": float((ratio != limited).float().mean())}


def means(rows: list[dict[str, float]]) -> dict[str, float]:
    """Return the mean of each metric."""
    return {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}


class PpoLearner(Learner):
    """A policy, its exploration and its critic, with their optimisers.

    policy: learned and deployed
    head: exploration, which is not deployed
    critic: value of an observation, a float network even for a spiking policy
    """

    def __init__(self, config: PpoConfig, policy: Policy) -> None:
        self._config, self.policy = config, policy
        if not policy.started:
            last = [module for module in policy.modules() if isinstance(module, nn.Linear)][-1]
            with torch.no_grad():
                last.weight.mul_(_SMALL)
                last.bias.zero_()
        self.head: CategoricalHead | GaussianHead
        if policy.head == "discrete":
            self.head = CategoricalHead()
        else:
            self.head = GaussianHead(policy.actions, config.spread)
        self.critic = Critic(policy.observations, config.critic_hidden)
        self.actor = nn.ModuleList([policy, self.head])
        self.modules = {"head": self.head, "critic": self.critic}
        self._actor_adam = adam(self.actor, config.actor_rate.start)
        self._critic_adam = adam(self.critic, config.critic_rate)
        self.optimizers = {"actor_adam": self._actor_adam, "critic_adam": self._critic_adam}
        self._entropy = config.entropy.start

    @torch.no_grad()
    def explore(self, observation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return encoding, drawn actions and their log-probabilities (B,)."""
        encoded = self.policy.sample_encoding(observation)
        mean = self.policy.forward_encoded(encoded).mean
        drawn = self.head.draw(mean)
        return encoded, drawn, self.head.log_probability(mean, drawn)

    def schedule(self, step: int) -> None:
        """Set everything that is scheduled along environment steps."""
        self._entropy = self._config.entropy.value(step)
        self.head.temperature = self._config.temperature.value(step)
        set_rate(self._actor_adam, self._config.actor_rate.value(step))

    def learn(self, transitions: list[Transition]) -> dict[str, float]:
        """Learn from K steps of all copies, until the divergence limit; return the metrics."""
        config, batch = self._config, self._assessed(stack_transitions(transitions))
        found: list[dict[str, float]] = []
        for _ in range(config.epochs):
            count = len(batch.target) // config.minibatch
            epoch = [self._update(part) for part in minibatches(batch, count)]
            found += epoch
            if 0 < config.target_kl < means(epoch)["kl"]:
                break
        return means(found)

    @torch.no_grad()
    def _assessed(self, steps: Transition) -> RolloutBatch:
        """Return the steps (K, B) as one batch with advantages and targets."""
        normalise, config = self.policy.normalizer, self._config
        value, following = (
            self.critic(normalise(observed)) for observed in (steps.observation, steps.following)
        )
        ends = steps.terminated, steps.ended
        advantage = advantages(steps.reward, value, following, *ends, config.gamma, config.trace)
        columns = (
            steps.encoded,
            steps.observation,
            steps.drawn,
            steps.log_probability,
            (advantage - advantage.mean()) / (advantage.std() + _EPS),
            advantage + value,
        )
        return RolloutBatch(*(column.flatten(0, 1) for column in columns))

    def _update(self, part: RolloutBatch) -> dict[str, float]:
        """Take one gradient step of actor and critic."""
        config, latent = self._config, self.policy.forward_encoded(part.encoded)
        change = self.head.log_probability(latent.mean, part.drawn) - part.log_probability
        gain, row = clipped_gain(change, part.advantage, config.clip)
        entropy = self.head.entropy(latent.mean).mean()
        # L = -gain - c H
        loss = -gain - self._entropy * entropy
        if config.rate_penalty:
            loss = loss + config.rate_penalty * excess_rate(latent.rates, config.rate_target)
        descend(self._actor_adam, self.actor, loss, config.gradient_norm)
        seen = self.policy.normalizer(part.observation)
        error = functional.mse_loss(self.critic(seen), part.target)
        descend(self._critic_adam, self.critic, error, config.gradient_norm)
        losses = {"actor_loss": loss, "entropy": entropy, "critic_loss": error}
        return {**row, **{name: float(value.detach()) for name, value in losses.items()}}


# -- a run


class Ppo(EnvRunner[PpoConfig]):
    """One run of proximal policy optimisation.

    iterations: batches collected and learned from so far
    finishes: episodes that ended at the finish
    """

    Config = PpoConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "env_steps", "iterations", "episodes", "finishes", "episode_return", "actor_loss",
        "critic_loss", "entropy", "kl", "clipped", "learning_rate", "steps_per_s", "eval_return",
        "eval_finish", "eval_crash", "eval_gates", "eval_speed",
    )  # fmt: skip
    COUNTERS = ("env_steps", "iterations", "episodes", "best", "finishes")
    learner: PpoLearner

    def __init__(self, config: PpoConfig, run: RunFolder) -> None:
        super().__init__(config, run, config.steps, config.checkpoint_every)
        envs = self._envs
        self.policy = from_config(config.policy, *envs.sizes, config.normaliser.clip, envs.head)
        self.learner = PpoLearner(config, self.policy)
        self.iterations = 0
        self._learned: dict[str, float] = {}
        self.finishes = 0

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        before = self.env_steps
        self.learner.schedule(before)
        self._learned = self.learner.learn(self.collect())
        self._learned["learning_rate"] = self.config.actor_rate.value(before)
        self.iterations += 1
        self._count_episodes()
        return True

    def collect(self) -> list[Transition]:
        """Take `horizon` steps in every environment."""
        transitions = []
        frozen = self.env_steps >= self.config.normaliser.finish
        for _ in range(self.config.horizon):
            observation = torch.from_numpy(self._envs.observation).float()
            encoded, drawn, log_probability = self.learner.explore(observation)
            steps = self._envs.step(self.learner.head.action(drawn).numpy())
            transitions.append(
                Transition(
                    encoded,
                    observation,
                    torch.from_numpy(steps.following).float(),
                    drawn,
                    log_probability,
                    torch.from_numpy(steps.reward).float(),
                    torch.from_numpy(steps.terminated),
                    torch.from_numpy(steps.ended),
                )
            )
            ends = (steps.infos[k] for k in np.flatnonzero(steps.ended))
            self.finishes += sum(int(info.get("finish", 0.0)) for info in ends)
        if not frozen:
            for transition in transitions:
                self._moments.add(transition.observation.double().numpy())
            self.policy.normalizer.adopt(self._moments)
        return transitions

    def _metrics(self) -> dict[str, float]:
        return self._learned
