"""Soft actor-critic: settings, replay buffer, networks and their gradient update."""

import copy
import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, model_validator
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file
from torch import Tensor, nn

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import replacing
from spikedeploy.trainers.config import (
    Batch,
    Kept,
    Positive,
    Ramp,
    Rate,
    RunConfig,
    Share,
    Width,
)
from spikedeploy.trainers.neurons import excess_rate
from spikedeploy.trainers.policies.policy import Latent, Moments, Policy, full_precision
from spikedeploy.trainers.run_folder import file_sha256, write_errors
from spikedeploy.trainers.runner import Critic, Learner, adam

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
    device: where gradients are computed; environments and validation stay on the CPU. "cuda" is
        worth it from layers of 256 on, and does not give the same bits twice
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
        self._store(places, np.concatenate(parts, axis=1))
        self.next = (self.next + count) % capacity
        self.size = min(self.size + count, capacity)

    def _store(self, places: NDArray[np.int64], rows: NDArray[np.float64]) -> None:
        """Put rows (B, all numbers of a transition) in their places (B,)."""
        self.rows[places] = rows

    def sample(self, count: int, rng: np.random.Generator) -> ReplayBatch:
        """Return transitions drawn uniformly with replacement."""
        return self.split(torch.from_numpy(self.rows[rng.integers(self.size, size=count)]))

    def split(self, rows: Tensor) -> ReplayBatch:
        """Return the transitions of rows (B, all numbers of a transition)."""
        observation, action, reward, terminated, following = torch.split(rows, self.widths, dim=1)
        return ReplayBatch(observation, action, reward[:, 0], terminated[:, 0], following)

    def save(self, path: Path) -> str:
        """Write the transitions held, oldest first; return the file's checksum."""
        start = self.next if self.size == len(self.rows) else 0
        held = np.concatenate([self.rows[start : self.size], self.rows[:start]])
        with write_errors(path):
            with replacing(path) as temporary:
                save_file({"rows": held, "next": np.array([self.next])}, temporary)
            return file_sha256(path)

    def load(self, path: Path, checksum: str) -> None:
        """Load the transitions of a file with this checksum; the newest where they are too many."""
        if not path.is_file():
            raise ConfigError(
                f"{path} is missing: resuming a run needs its replay, which a finished run no "
                "longer has. Start a new run with more steps."
            )
        try:
            if file_sha256(path) != checksum:
                raise ValueError("its content does not have the checksum in checkpoints/last")
            arrays = load_file(path)
            held, place = arrays["rows"], int(arrays["next"][0])
            if held.dtype != np.float32 or held.shape[1:] != self.rows.shape[1:]:
                raise ValueError(
                    f"its transitions are {held.dtype} {held.shape}, and this task has "
                    f"{self.rows.shape[1]} numbers in each"
                )
        except (SafetensorError, OSError, KeyError, ValueError) as error:
            raise ConfigError(
                f"{path} is damaged: {error}. The run cannot go on without it: put it back, or "
                f"train again; its policies are whole: `spikedeploy export "
                f"{shlex.quote(str(path.parent))}`."
            ) from error
        capacity = len(self.rows)
        held = held[-capacity:]
        # in a full ring each transition takes its place again, as updates draw places
        self.next = place % capacity if len(held) == capacity else len(held) % capacity
        first = self.next if len(held) == capacity else 0
        self.rows[first : len(held)] = held[: len(held) - first]
        self.rows[:first] = held[len(held) - first :]
        self.size = len(held)


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
        self.modules = {"actor": self.actor, "critic": self.critic, "target": self.target}
        if self.temperature is not None:
            self.modules["temperature"] = self.temperature
        rate = self._config.learning_rate
        learned = {name: module for name, module in self.modules.items() if name != "target"}
        self.optimizers = {f"{name}_adam": adam(module, rate) for name, module in learned.items()}

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

    @property
    def _acting(self) -> GaussianActor:
        """The actor that explores."""
        return self.actor

    @torch.no_grad()
    def explore(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return actions (B, act) drawn from the actor's distribution."""
        action: Tensor = self._acting(torch.from_numpy(observation).float())[0]
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
    def _goal(self, batch: ReplayBatch, temperature: float | Tensor) -> Tensor:
        """Return the targets of the critics (B,)."""
        action, log_prob, _ = self.actor(batch.following)
        following = self.actor.policy.normalizer(batch.following)
        value = torch.minimum(*self.target(following, action))
        # y = r + gamma (1 - terminated) (min Q'(s', a') - temperature log p(a'))
        value = value - temperature * log_prob
        goal: Tensor = batch.reward + self._config.gamma * (1 - batch.terminated) * value
        return goal

    def _actor_loss(
        self, observation: Tensor, batch: ReplayBatch, temperature: float | Tensor
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
