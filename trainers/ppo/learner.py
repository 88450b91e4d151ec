"""Networks of PPO and their gradient updates: policy, distributions of actions, critic."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from spikedeploy.trainers import adam
from spikedeploy.trainers.critic import Critic
from spikedeploy.trainers.policies import Head, Policy
from spikedeploy.trainers.policies.neurons import excess_rate
from spikedeploy.trainers.ppo.batch import RolloutBatch, Transition, advantages, stacked
from spikedeploy.trainers.ppo.config import PpoConfig

_HALF_LOG_2_PI = 0.5 * math.log(2.0 * math.pi)


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


def _exploration(head: Head, actions: int, spread: float) -> CategoricalHead | GaussianHead:
    """Return the distribution for a policy's head."""
    return CategoricalHead() if head == "discrete" else GaussianHead(actions, spread)


_SMALL = 0.01  # initial scale of the last layer: nearly equal actions (Andrychowicz et al. 2021)


class PpoLearner:
    """A policy, its exploration and its critic, with their optimisers.

    policy: learned and deployed
    head: exploration, which is not deployed
    critic: value of an observation, a float network even for a spiking policy
    """

    def __init__(self, config: PpoConfig, policy: Policy) -> None:
        self._config = config
        self.policy = policy
        _shrink(policy)
        self.head = _exploration(policy.head, policy.actions, config.spread)
        self.critic = Critic(policy.observations, config.critic_hidden)
        self.actor = nn.ModuleList([policy, self.head])
        self._actor_adam = adam.adam(self.actor, config.actor_rate.start)
        self._critic_adam = adam.adam(self.critic, config.critic_rate)
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
        self._entropy = self._config.entropy.at(step)
        self.head.temperature = self._config.temperature.at(step)
        for group in self._actor_adam.param_groups:
            group["lr"] = self._config.actor_rate.at(step)

    def learn(self, transitions: list[Transition]) -> dict[str, float]:
        """Learn from K steps of all copies; return the metrics."""
        batch = self._assessed(stacked(transitions))
        rows = [row for epoch in self._epochs(batch) for row in epoch]
        return {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}

    def _epochs(self, batch: RolloutBatch) -> list[list[dict[str, float]]]:
        """Pass over the batch until the divergence limit; return the metrics of every update."""
        passes: list[list[dict[str, float]]] = []
        for _ in range(self._config.epochs):
            passes.append(
                [self._update(part) for part in batch.minibatches(self._config.minibatch)]
            )
            divergence = sum(row["kl"] for row in passes[-1]) / len(passes[-1])
            if 0 < self._config.target_kl < divergence:
                break
        return passes

    @torch.no_grad()
    def _assessed(self, steps: Transition) -> RolloutBatch:
        """Return the steps (K, B) as one batch with advantages and targets."""
        normalise = self.policy.normalizer
        value, following = (
            self.critic(normalise(observed)) for observed in (steps.observation, steps.following)
        )
        advantage = advantages(
            steps.reward,
            value,
            following,
            steps.terminated,
            steps.ended,
            self._config.gamma,
            self._config.trace,
        )
        columns = (
            steps.encoded,
            steps.observation,
            steps.drawn,
            steps.log_probability,
            (advantage - advantage.mean()) / (advantage.std() + 1e-8),
            advantage + value,
        )
        return RolloutBatch(*(column.flatten(0, 1) for column in columns))

    def _update(self, part: RolloutBatch) -> dict[str, float]:
        """Take one gradient step of actor and critic."""
        row = self._improve_actor(part)
        loss = functional.mse_loss(
            self.critic(self.policy.normalizer(part.observation)), part.target
        )
        descend(self._critic_adam, self.critic, loss, self._config.gradient_norm)
        return {**row, "critic_loss": float(loss.detach())}

    def _improve_actor(self, part: RolloutBatch) -> dict[str, float]:
        latent = self.policy.forward_encoded(part.encoded)
        change = self.head.log_probability(latent.mean, part.drawn) - part.log_probability
        ratio = change.exp()
        limited = ratio.clamp(1.0 - self._config.clip, 1.0 + self._config.clip)
        # L = -E[min(ratio A, clip(ratio) A)] - c H
        gain = torch.min(ratio * part.advantage, limited * part.advantage).mean()
        entropy = self.head.entropy(latent.mean).mean()
        loss = -gain - self._entropy * entropy
        if self._config.rate_penalty:
            excess = excess_rate(latent.rates, self._config.rate_target)
            loss = loss + self._config.rate_penalty * excess
        descend(self._actor_adam, self.actor, loss, self._config.gradient_norm)
        with torch.no_grad():
            return {
                "actor_loss": float(loss),
                "entropy": float(entropy),
                # (r - 1) - log r is never negative, and its mean is the divergence
                "kl": float((ratio - 1.0 - change).mean()),
                "clipped": float((ratio != limited).float().mean()),
            }

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name."""
        parts: dict[str, Mapping[str, Tensor]] = {
            "head": self.head.state_dict(),
            "critic": self.critic.state_dict(),
            "actor_adam": adam.tensors(self._actor_adam),
            "critic_adam": adam.tensors(self._critic_adam),
        }
        return {f"{part}.{key}": t for part, named in parts.items() for key, t in named.items()}

    def load(self, named: dict[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        self.policy.load_state_dict(adam.under("policy", named))
        self.head.load_state_dict(adam.under("head", named))
        self.critic.load_state_dict(adam.under("critic", named))
        adam.load(self._actor_adam, adam.under("actor_adam", named))
        adam.load(self._critic_adam, adam.under("critic_adam", named))


@torch.no_grad()
def _shrink(policy: Policy) -> None:
    """Scale down the policy's last layer."""
    last = [module for module in policy.modules() if isinstance(module, nn.Linear)][-1]
    last.weight.mul_(_SMALL)
    last.bias.zero_()


def descend(
    optimizer: torch.optim.Adam, module: nn.Module, loss: Tensor, gradient_norm: float
) -> None:
    """Take one gradient step of a module, with a limit on the gradient's norm."""
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(module.parameters(), gradient_norm)
    optimizer.step()
