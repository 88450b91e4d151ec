"""Students: policies that learn from walks and are pruned.

Another kind of student is another subclass of Student, and a line of `student`.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill.teacher import compute_cross_entropy
from spikedeploy.trainers.policies import DeltaSnnPolicy, Policy, PrunedMlpPolicy
from spikedeploy.trainers.policies.delta_policy import (
    DeltaWeights,
    delta_codec,
    delta_encoder,
    live_neurons,
)
from spikedeploy.trainers.policies.policy import PrunedWeight, SynapseGroup
from spikedeploy.trainers.run_folder import with_prefix
from spikedeploy.trainers.sparse.delta_encoder import binary_columns, choose_steps
from spikedeploy.trainers.sparse.rounding import (
    round_for_chip,
    rounding_offsets,
    with_offsets,
)
from spikedeploy.trainers.sparse.settings import SparseConfig
from spikedeploy.trainers.sparse.walks import WalkPool, Windows

_SMOOTHING = 0.02  # weight of the newest batch in mean rates of hidden neurons


class Student:
    """A policy that learns from walks; without an encoder and rounding, as float policies are.

    policy: what is trained
    readout: names of the parameters behind the last hidden layer, and past it
    rates: mean operations of a synapse of each input, and of each neuron of each hidden layer, in a
        control step
    """

    policy: DeltaSnnPolicy | PrunedMlpPolicy
    readout: frozenset[str]

    def __init__(
        self,
        config: SparseConfig,
        layers: Sequence[PrunedWeight],
        past: PrunedWeight | None,
        rates: list[Tensor],
    ) -> None:
        self._config, self._layers, self._past, self.rates = config, layers, past, rates

    # the encoder

    def start(self, binary: NDArray[np.bool_]) -> None:
        """Set the first steps of the encoder, `binary` (obs,) of observations with two values."""

    def retune(self, pool: WalkPool, binary: NDArray[np.bool_]) -> None:
        """Set the encoder's steps anew, by how much each observation matters."""

    @abstractmethod
    def prepare(self, pool: WalkPool, binary: NDArray[np.bool_] | None = None) -> None:
        """Compute what `loss` and `replay` read of the pool's walks.

        binary: observations with two values, as far as is known; None to keep what is known of them
        """

    # learning

    @abstractmethod
    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of a batch, and the hidden neurons' operations in a control step."""

    @abstractmethod
    def replay(self, windows: Windows, burn_in: int) -> tuple[Tensor, list[Tensor]]:
        """Return means (B, L, act) and hidden activities (B, L, H) of windows."""

    # numbers of the chip

    @property
    def is_rounded(self) -> bool:
        """True if the forward pass computes with rounded numbers."""
        return False

    def round(self, target: Chip) -> None:
        """Compute with the numbers that the chip would have now, if the configuration says so."""

    def acting(self) -> Policy:
        """Return the policy with the numbers that are computed with."""
        return self.policy

    def deployed(self, target: Chip) -> Policy:
        """Return the policy that is validated and saved."""
        return self.policy

    # operations

    @property
    @abstractmethod
    def neurons(self) -> int:
        """Hidden neurons that are left."""

    def layers(self) -> list[SynapseGroup]:
        """Return the synapses onto each hidden layer, then those onto the output."""
        pairs = zip(self._layers, self.rates, strict=False)
        return [SynapseGroup(matrix, rate) for matrix, rate in pairs]

    def synapses(self) -> list[SynapseGroup]:
        """Return all synapses."""
        past = [] if self._past is None else [SynapseGroup(self._past, self.rates[0])]
        return [*self.layers(), *past]

    def hidden_layers(self) -> list[tuple[SynapseGroup, SynapseGroup]]:
        """Return the synapses onto and from the neurons of each hidden layer."""
        return list(pairwise(self.layers()))

    def hidden_operations(self, activities: Sequence[Tensor]) -> Tensor:
        """Return the hidden neurons' operations for activities (n, H), with a gradient.

        Of a float network it is the mean activation times the fan-out, since the share of active
        neurons has no gradient.
        """
        pairs = zip(activities, self._layers[1:], strict=False)
        costs = [(active.mean(0) * matrix.fan_out).sum() for active, matrix in pairs]
        return sum(costs, start=torch.zeros(()))

    def adopt_rates(self, activities: Sequence[Tensor]) -> None:
        """Take over how often hidden neurons are active, from activities (n, H)."""
        self.rates[1:] = self._active(activities)

    def _active(self, activities: Sequence[Tensor]) -> list[Tensor]:
        """Return the mean operations of a synapse of each neuron (H,), layer by layer."""
        return [active.mean(0) for active in activities]

    def _smooth(self, found: Sequence[Tensor]) -> None:
        """Move the rates of hidden neurons towards those of a batch."""
        pairs = zip(self.rates[1:], found, strict=True)
        self.rates[1:] = [torch.lerp(before, rate.detach(), _SMOOTHING) for before, rate in pairs]

    # checkpoints

    def tensors(self) -> dict[str, Tensor]:
        """Return what a checkpoint holds beside the policy, by name."""
        return {f"rate{number}": rate.clone() for number, rate in enumerate(self.rates[1:])}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore what `tensors` returned."""
        self.rates[1:] = [named[f"rate{number}"] for number in range(len(self.rates) - 1)]


class DeltaStudent(Student):
    """A DeltaSnnPolicy, which learns from windows of walks.

    offsets: what rounding by the chip adds to each field of DeltaWeights; none before `round`
    quanta: by matrix, the quantum to whose multiples weights are rounded in each forward pass
    each_pass: whether they are; otherwise offsets hold from one `round` to the next, so that what
        is computed changes smoothly with the weights
    """

    policy: DeltaSnnPolicy
    each_pass = True
    readout = frozenset({"out.weight", "past.weight", "action_bias", "_gamma"})

    def __init__(self, policy: DeltaSnnPolicy, config: SparseConfig) -> None:
        layers = [policy.into, policy.out] if policy.hidden else []
        rates = [torch.ones(policy.observations), torch.full((policy.hidden,), 0.15)]
        super().__init__(config, layers, policy.past if policy.skip else None, rates)
        self.policy = policy
        self.offsets: dict[str, Tensor] = {}
        self.quanta: dict[str, Tensor] = {}

    def start(self, binary: NDArray[np.bool_]) -> None:
        """Set the first steps of the encoder: those of binary observations are their swing."""
        self.policy.step.fill_(self._config.step)
        self.policy.step[binary] = 1.0

    def retune(self, pool: WalkPool, binary: NDArray[np.bool_]) -> None:
        """Set the encoder's steps anew, by how much each observation matters."""
        step = choose_steps(self.policy, pool, binary, self._config)
        self.policy.step.copy_(torch.from_numpy(step))

    def prepare(self, pool: WalkPool, binary: NDArray[np.bool_] | None = None) -> None:
        """Compute the pool's events with the policy's encoder."""
        policy = self.policy
        if binary is not None:
            found = binary.copy()
            found[found] = binary_columns(
                np.concatenate([w.observation[:, binary] for w in pool.walks])
            )
            policy.two_valued = tuple(np.flatnonzero(found).tolist())
        precise = deepcopy(policy).double()
        normaliser = delta_codec(precise).normaliser
        rows = (normaliser(walk.observation.astype(np.float64)) for walk in pool.walks)
        pool.encode(
            rows, delta_encoder(precise), policy.current_decay, policy.delay, policy.timesteps
        )
        self.rates[0] = pool.event_rate

    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of windows, and the hidden neurons' operations in a control step."""
        c = self._config
        batch = pool.sample(
            rng, c.batch, c.window, c.burn_in, c.first_windows, c.crash_windows, c.crash_steps
        )
        mean, (spikes,) = self.replay(batch, c.burn_in)
        after = mean[:, c.burn_in :], batch.label[:, c.burn_in :]
        error = imitation(*after, self.policy, c.sharpness).mean()
        rate = spikes[:, c.burn_in :].mean((0, 1))
        self._smooth([rate])
        excess = (rate.sum() / max(len(rate), 1) - c.rate_target).relu()
        return error, (rate * self.policy.out.fan_out).sum() + c.rate_cost * excess

    def replay(self, windows: Windows, burn_in: int) -> tuple[Tensor, list[Tensor]]:
        """Return means (B, L, act) and hidden spikes (B, L, H) of windows."""
        mean, spikes = self.policy.unrolled(
            windows.seen, windows.moved, self.weights(), burn_in, windows.begins
        )
        return mean, [spikes]

    def weights(self) -> DeltaWeights:
        """Return what is computed with: the policy's weights, as the chip rounds them."""
        weights = self.policy.weights()
        found = self._rounding(weights).items()
        return replace(weights, **{name: getattr(weights, name) + added for name, added in found})

    @torch.no_grad()
    def _rounding(self, weights: DeltaWeights) -> dict[str, Tensor]:
        """Return what rounding adds now: quanta and registers are those of the last `round`."""
        found = dict(self.offsets)
        for name, quantum in self.quanta.items():
            weight, held = getattr(weights, name), quantum > 0
            nearest = torch.round(weight / quantum.where(held, 1.0)) * quantum
            found[name] = torch.where(held, nearest - weight, 0.0)
        return found

    def round(self, target: Chip) -> None:
        """Compute with the numbers that the chip would have now, if the configuration says so."""
        if self._config.rounding:
            self.offsets, quanta = rounding_offsets(self.policy, target)
            self.quanta = quanta if self.each_pass else {}

    @property
    def is_rounded(self) -> bool:
        """True from the first `round` on, where the configuration says so."""
        return bool(self.offsets)

    def acting(self) -> Policy:
        """Return the policy with the numbers that are computed with."""
        return with_offsets(self.policy, self._rounding(self.policy.weights()))

    def deployed(self, target: Chip) -> Policy:
        """Return the policy with the numbers that the chip holds, if it is rounded."""
        return round_for_chip(self.policy, target) if self._config.rounding else self.policy

    @property
    def neurons(self) -> int:
        """Hidden neurons that are left."""
        return int(live_neurons(self.policy).sum())

    def tensors(self) -> dict[str, Tensor]:
        """Return rates, offsets and quanta of rounding, by name."""
        offsets = {f"offsets.{name}": added for name, added in self.offsets.items()}
        quanta = {f"quanta.{name}": each for name, each in self.quanta.items()}
        return {**super().tensors(), **offsets, **quanta}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore what `tensors` returned."""
        super().load(named)
        self.offsets, self.quanta = (with_prefix(n, named) for n in ("offsets", "quanta"))


class MlpStudent(Student):
    """A PrunedMlpPolicy, which learns from single states: windows are observations alone."""

    policy: PrunedMlpPolicy

    def __init__(self, policy: PrunedMlpPolicy, config: SparseConfig) -> None:
        # share of control steps in which each input, and each hidden neuron, is not 0
        rates = [torch.ones(policy.observations)]
        rates += [torch.full((width,), 0.5) for width in policy.hidden]
        super().__init__(config, policy.layers, policy.past if policy.skip else None, rates)
        self.policy = policy
        last = len(policy.matrices) - 1
        self.readout = frozenset({f"matrices.{last}.weight", f"biases.{last}", "past.weight"})

    def prepare(self, pool: WalkPool, binary: NDArray[np.bool_] | None = None) -> None:
        """Store the raw observations in windows, for `replay`; count which are not 0."""
        pool.take_observations()
        seen = (self.policy.normalizer(torch.from_numpy(w.observation)) for w in pool.walks)
        counts = [torch.count_nonzero(each, 0) for each in seen]
        self.rates[0] = torch.stack(counts).sum(0) / pool.steps

    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of states, and the hidden neurons' operations in a control step."""
        c = self._config
        count = c.batch * (c.window - c.burn_in)
        observation, label = pool.states(rng, count, c.crash_windows, c.crash_steps)
        mean, (_, *hidden) = self.policy.activations(observation)
        self._smooth(self._active(hidden))
        error = imitation(mean, label, self.policy, c.sharpness).mean()
        return error, self.hidden_operations(hidden)

    def replay(self, windows: Windows, burn_in: int) -> tuple[Tensor, list[Tensor]]:
        """Return means (B, L, act) and hidden activations (B, L, H) of windows."""
        count, length = windows.seen.shape[:2]
        mean, (_, *hidden) = self.policy.activations(windows.seen.flatten(0, 1))
        return mean.view(count, length, -1), [x.view(count, length, -1) for x in hidden]

    @property
    def neurons(self) -> int:
        """Hidden neurons that are left."""
        return sum(int(matrix.mask.any(0).sum()) for matrix in self.policy.layers[1:])

    def _active(self, activities: Sequence[Tensor]) -> list[Tensor]:
        return [(hidden > 0).float().mean(0) for hidden in activities]


def student(policy: Policy, config: SparseConfig) -> Student:
    """Return the student for a policy."""
    if isinstance(policy, DeltaSnnPolicy):
        return DeltaStudent(policy, config)
    if isinstance(policy, PrunedMlpPolicy):
        return MlpStudent(policy, config)
    raise ConfigError(
        f"a policy of kind {policy.kind!r} cannot be pruned: choose policy.kind delta-snn or "
        "pruned-mlp"
    )


def imitation(mean: Tensor, label: Tensor, policy: Policy, sharpness: float) -> Tensor:
    """Return the error of means (..., act) against the teacher's actions or logits (..., act)."""
    if policy.head == "continuous":
        return (torch.tanh(mean) - label).square().mean(-1)
    return compute_cross_entropy(mean, label, sharpness)
