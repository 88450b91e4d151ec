"""Networks of PPO after imitation, and their gradient updates."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from spikedeploy.trainers import adam
from spikedeploy.trainers.critic import Critic
from spikedeploy.trainers.policies import Policy
from spikedeploy.trainers.ppo.learner import CategoricalHead, descend
from spikedeploy.trainers.sparse.collect import Earned
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import WalkPool, Windows
from spikedeploy.trainers.sparse.students import imitation
from spikedeploy.trainers.sparse_ppo.config import SparsePpoConfig
from spikedeploy.trainers.sparse_ppo.explore import Exploring, NoisyActions
from spikedeploy.trainers.sparse_ppo.replay import replay_of
from spikedeploy.trainers.sparse_ppo.trials import Course, Tiles, Trials, states, tiles

_EPS = 1e-8
_FASTER, _RATES = 1.5, (1e-6, 1e-2)  # factor by which the learning rate changes, and its limits


class SparsePpoLearner:
    """A pruned policy with its exploration, and a critic.

    student: the policy with its masks and the rounding of its weights
    head: exploration
    critic: value of an observation, in units of `scale`
    scale: standard deviation of the first iteration's returns; nan before
    rate: learning rate of the policy
    """

    def __init__(self, config: SparsePpoConfig, source: SparseConfig, policy: Policy) -> None:
        self._config, self._source = config, source
        self.student = replay_of(policy, source, config.burn_in)
        self.head: NoisyActions | CategoricalHead = (
            CategoricalHead() if policy.head == "discrete" else NoisyActions(config.noise[0])
        )
        self.critic = Critic(policy.observations, config.critic_hidden)
        self.scale = torch.tensor(torch.nan)
        self.rate = config.actor_rate
        for name, parameter in policy.named_parameters():
            parameter.requires_grad_(config.learns == "all" or name in self.student.readout)
        self._actor_adam = adam.adam(policy, config.actor_rate)
        self._critic_adam = adam.adam(self.critic, config.critic_rate)

    def schedule(self, progress: float) -> None:
        """Set everything that falls from the first iteration, 0, to the last, 1."""
        config = self._config
        if isinstance(self.head, NoisyActions):
            self.head.spread = _between(config.noise, progress)
        else:
            self.head.temperature = _between(config.temperature, progress)

    def exploring(self) -> Exploring:
        """Return a controller that explores, with the weights that are computed with."""
        return Exploring(self.student.acting(), self.head)

    def operations(self, pool: WalkPool) -> float:
        """Return the mean operations of a control step on new walks, and prepare their windows."""
        self.student.prepare(pool)
        found = tiles(pool, self._config.window, self._config.burn_in)
        with torch.no_grad():
            _, activities = self._replayed(found.windows)
        return self.student.operations([each[found.counts] for each in activities])

    def learn(
        self, pool: WalkPool, drawn: Tensor, earned: Sequence[Earned], actor: bool
    ) -> dict[str, float]:
        """Learn from walks, and return the metrics.

        pool: the walks of this iteration alone
        drawn: (S, W, act) or (S, W) actions as drawn
        actor: whether the policy learns, too
        """
        row = {"operations": self.operations(pool)}
        advantage = self._assess(pool, earned, row)
        if actor:
            found = tiles(pool, self._config.window, self._config.burn_in)
            self._improve(self.trials(found, drawn, advantage), row)
        return row

    @torch.no_grad()
    def trials(self, found: Tiles, drawn: Tensor, advantage: Tensor) -> Trials:
        """Return windows with drawn actions and advantages (S, W), these normalised."""
        counted = found.of(advantage)[found.counts]
        normal = (advantage - counted.mean()) / (counted.std() + _EPS)
        chosen = found.of(drawn)
        mean, _ = self._replayed(found.windows)
        before = self.log_probability(mean, chosen)
        return Trials(found.windows, chosen, found.of(normal), found.counts, before)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return log-probabilities (n, L) of drawn actions for means (n, L, act)."""
        return self.head.log_probability(mean.flatten(0, 1), drawn.flatten(0, 1)).view(
            mean.shape[:2]
        )

    def _replayed(self, windows: Windows) -> tuple[Tensor, list[Tensor]]:
        """Return means (n, L, act) and hidden activities (n, L, H) behind the burn-in."""
        burn_in = self._config.burn_in
        mean, activities = self.student.replay(windows)
        return mean[:, burn_in:], [each[:, burn_in:] for each in activities]

    def _assess(self, pool: WalkPool, earned: Sequence[Earned], row: dict[str, float]) -> Tensor:
        """Return advantages (S, W), after which the critic learns from them."""
        config, course = self._config, Course.of(earned)
        seen = [self.student.policy.normalizer(each) for each in states(pool.walks, earned)]
        if self.scale.isnan():
            zeros = [each.new_zeros(len(each)) for each in seen]
            returns = course.advantages(zeros, config.gamma, 1.0)[course.counts]
            self.scale = returns.std() + _EPS
            self.critic.value.bias.data.fill_(float(returns.mean() / self.scale))
        course = replace(course, reward=course.reward / self.scale)
        with torch.no_grad():
            values = [self.critic(each) for each in seen]
        advantage = course.advantages(values, config.gamma, config.trace)
        target = [advantage[: len(value) - 1, k] + value[:-1] for k, value in enumerate(values)]
        error = advantage[course.counts].var() / torch.cat(target).var()
        row["explained"] = 1.0 - float(error)
        row["critic_loss"] = self._fit(torch.cat([each[:-1] for each in seen]), torch.cat(target))
        return advantage

    def _fit(self, seen: Tensor, target: Tensor) -> float:
        """Let the critic learn targets (N,) of states (N, obs); return the last pass's error."""
        config = self._config
        for _ in range(config.critic_epochs):
            parts = torch.randperm(len(seen)).tensor_split(max(1, len(seen) // config.critic_batch))
            losses = []
            for chosen in parts:
                loss = functional.mse_loss(self.critic(seen[chosen]), target[chosen])
                descend(self._critic_adam, self.critic, loss, config.gradient_norm)
                losses.append(float(loss.detach()))
        return sum(losses) / len(losses)

    def _improve(self, trials: Trials, row: dict[str, float]) -> None:
        """Pass over the windows until the divergence limit; add the mean metrics to the row."""
        rows: list[dict[str, float]] = []
        limit = 2 * self._config.target_kl
        for _ in range(self._config.epochs):
            newest = [self._update(part) for part in trials.minibatches(self._config.batch)]
            rows += newest
            divergence = newest[-1]["kl"]
            if divergence < limit / 4:
                self.rate = min(self.rate * _FASTER, _RATES[1])
            elif divergence > limit:
                self.rate = max(self.rate / _FASTER, _RATES[0])
                break
        row |= {name: sum(each[name] for each in rows) / len(rows) for name in rows[0]}
        row |= {"kl": rows[-1]["kl"], "learning_rate": self.rate}

    def _update(self, part: Trials) -> dict[str, float]:
        """Take one gradient step of the policy."""
        config, policy = self._config, self.student.policy
        for group in self._actor_adam.param_groups:
            group["lr"] = self.rate
        mean, activities = self._replayed(part.windows)
        change = (self.log_probability(mean, part.drawn) - part.before)[part.counts]
        ratio, advantage = change.exp(), part.advantage[part.counts]
        limited = ratio.clamp(1.0 - config.clip, 1.0 + config.clip)
        # L = -E[min(ratio A, clip(ratio) A)] + imitation E + penalty sum(rate fan-out) / budget
        gain = torch.min(ratio * advantage, limited * advantage).mean()
        label = part.windows.label[:, config.burn_in :]
        error = imitation(mean, label, policy, self._source.sharpness)[part.counts].mean()
        hidden = self.student.hidden([each[part.counts] for each in activities])
        budget = max(self._source.budget, self._source.penalty_floor)
        loss = -gain + config.imitation * error + config.penalty * hidden / budget
        descend(self._actor_adam, policy, loss, config.gradient_norm)
        with torch.no_grad():
            return {
                "gain": float(gain),
                "imitation": float(error),
                # (r - 1) - log r is never negative, and its mean is the divergence
                "kl": float((ratio - 1.0 - change).mean()),
                "clipped": float((ratio != limited).float().mean()),
            }

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name."""
        parts: dict[str, Mapping[str, Tensor]] = {
            "critic": self.critic.state_dict(),
            "actor_adam": adam.tensors(self._actor_adam),
            "critic_adam": adam.tensors(self._critic_adam),
        }
        named = {f"{part}.{key}": t for part, found in parts.items() for key, t in found.items()}
        rate = torch.tensor(self.rate, dtype=torch.float64)
        return {**named, "scale": self.scale, "rate": rate}

    def load(self, named: dict[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        self.student.policy.load_state_dict(adam.under("policy", named))
        self.critic.load_state_dict(adam.under("critic", named))
        adam.load(self._actor_adam, adam.under("actor_adam", named))
        adam.load(self._critic_adam, adam.under("critic_adam", named))
        self.scale, self.rate = named["scale"], float(named["rate"])


def _between(ends: tuple[float, float], progress: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * progress
