"""Soft actor-critic for continuous actions: off-policy, from a replay buffer.

A run, its replay buffer, networks and their gradient update (Haarnoja et al. 2018).
"""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, model_validator
from torch import Tensor, nn

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import (
    Batch,
    EnvConfig,
    Kept,
    Positive,
    Ramp,
    Rate,
    RunConfig,
    Share,
    Width,
)
from spikedeploy.trainers.env_batch import Steps
from spikedeploy.trainers.policies import from_config
from spikedeploy.trainers.policies.policy import Latent, Moments, Policy, full_precision
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.runner import Critic, EnvRunner, Learner, adam
from spikedeploy.trainers.surrogate_neurons import excess_rate

_AVERAGED = 10  # at first the averaged policy spans the last 1/10 of the updates
_LOG_STD = (-20.0, 2.0)  # limits (Haarnoja et al. 2018)


class SacConfig(RunConfig):
    """Soft actor-critic with a scheduled or a learned temperature (Haarnoja et al. 2018).

    steps: environment steps in total; 500 episodes of 1,000
    warm_up: steps with uniform random actions before the first update
    update_every: environment steps per gradient update
    temperature: weight of the entropy, along environment steps
    learn_temperature: begin with `temperature.start` and learn it instead, so that the mean entropy
        of the actor is minus one nat for each action (Haarnoja et al. 2018, "Algorithms and
        Applications", section 5): it follows the size of the rewards
    epsilon: added inside the logarithm of the tanh correction
    averaging: weight of the newest parameters in the averaged policy, which is validated and
        saved; 1 saves the actor's own
    mean_penalty: weight of the squared pre-tanh mean in the actor's loss
    smoothness: weight of the squared change of the policy's action, summed over actions, from each
        state to the following one, in the actor's loss (Mysore et al. 2021, temporal term)
    shaping: extra weights of reward terms by name, in training only: updates see
        reward + sum of weight x term, so {"power": 2} counts power three times. Validation,
        metrics and the choice of the best checkpoint stay with the environment's own reward
    rate_penalty, rate_target: weight and threshold of the hinge on mean firing rates [spikes per
        neuron and timestep]; no effect on an MLP
    device: where networks and their gradients are computed; environments and the replay stay in
        main memory. "cuda" does not give the same bits twice
    support_force: fraction of the full upward force on the robot, along environment steps
    """

    steps: Positive = 500_000
    warm_up: Positive = 10_000
    update_every: Positive = 4
    batch: Batch = 128
    buffer: Kept = 1_000_000
    critic_hidden: tuple[Width, ...] = (512, 512)
    learning_rate: Rate = 3e-4
    gamma: Share = 0.99
    tau: Share = 0.005
    temperature: Ramp = Ramp(start=0.05, end=0.02, begin=50_000, finish=180_000)
    learn_temperature: bool = False
    epsilon: Rate = 1e-6
    averaging: Share = 1e-4
    mean_penalty: float = Field(default=0.05, ge=0)
    smoothness: float = Field(default=0.0, ge=0)
    shaping: dict[str, float] = Field(default_factory=dict)
    rate_penalty: float = Field(default=0.0, ge=0)
    rate_target: Share = 0.13
    support_force: Ramp = Ramp(start=1.0, end=0.0, finish=150_000)
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    device: Literal["cpu", "cuda"] = "cpu"
    log_every: Positive = 1_000
    checkpoint_every: Positive = 25_000

    @model_validator(mode="after")
    def _can_be_trained(self) -> "SacConfig":
        if self.learn_temperature and self.temperature.start <= 0:
            raise ValueError(
                f"temperature.start: {self.temperature.start:g} cannot be learned from, as its "
                "logarithm is: begin above 0, or set learn_temperature=false"
            )
        if self.device == "cuda" and self.precision != "float32":
            raise ValueError("device: cuda computes in float32 here: set precision=float32 as well")
        if self.device == "cuda" and not torch.cuda.is_available():
            raise ValueError("device: this PyTorch finds no CUDA device; set device=cpu")
        return self


@dataclass(frozen=True)
class ReplayBatch:
    """Transitions drawn at random.

    observation, following: (B, obs) raw, before and after the action
    action: (B, act)
    reward: (B,)
    terminated: (B,) 1 at terminal states, 0 where the episode continued or was truncated
    """

    observation: Tensor
    action: Tensor
    reward: Tensor
    terminated: Tensor
    following: Tensor


class ReplayBuffer:
    """The last `capacity` transitions, in float32.

    size: number of transitions held
    """

    def __init__(self, capacity: int, observations: int, actions: int) -> None:
        self.widths = [observations, actions, 1, 1, observations]
        # np.zeros takes no memory until it is written: memory grows with the transitions held
        self.rows = np.zeros((capacity, sum(self.widths)), np.float32)
        self.size = 0
        self.next = 0

    def add(
        self,
        observation: NDArray[np.float64],
        action: NDArray[np.float64],
        reward: NDArray[np.float64],
        terminated: NDArray[np.bool_],
        following: NDArray[np.float64],
    ) -> None:
        """Add transitions, one for each row of the arguments (B, ...)."""
        parts = (observation, action, reward[:, None], terminated[:, None], following)
        count, capacity = len(reward), len(self.rows)
        places = np.arange(self.next, self.next + count) % capacity
        self.rows[places] = np.concatenate(parts, axis=1)
        self.next = (self.next + count) % capacity
        self.size = min(self.size + count, capacity)

    def sample(
        self, count: int, rng: np.random.Generator, device: torch.device | str = "cpu"
    ) -> ReplayBatch:
        """Return transitions drawn uniformly with replacement."""
        rows = torch.from_numpy(self.rows[rng.integers(self.size, size=count)]).to(device)
        observation, action, reward, terminated, following = torch.split(rows, self.widths, dim=1)
        return ReplayBatch(observation, action, reward[:, 0], terminated[:, 0], following)

    def tensors(self) -> dict[str, Tensor]:
        """Return the transitions held by name, for a checkpoint."""
        return {"replay": torch.from_numpy(self.rows[: self.size])}

    def load(self, held: NDArray[np.float32], place: int) -> None:
        """Take over what `tensors` returned with the next place; the newest where it is too much.

        In a full ring each transition takes its place again, as updates draw places.
        """
        capacity = len(self.rows)
        if len(held) != capacity:
            held = np.roll(held, -place, axis=0)[-capacity:]  # oldest first
            place = len(held) % capacity
        self.rows[: len(held)] = held
        self.size, self.next = len(held), place


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


class TwinCritic(nn.Module):
    """Two critics of observation and action, used by their minimum (Fujimoto et al. 2018)."""

    def __init__(self, observations: int, actions: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.pair = nn.ModuleList(Critic(observations + actions, hidden) for _ in range(2))

    def forward(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return both estimates (B,) for a normalised observation and an action."""
        inputs = torch.cat([observation, action], dim=1)
        first, second = (critic(inputs) for critic in self.pair)
        return first, second


@torch.no_grad()
def move_towards(target: nn.Module, source: nn.Module, tau: float) -> None:
    """Move the target's parameters towards the source's by the share tau."""
    # target = target + tau (source - target)
    torch._foreach_lerp_(list(target.parameters()), list(source.parameters()), tau)


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


class SacLearner(Learner):
    """Actor, twin critics, their targets and optimisers.

    policy: running average of the actor's policy, which is saved and deployed
    temperature: None where it is scheduled
    """

    def __init__(self, config: SacConfig, policy: Policy) -> None:
        self._config, self.device = config, torch.device(config.device)
        sizes = policy.observations, policy.actions
        self.policy = policy.requires_grad_(False)
        self.actor = GaussianActor(copy.deepcopy(policy).requires_grad_(), config.epsilon)
        self.critic = TwinCritic(*sizes, config.critic_hidden)
        self.target = copy.deepcopy(self.critic).requires_grad_(False)
        self.temperature: Temperature | None = None
        if config.learn_temperature:
            self.temperature = Temperature(config.temperature.start, -float(policy.actions))
        self.modules = {"actor": self.actor, "critic": self.critic, "target": self.target}
        if self.temperature is not None:
            self.modules["temperature"] = self.temperature
        for module in (self.policy, *self.modules.values()):
            module.to(self.device)
        learned = {name: module for name, module in self.modules.items() if name != "target"}
        self.optimizers = {
            f"{name}_adam": adam(module, config.learning_rate) for name, module in learned.items()
        }

    def adopt(self, moments: Moments) -> None:
        """Normalise observations by these statistics."""
        for policy in (self.policy, self.actor.policy):
            policy.normalizer.adopt(moments)

    def average(self, updates: int) -> None:
        """Update the averaged policy (Polyak and Juditsky 1992)."""
        # spans the last tenth of the updates at first, later the last 1 / averaging of them
        share = max(self._config.averaging, _AVERAGED / (updates + _AVERAGED - 1))
        move_towards(self.policy, self.actor.policy, share)

    @torch.no_grad()
    def explore(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return actions (B, act) drawn from the actor's distribution."""
        action: Tensor = self.actor(torch.from_numpy(observation).float().to(self.device))[0]
        return action.double().cpu().numpy()

    def update(self, batch: ReplayBatch, temperature: float) -> dict[str, Tensor]:
        """Take one gradient step and return the losses.

        temperature: the scheduled one, in place of which a learned one is used
        """
        if self.temperature is not None:
            temperature = self.temperature.value
        observation = self.actor.policy.normalizer(batch.observation)
        with self._autocast():
            goal = self._goal(batch, temperature)
        # separate contexts, because each caches low-precision copies of the weights
        with self._autocast():
            first, second = self.critic(observation, batch.action)
            mse = nn.functional.mse_loss
            critic_loss = mse(first, goal) + mse(second, goal)
        self._descend("critic", critic_loss)
        with self._autocast():
            actor_loss, entropy = self._actor_loss(observation, batch, temperature)
        self._descend("actor", actor_loss)
        if self.temperature is not None:
            self._descend("temperature", self.temperature.loss(entropy))
        move_towards(self.target, self.critic, self._config.tau)
        losses = {"critic_loss": critic_loss, "actor_loss": actor_loss, "entropy": entropy}
        return {name: loss.detach() for name, loss in losses.items()}

    def _descend(self, name: str, loss: Tensor) -> None:
        """Take one gradient step on the loss, in the parameters of a network only."""
        parameters = list(self.modules[name].parameters())
        gradients = torch.autograd.grad(loss, parameters)
        for parameter, gradient in zip(parameters, gradients, strict=True):
            parameter.grad = gradient
        self.optimizers[f"{name}_adam"].step()

    @torch.no_grad()
    def _goal(self, batch: ReplayBatch, temperature: float) -> Tensor:
        """Return the targets of the critics (B,)."""
        action, log_prob, _ = self.actor(batch.following)
        following = self.actor.policy.normalizer(batch.following)
        value = torch.minimum(*self.target(following, action))
        # y = r + gamma (1 - terminated) (min Q'(s', a') - temperature log p(a'))
        value = value - temperature * log_prob
        goal: Tensor = batch.reward + self._config.gamma * (1 - batch.terminated) * value
        return goal

    def _actor_loss(
        self, observation: Tensor, batch: ReplayBatch, temperature: float
    ) -> tuple[Tensor, Tensor]:
        """Return the actor's loss and the policy's entropy."""
        config = self._config
        action, log_prob, latent = self.actor(batch.observation)
        value = torch.minimum(*self.critic(observation, action))
        # a large mean saturates tanh and leads to bang-bang control
        penalty = config.mean_penalty * latent.mean.square().sum(-1).mean()
        if config.rate_penalty:
            penalty = penalty + config.rate_penalty * excess_rate(latent.rates, config.rate_target)
        loss = (temperature * log_prob - value).mean() + penalty
        if config.smoothness:
            # a policy whose action jumps between neighbouring states makes the joints chatter
            after = self.actor.policy.latent(batch.following).mean
            change = (torch.tanh(after) - torch.tanh(latent.mean)).square().sum(-1).mean()
            loss = loss + config.smoothness * change
        return loss, -log_prob.detach().mean()

    def _autocast(self) -> torch.autocast:
        enabled = self._config.precision == "bfloat16"
        return torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled)


# -- a run


class Sac(EnvRunner[SacConfig]):
    """One run of soft actor-critic.

    updates: gradient updates so far
    """

    Config = SacConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "env_steps", "updates", "episodes", "episode_return", "support_force", "temperature",
        "actor_loss", "critic_loss", "entropy", "steps_per_s", "eval_return", "eval_speed",
        "eval_cot", "eval_falls", "eval_speed_rmse", "eval_turn_rmse",
    )  # fmt: skip
    COUNTERS = ("env_steps", "updates", "episodes", "best")
    VALIDATES_AT_END = False
    learner: SacLearner

    def __init__(self, config: SacConfig, run: RunFolder) -> None:
        super().__init__(config, run, config.steps, config.checkpoint_every, config.log_every)
        sizes = self._envs.sizes
        if self._envs.head == "discrete":
            raise ConfigError(
                f"sac learns continuous actions, and {self._envs.env_id} takes one of {sizes[1]} "
                "discrete ones: train it with a recipe of ppo"
            )
        check_shaping(config.shaping, config.env)
        self.policy = from_config(config.policy, *sizes, config.normaliser.clip)
        self.learner = SacLearner(config, self.policy)
        self._buffer = ReplayBuffer(min(config.buffer, config.steps), *sizes)
        self.updates = 0
        self._losses: Mapping[str, Tensor | float] = {}

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        self._collect()
        self._update()
        return True

    @property
    def _support_force(self) -> float:
        return self.config.support_force.value(self.env_steps)

    def _collect(self) -> None:
        """Take one step in every environment, and store it."""
        self._envs.support_force(self._support_force)
        warming_up = self.env_steps < self.config.warm_up
        explore = self.learner.explore
        actions = self._envs.uniform() if warming_up else explore(self._envs.observation)
        counts = self.env_steps < self.config.normaliser.finish
        steps = self._envs.step(actions)
        reward = shape_reward(self.config.shaping, steps)
        self._buffer.add(steps.observation, steps.action, reward, steps.terminated, steps.following)
        if counts:
            self._moments.add(steps.observation)
            self.learner.adopt(self._moments)

    def _update(self) -> None:
        """Make the updates that are due after the steps so far."""
        wanted = (self.env_steps - self.config.warm_up) // self.config.update_every
        scheduled = self.config.temperature.value(self.env_steps)
        while self.updates < wanted:
            batch = self._buffer.sample(self.config.batch, self._rng, self.learner.device)
            self._losses = self.learner.update(batch, scheduled)
            self.updates += 1
            self.learner.average(self.updates)

    def _row(self) -> dict[str, float]:
        self._count_episodes()
        return super()._row()

    def _metrics(self) -> dict[str, float]:
        learned = self.learner.temperature
        scheduled = self.config.temperature.value(self.env_steps)
        return {
            "support_force": self._support_force,
            "temperature": scheduled if learned is None else learned.value,
            **{name: float(loss) for name, loss in self._losses.items()},
        }

    def _state(self) -> dict[str, Any]:
        losses = {name: float(loss) for name, loss in self._losses.items()}
        return {**super()._state(), "losses": losses, "next": self._buffer.next}

    def _tensors(self) -> dict[str, Tensor]:
        """Return more tensors for the checkpoint "last"; a finished run needs no replay."""
        return {**super()._tensors(), **({} if self.finished else self._buffer.tensors())}

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        super()._restore(state, tensors)
        self._losses = state["losses"]
        if self.finished:
            return
        if "replay" not in tensors:
            why = (
                "it is finished, and a finished run has none: start a new run with more steps"
                if state["finished"]
                else "another version made the run: use that one, or train it anew"
            )
            raise ConfigError(f"{self._run.path} has no replay to go on from, as {why}")
        self._buffer.load(tensors["replay"].numpy(), state["next"])


def check_shaping(weights: Mapping[str, float], env: EnvConfig) -> None:
    """Raise ConfigError if the environment's reward lacks one of the terms."""
    if not weights:
        return
    probe = envs.make(env.name, **env.options)
    probe.reset(seed=0)
    info = probe.step(np.zeros(probe.action_space.shape))[4]  # the first has all terms
    probe.close()
    terms = list(info.get("reward_terms", {}))
    if unknown := sorted(set(weights) - set(terms)):
        raise ConfigError(
            f"shaping names {', '.join(unknown)}, which the reward of {env.name} does not have: "
            + (f"its terms are {', '.join(terms)}" if terms else "it has no named terms")
        )


def shape_reward(weights: Mapping[str, float], steps: Steps) -> NDArray[np.float64]:
    """Return the reward of each step (B,) with the extra weights."""
    # r' = r + sum over terms of weight x term
    extra = np.zeros(len(steps.reward))
    if weights:
        each = (info["reward_terms"] for info in steps.infos)
        extra += [sum(weight * terms[name] for name, weight in weights.items()) for terms in each]
    return steps.reward + extra
