"""What the algorithm asks of a student: the loss of a batch, and its synapses with their rates."""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from itertools import pairwise
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers import adam
from spikedeploy.trainers.distill.teacher import surprise
from spikedeploy.trainers.policies import DeltaSnnPolicy, Policy, PrunedMlpPolicy
from spikedeploy.trainers.policies.delta_graph import delta_codec, delta_encoder, live_neurons
from spikedeploy.trainers.policies.delta_snn import DeltaWeights
from spikedeploy.trainers.policies.pruned import SynapseGroup
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import WalkPool

_SMOOTHING = 0.02  # weight of the newest batch in mean rates of hidden neurons


class Student(Protocol):
    """A policy that learns from walks."""

    @property
    def policy(self) -> Policy:
        """What is trained."""

    @property
    def neurons(self) -> int:
        """Hidden neurons that are left."""

    def prepare(self, pool: WalkPool) -> None:
        """Take over new walks."""

    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of a batch, and the hidden neurons' operations in a control step."""

    def synapses(self) -> list[SynapseGroup]:
        """Return all synapses."""

    def hidden_layers(self) -> list[tuple[SynapseGroup, SynapseGroup]]:
        """Return the synapses onto and from the neurons of each hidden layer."""

    def tensors(self) -> dict[str, Tensor]:
        """Return what a checkpoint holds beside the policy, by name."""

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore what `tensors` returned."""


def imitation(mean: Tensor, label: Tensor, policy: Policy, sharpness: float) -> Tensor:
    """Return the error of means (..., act) against the teacher's actions or logits (..., act)."""
    if policy.head == "continuous":
        return (torch.tanh(mean) - label).square().mean(-1)
    return surprise(mean, label, sharpness)


class DeltaStudent:
    """A DeltaSnnPolicy, which learns from windows of walks.

    hidden_rate: (H,) mean spikes of the hidden neurons in a control step
    offsets: what rounding by the chip adds to each field of DeltaWeights; none before it is asked
        for
    """

    def __init__(self, policy: DeltaSnnPolicy, config: SparseConfig) -> None:
        self.policy = policy
        self._config = config
        self.hidden_rate = torch.full((policy.hidden,), 0.15)
        self.offsets: Mapping[str, Tensor] = {}
        self._event_rate = torch.ones(policy.observations)

    def prepare(self, pool: WalkPool) -> None:
        """Compute the pool's events with the policy's encoder."""
        precise = deepcopy(self.policy).double()
        normaliser = delta_codec(precise).normaliser
        rows = (normaliser(walk.observation.astype(np.float64)) for walk in pool.walks)
        policy = self.policy
        pool.encode(rows, delta_encoder(precise), policy.current_decay, policy.delay)
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

    @property
    def neurons(self) -> int:
        """Hidden neurons that are left."""
        return int(live_neurons(self.policy).sum())

    def synapses(self) -> list[SynapseGroup]:
        """Return all synapses."""
        found = [group for pair in self.hidden_layers() for group in pair]
        past = SynapseGroup(self.policy.past, self._event_rate)
        return [*found, past] if self.policy.skip else found

    def hidden_layers(self) -> list[tuple[SynapseGroup, SynapseGroup]]:
        """Return the synapses onto and from the neurons of the layer, if there is one."""
        policy = self.policy
        into = SynapseGroup(policy.into, self._event_rate)
        out = SynapseGroup(policy.out, self.hidden_rate)
        return [(into, out)] if policy.hidden else []

    def tensors(self) -> dict[str, Tensor]:
        """Return rates and offsets of rounding, by name."""
        offsets = {f"offsets.{name}": added for name, added in self.offsets.items()}
        return {"hidden_rate": self.hidden_rate.clone(), **offsets}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore what `tensors` returned."""
        self.hidden_rate = named["hidden_rate"]
        self.offsets = adam.under("offsets", dict(named))


class MlpStudent:
    """A PrunedMlpPolicy, which learns from single states."""

    def __init__(self, policy: PrunedMlpPolicy, config: SparseConfig) -> None:
        self.policy = policy
        self._config = config
        # share of control steps in which each neuron is not 0, of each hidden layer
        self._rates = [torch.full((width,), 0.5) for width in policy.hidden]

    def prepare(self, pool: WalkPool) -> None:
        """Do nothing: states are drawn from the walks as they are."""

    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of states, and the hidden neurons' operations in a control step."""
        c = self._config
        count = c.batch * (c.window - c.burn_in)
        observation, label = pool.states(rng, count, c.crash_windows, c.crash_steps)
        mean, inputs = self.policy.activations(observation)
        rates = [(hidden > 0).float().mean(0) for hidden in inputs[1:]]
        self._rates = [
            torch.lerp(a, b, _SMOOTHING) for a, b in zip(self._rates, rates, strict=True)
        ]
        # the share of active neurons has no gradient; their activations stand for it
        costs = [
            (hidden.mean(0) * matrix.fan_out).sum()
            for hidden, matrix in zip(inputs[1:], self.policy.layers[1:], strict=True)
        ]
        error = imitation(mean, label, self.policy, c.sharpness).mean()
        return error, sum(costs, start=torch.zeros(()))

    @property
    def neurons(self) -> int:
        """Hidden neurons that are left."""
        return sum(int(matrix.mask.any(0).sum()) for matrix in self.policy.layers[1:])

    def synapses(self) -> list[SynapseGroup]:
        """Return all synapses."""
        # an observation is never exactly 0
        past = SynapseGroup(self.policy.past, torch.ones(self.policy.observations))
        return [*self._layers(), past] if self.policy.skip else self._layers()

    def hidden_layers(self) -> list[tuple[SynapseGroup, SynapseGroup]]:
        """Return the synapses onto and from the neurons of each hidden layer."""
        return list(pairwise(self._layers()))

    def _layers(self) -> list[SynapseGroup]:
        rates = [torch.ones(self.policy.observations), *self._rates]
        return [SynapseGroup(m, rate) for m, rate in zip(self.policy.layers, rates, strict=True)]

    def tensors(self) -> dict[str, Tensor]:
        """Return rates, by name."""
        return {f"rate{number}": rate.clone() for number, rate in enumerate(self._rates)}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore what `tensors` returned."""
        self._rates = [named[f"rate{number}"] for number in range(len(self._rates))]


def student(policy: Policy, config: SparseConfig) -> Student:
    """Return what the algorithm needs of a policy."""
    if isinstance(policy, DeltaSnnPolicy):
        return DeltaStudent(policy, config)
    if isinstance(policy, PrunedMlpPolicy):
        return MlpStudent(policy, config)
    raise ConfigError(
        f"a policy of kind {policy.kind!r} cannot be pruned: choose policy.kind delta-snn or "
        "pruned-mlp"
    )
