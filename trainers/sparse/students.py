"""What the algorithm asks of a student: the loss of a batch, and its synapses with their rates."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.trainers.policies import DeltaSnnPolicy, Policy, PrunedMlpPolicy
from spikedeploy.trainers.policies.delta_graph import delta_codec
from spikedeploy.trainers.policies.delta_snn import DeltaWeights
from spikedeploy.trainers.policies.pruned import Synapses
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import WalkPool

_SMOOTHING = 0.02  # weight of the newest batch in mean rates of hidden neurons


class Student(Protocol):
    """A policy that learns from walks."""

    policy: Policy
    hidden_rate: Tensor

    def prepare(self, pool: WalkPool) -> None:
        """Take over new walks."""

    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of a batch, and the hidden neurons' operations in a control step."""

    def synapses(self) -> list[Synapses]:
        """Return all synapses; those into and out of hidden neurons first."""


def imitation(mean: Tensor, label: Tensor, policy: Policy, sharpness: float) -> Tensor:
    """Return the error of means (..., act) against the teacher's actions or logits (..., act)."""
    if policy.head == "continuous":
        return (torch.tanh(mean) - label).square().mean(-1)
    target = torch.softmax(sharpness * label, -1)
    return -(target * functional.log_softmax(mean, -1)).sum(-1)


class DeltaStudent:
    """A DeltaSnnPolicy, which learns from windows of walks.

    hidden_rate: (H,) mean spikes of the hidden neurons in a control step
    offsets: what rounding by the chip adds to each kind of weights; none before it is asked for
    """

    def __init__(self, policy: DeltaSnnPolicy, config: SparseConfig) -> None:
        self.policy = policy
        self._config = config
        self.hidden_rate = torch.full((policy.hidden,), 0.15)
        self.offsets: Mapping[str, Tensor] = {}
        self._event_rate = torch.ones(policy.observations)

    def prepare(self, pool: WalkPool) -> None:
        """Compute the pool's events with the policy's encoder."""
        codec = delta_codec(self.policy.double())
        self.policy.float()
        encoder = codec.encoder
        if not isinstance(encoder, DeltaEncoder):
            raise TypeError("the codec of a DeltaSnnPolicy has a DeltaEncoder")
        # all channels, so that what pruning left out could come back in other rounds
        encoder = replace(encoder, step=self.policy.step.double().numpy())
        rows = (codec.normaliser(walk.observation.astype(np.float64)) for walk in pool.walks)
        pool.encode(rows, encoder, self.policy.current_decay)
        self._event_rate = pool.event_rate

    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of windows, and the hidden neurons' operations in a control step."""
        c = self._config
        batch = pool.sample(
            rng, c.batch, c.window, c.burn_in, c.first_windows, c.crash_windows, c.crash_steps
        )
        mean, spikes = self.policy.unrolled(
            batch.seen, batch.moved, self.weights(), c.burn_in, batch.begins
        )
        after = mean[:, c.burn_in :], batch.label[:, c.burn_in :]
        error = imitation(*after, self.policy, c.sharpness).mean()
        rate = spikes[:, c.burn_in :].mean((0, 1))
        self.hidden_rate = torch.lerp(self.hidden_rate, rate.detach(), _SMOOTHING)
        excess = (rate.sum() / max(len(rate), 1) - c.rate_target).relu()
        return error, (rate * self.policy.out.fan_out).sum() + c.rate_cost * excess

    def weights(self) -> DeltaWeights:
        """Return what is computed with: the policy's weights, as the chip rounds them."""
        weights = self.policy.weights()
        if not self.offsets:
            return weights
        kinds = {name: getattr(weights, name) + added for name, added in self.offsets.items()}
        return replace(weights, **kinds)

    def synapses(self) -> list[Synapses]:
        """Return all synapses; those into and out of hidden neurons first."""
        policy, events = self.policy, self._event_rate
        found = []
        if policy.hidden:
            found = [Synapses(policy.into, events), Synapses(policy.out, self.hidden_rate)]
        return [*found, Synapses(policy.past, events)] if policy.skip else found


class MlpStudent:
    """A PrunedMlpPolicy, which learns from single states.

    hidden_rate: mean share of control steps in which each hidden neuron is not 0
    """

    def __init__(self, policy: PrunedMlpPolicy, config: SparseConfig) -> None:
        self.policy = policy
        self._config = config
        self._rates = [torch.full((width,), 0.5) for width in policy.hidden]

    @property
    def hidden_rate(self) -> Tensor:
        """Mean share of control steps in which each hidden neuron is not 0."""
        return torch.cat(self._rates) if self._rates else torch.zeros(0)

    @hidden_rate.setter
    def hidden_rate(self, rate: Tensor) -> None:
        self._rates = list(rate.split(list(self.policy.hidden))) if len(rate) else []

    def prepare(self, pool: WalkPool) -> None:
        """Do nothing: states are drawn from the walks as they are."""

    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of states, and the hidden neurons' operations in a control step."""
        c = self._config
        count = c.batch * (c.window - c.burn_in)
        observation, label = pool.states(rng, count, c.crash_windows, c.crash_steps)
        mean, inputs = self.policy.activations(observation)
        matrices = list(self.policy.matrices)[1:]
        rates = [(hidden > 0).float().mean(0) for hidden in inputs[1:]]
        self._rates = [
            torch.lerp(a, b, _SMOOTHING) for a, b in zip(self._rates, rates, strict=True)
        ]
        # the share of active neurons has no gradient; their activations stand for it
        costs = [
            (hidden.mean(0) * matrix.fan_out).sum()
            for hidden, matrix in zip(inputs[1:], matrices, strict=True)
        ]
        error = imitation(mean, label, self.policy, c.sharpness).mean()
        return error, sum(costs, start=torch.zeros(()))

    def synapses(self) -> list[Synapses]:
        """Return all synapses; those into and out of hidden neurons first."""
        policy = self.policy
        always = torch.ones(policy.observations)
        rates = [always, *self._rates]
        found = [Synapses(m, rate) for m, rate in zip(policy.matrices, rates, strict=True)]
        return [*found, Synapses(policy.past, always)] if policy.skip else found


def student(policy: Policy, config: SparseConfig) -> Student:
    """Return what the algorithm needs of a policy."""
    if isinstance(policy, DeltaSnnPolicy):
        return DeltaStudent(policy, config)
    if isinstance(policy, PrunedMlpPolicy):
        return MlpStudent(policy, config)
    raise TypeError(f"{type(policy).__name__} is no policy that is pruned")
