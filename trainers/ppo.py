"""Proximal policy optimisation: act in a batch of environments, learn from the newest steps."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.nn import functional

from spikedeploy.envs.ghosts import POSE, GhostRecorder
from spikedeploy.trainers.config import (
    Batch,
    Count,
    EnvConfig,
    MlpConfig,
    NormaliserConfig,
    Positive,
    Ramp,
    Rate,
    RunConfig,
    Share,
    ValidationConfig,
    Width,
)
from spikedeploy.trainers.env_batch import EnvBatch, Steps
from spikedeploy.trainers.learner import Critic, adam, adam_tensors, load_adam, under
from spikedeploy.trainers.metrics import Metrics, Table
from spikedeploy.trainers.policies import Head, Policy, from_config
from spikedeploy.trainers.policies.neurons import excess_rate
from spikedeploy.trainers.progress import Journal
from spikedeploy.trainers.run_folder import RunFolder, write_errors
from spikedeploy.trainers.runner import EnvRunner

# -- Configuration of proximal policy optimisation.

HOLDS = 2  # validations in a row, so that greedy driving that swings is no success


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
    stop_at_finishes: finished episodes after which training ends; 0 for no limit
    stop_at_greedy: share of validation episodes that must finish, twice in a row, for training to
        end; 0 for no limit. With both limits it ends when both are reached
    running_total: whether every step pays the sum of its episode's rewards so far, as the
        environments of kart-simulator do; returns in logs stay those of the environment
    ghosts: whether training episodes are saved for `replay`, in environments with poses
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
    stop_at_finishes: Count = 0
    stop_at_greedy: Share = 0.0
    running_total: bool = False
    ghosts: bool = True
    checkpoint_every: Positive = 50_000

    @model_validator(mode="after")
    def _observes_everything(self) -> "PpoConfig":
        if isinstance(self.policy, MlpConfig) and self.policy.features != "all":
            raise ValueError("ppo learns from all observations: distil policies that observe less")
        return self

    def reached(self, finishes: int, held: int) -> bool:
        """Return whether training may end before its last step: every limit that is set is reached.

        finishes: finished episodes of training
        held: latest validations in a row with at least `stop_at_greedy`
        """
        limits = []
        if self.stop_at_finishes:
            limits.append(finishes >= self.stop_at_finishes)
        if self.stop_at_greedy:
            limits.append(held >= HOLDS)
        return bool(limits) and all(limits)


# -- Batches of PPO: the newest steps of all copies, and their advantages.


@dataclass(frozen=True)
class Transition:
    """One step of all B copies.

    encoded: (B, ...) encoding of the observation, see `Policy.sample_encoding`
    observation, following: (B, obs) before and after the step
    drawn: (B,) or (B, act) action as drawn by `ppo.heads`
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

    def __len__(self) -> int:
        return len(self.advantage)

    def minibatches(self, size: int) -> Iterator["RolloutBatch"]:
        """Yield all steps once, shuffled, in minibatches of at least `size`."""
        order = torch.randperm(len(self))
        count = max(1, len(self) // size)
        for chosen in order.tensor_split(count):
            yield RolloutBatch(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


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


def stacked(transitions: list[Transition]) -> Transition:
    """Return K transitions as one, with arrays (K, B, ...)."""
    names = Transition.__dataclass_fields__
    return Transition(
        *(torch.stack([getattr(step, name) for step in transitions]) for name in names)
    )


# -- Networks of PPO and their gradient updates: policy, distributions of actions, critic.

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
        self._actor_adam = adam(self.actor, config.actor_rate.start)
        self._critic_adam = adam(self.critic, config.critic_rate)
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
            "actor_adam": adam_tensors(self._actor_adam),
            "critic_adam": adam_tensors(self._critic_adam),
        }
        return {f"{part}.{key}": t for part, named in parts.items() for key, t in named.items()}

    def load(self, named: dict[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        self.policy.load_state_dict(under("policy", named))
        self.head.load_state_dict(under("head", named))
        self.critic.load_state_dict(under("critic", named))
        load_adam(self._actor_adam, under("actor_adam", named))
        load_adam(self._critic_adam, under("critic_adam", named))


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


# -- Logs of training episodes: a CSV file of results, and ghosts for `spikedeploy replay`.

_OUTCOMES = ("finish", "crash", "gates", "lap_time")  # of the last info, if it has them
_COLUMNS = ("env_steps", "steps", "return", "success", *_OUTCOMES)


def episode_table(run: Path) -> Table:
    """Return the table of a run's episodes."""
    return Table(run / "episodes.csv", _COLUMNS, "episode_logged")


class EpisodeLog:
    """CSV file with a row for each episode, in the order in which they end.

    finishes: episodes so far that ended at the finish
    latest: environment steps at the last row, None before there is one
    """

    latest: int | None = None

    def __init__(self, run: Path, copies: int, finishes: int = 0) -> None:
        self._file = Metrics(episode_table(run).path, _COLUMNS)
        self._steps, self._totals = np.zeros(copies, np.int64), np.zeros(copies)
        self.finishes = finishes

    def rewind(self, env_steps: int) -> None:
        """Drop the rows after a step, on resuming from it."""
        self._file.rewind(env_steps)

    def begin(self, k: int) -> None:
        """Forget what copy k did: its episode begins."""
        self._steps[k], self._totals[k] = 0, 0.0

    def repeat(self, k: int, reward: float) -> None:
        """Count a step of copy k that is repeated when a run is resumed."""
        self._steps[k] += 1
        self._totals[k] += reward

    def add(self, steps: Steps, env_steps: int) -> None:
        """Add one step of every copy, taken after `env_steps` environment steps in total."""
        self._steps += 1
        self._totals += steps.reward
        for k in np.flatnonzero(steps.terminated | steps.truncated):
            # copies are stepped in order, so that this is the number of the step that ended it
            self._end(int(k), steps.infos[k], env_steps + int(k) + 1)

    def _end(self, k: int, info: Mapping[str, Any], env_steps: int) -> None:
        row = {
            "env_steps": env_steps,
            "steps": int(self._steps[k]),
            "return": float(self._totals[k]),
            "success": float(info.get("success", False)),
            **{name: float(info[name]) for name in _OUTCOMES if name in info},
        }
        self._file.add(row)
        self.finishes += int(row.get("finish", 0.0))
        self.latest = env_steps
        self.begin(k)


def has_poses(batch: EnvBatch) -> bool:
    """Return whether the environment's infos hold poses, which ghosts need."""
    return all(name in start.info for start in batch.starts for name in POSE)


class GhostLog:
    """Ghosts of every copy, in one file <iteration>.npz for each iteration.

    folder: of the files
    """

    def __init__(self, folder: Path, batch: EnvBatch, config: EnvConfig) -> None:
        self._folder, self._batch = folder, batch
        self._recorder = GhostRecorder(batch.env_id, config.options, len(batch))
        for k in range(len(batch)):
            self.begin(k)

    def add(self, steps: Steps, env_steps: int) -> None:
        """Add one step of every copy, taken after `env_steps` environment steps in total."""
        ended = steps.terminated | steps.truncated
        for k, info in enumerate(steps.infos):
            self._recorder.add(k, info, steps.action[k], float(steps.reward[k]))
        for k in np.flatnonzero(ended).tolist():
            self._recorder.end(k, env_steps + k + 1)
            self.begin(k)

    def save(self, iteration: int) -> None:
        """Write the episodes that ended since the last file, if any."""
        ghosts = self._recorder.take()
        path = self._folder / f"{iteration:05d}.npz"
        if ghosts.drives:
            with write_errors(path):
                ghosts.save(path)

    def rewind(self, iteration: int) -> None:
        """Delete the files after an iteration, on resuming from it."""
        for path in self._folder.glob("*.npz"):
            # what somebody else put there has another name, and stays
            if path.stem.isdecimal() and int(path.stem) > iteration:
                path.unlink()

    def repeat(self, k: int, action: NDArray[Any], reward: float, info: Mapping[str, Any]) -> None:
        """Record a step of copy k that is repeated when a run is resumed."""
        self._recorder.add(k, info, action, reward)

    def begin(self, k: int) -> None:
        """Record the reset of copy k."""
        start = self._batch.starts[k]
        self._recorder.begin(k, start.info, start.seed)


# -- Proximal policy optimisation: act in a batch of environments, learn from the newest steps.


class Ppo(EnvRunner[PpoConfig]):
    """One run of proximal policy optimisation.

    iterations: batches collected and learned from so far
    held: latest validations in a row in which at least `stop_at_greedy` of the episodes finished
    """

    Config = PpoConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "env_steps",
        "iterations",
        "episodes",
        "finishes",
        "episode_return",
        "actor_loss",
        "critic_loss",
        "entropy",
        "kl",
        "clipped",
        "learning_rate",
        "steps_per_s",
        "eval_return",
        "eval_finish",
        "eval_crash",
        "eval_gates",
        "eval_speed",
    )
    COUNTERS = ("env_steps", "iterations", "episodes", "best", "finishes", "held")
    learner: PpoLearner

    def __init__(self, config: PpoConfig, run: RunFolder) -> None:
        super().__init__(
            config,
            run,
            total=config.steps,
            log_every=1,  # every iteration
            checkpoint_every=config.checkpoint_every,
        )
        self.policy = from_config(
            config.policy,
            self._envs.observation.shape[1],
            self._envs.actions,
            config.normaliser.clip,
            self._envs.columns,
            self._envs.head,
        )
        self.learner = PpoLearner(config, self.policy)
        self.iterations = self.held = 0
        self._totals: NDArray[np.float64] = np.zeros(len(self._envs))  # of the running episodes
        self._learned: dict[str, float] = {}
        self._log: EpisodeLog | None = None
        self._ghosts: GhostLog | None = None

    def learn(self, journal: Journal, stopped: Callable[[], bool]) -> None:
        """Train, from the checkpoint "last" if there is one, to the end or until stopped."""
        self._log = EpisodeLog(self._run.path, len(self._envs))
        if self._config.ghosts and has_poses(self._envs):
            self._ghosts = GhostLog(self._run.path / "ghosts", self._envs, self._config.env)
        super().learn(journal, stopped)

    def _forget(self) -> None:
        super()._forget()
        if self._ghosts:
            self._ghosts.rewind(0)

    @classmethod
    def tables(cls, run: RunFolder, config: RunConfig) -> list[Table]:
        """Return the tables that training appends to, and a checkpoint must agree with."""
        return [*super().tables(run, config), episode_table(run.path)]

    @property
    def finishes(self) -> int:
        """Episodes that ended at the finish."""
        return self._log.finishes if self._log else 0

    @property
    def finished(self) -> bool:
        """Whether all steps are taken, or as much was reached as was asked for."""
        return self._config.reached(self.finishes, self.held) or super().finished

    def _validate(self) -> dict[str, float]:
        row = super()._validate()
        enough = row.get("eval_finish", 0.0) >= self._config.stop_at_greedy
        self.held = self.held + 1 if enough else 0
        return row

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        before = self.env_steps
        self.learner.schedule(before)
        self._learned = self.learner.learn(self.collect(self._log))
        self._learned["learning_rate"] = self._config.actor_rate.at(before)
        self.iterations += 1
        self._count_episodes()
        if self._ghosts:
            self._ghosts.save(self.iterations)
        return True

    def collect(self, log: EpisodeLog | None = None) -> list[Transition]:
        """Take `horizon` steps in every environment."""
        transitions = []
        for _ in range(self._config.horizon):
            observation = torch.from_numpy(self._envs.observation).float()
            encoded, drawn, log_probability = self.learner.explore(observation)
            steps = self._envs.step(self.learner.head.action(drawn).numpy())
            paid = self._paid(steps)
            transitions.append(
                _transition(observation, steps, paid, encoded, drawn, log_probability)
            )
            if log:
                log.add(steps, self.env_steps)
            if self._ghosts:
                self._ghosts.add(steps, self.env_steps)
            self.env_steps += len(self._envs)
        self._update_normaliser(transitions)
        return transitions

    def _paid(self, steps: Steps) -> NDArray[np.float64]:
        """Return the rewards (B,) to learn from: of the step, or of the episode so far."""
        if not self._config.running_total:
            return steps.reward
        self._totals += steps.reward
        paid: NDArray[np.float64] = self._totals.copy()
        self._totals[steps.terminated | steps.truncated] = 0.0
        return paid

    def _update_normaliser(self, transitions: list[Transition]) -> None:
        """Add the observations to the normaliser, unless it is frozen."""
        begin = self.env_steps - len(transitions) * len(self._envs)
        if begin < self._config.normaliser.finish:
            for transition in transitions:
                seen = self.policy.features_of(transition.observation)
                self._moments.add(seen.double().numpy())
            self.policy.normalizer.adopt(self._moments)

    def _metrics(self) -> dict[str, float]:
        names = ("env_steps", "iterations", "episodes", "finishes")
        return {**{name: getattr(self, name) for name in names}, **self._learned}

    def _state(self) -> dict[str, Any]:
        return {**super()._state(), "episode_logged": self._log.latest if self._log else None}

    def episode_begun(self, k: int) -> None:
        """Forget what copy k did: its episode begins, when a run is resumed."""
        self._totals[k] = 0.0
        if self._log:
            self._log.begin(k)
        if self._ghosts:
            self._ghosts.begin(k)

    def step_repeated(
        self, k: int, action: NDArray[Any], reward: float, info: Mapping[str, Any]
    ) -> None:
        """Take a step of copy k into account that is repeated when a run is resumed."""
        self._totals[k] += reward
        if self._log:
            self._log.repeat(k, reward)
        if self._ghosts:
            self._ghosts.repeat(k, action, reward, info)

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        super()._restore(state, tensors)
        self.iterations, self.held = state["iterations"], state.get("held", 0)
        if self._log:
            self._log.finishes = state["finishes"]
            self._log.latest = state.get("episode_logged")
            self._log.rewind(self.env_steps)
        if self._ghosts:
            self._ghosts.rewind(self.iterations)


def _transition(
    observation: Tensor,
    steps: Steps,
    paid: NDArray[np.float64],
    encoded: Tensor,
    drawn: Tensor,
    log_probability: Tensor,
) -> Transition:
    return Transition(
        encoded=encoded,
        observation=observation,
        following=torch.from_numpy(steps.following).float(),
        drawn=drawn,
        log_probability=log_probability,
        reward=torch.from_numpy(paid).float(),
        terminated=torch.from_numpy(steps.terminated),
        ended=torch.from_numpy(steps.terminated | steps.truncated),
    )
