"""Episodes of students: in float for collection, on the chip for validation."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill.teacher import surprise
from spikedeploy.trainers.learner import under
from spikedeploy.trainers.policies import DeltaMlpPolicy, DeltaSnnPolicy, Policy, PrunedMlpPolicy
from spikedeploy.trainers.policies.delta import (
    DeltaWeights,
    delta_artifact,
    delta_codec,
    delta_encoder,
    live_neurons,
)
from spikedeploy.trainers.policies.pruned_mlp import PrunedWeight, SynapseGroup
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import BatchController, Stateless, WalkPool

# -- Pruning by operations: one ranking over all synapses, and whole neurons as units of it.

_TINY = 1e-12


def operations(synapses: Sequence[SynapseGroup]) -> float:
    """Mean number of operations in a control step, over all synapses."""
    return float(sum(float(each.operations) for each in synapses))


@torch.no_grad()
def prune(
    synapses: Sequence[SynapseGroup], squares: Mapping[PrunedWeight, Tensor], target: float
) -> int:
    """Take out the synapses that matter least for each operation; return how many.

    squares: Adam's second moment of each weight

    A synapse is worth w^2 sqrt(v) / rate: what the loss would gain by it, about (LeCun et al.
    1989, with Adam's v for the curvature), over the operations that it takes.
    """
    excess = operations(synapses) - target
    if excess <= 0:
        return 0
    worth = torch.cat([_worth(each, squares).flatten() for each in synapses])
    rates = torch.cat([each.rate.expand_as(each.matrix.mask).flatten() for each in synapses])
    order = worth.argsort()
    taken = int((rates[order].cumsum(0) < excess).sum()) + 1
    taken = min(taken, int(torch.isfinite(worth).sum()))
    drop = torch.zeros_like(worth)
    drop[order[:taken]] = 1.0
    parts = torch.split(drop, [each.matrix.mask.numel() for each in synapses])
    for each, part in zip(synapses, parts, strict=True):
        each.matrix.mask[part.view_as(each.matrix.mask) > 0] = 0.0
    return taken


def saliency(synapses: SynapseGroup, squares: Mapping[PrunedWeight, Tensor]) -> Tensor:
    """Return what the loss would gain by each synapse (N, M), about; 0 where it is out."""
    matrix = synapses.matrix
    return matrix.weight.square() * (squares[matrix].sqrt() + _TINY) * matrix.mask


def _worth(synapses: SynapseGroup, squares: Mapping[PrunedWeight, Tensor]) -> Tensor:
    worth = saliency(synapses, squares) / (synapses.rate + 1e-4)
    return torch.where(synapses.matrix.mask > 0, worth, torch.inf)


@torch.no_grad()
def remove_neurons(
    into: SynapseGroup,
    out: SynapseGroup,
    squares: Mapping[PrunedWeight, Tensor],
    neuron_cost: float,
    most: int,
) -> int:
    """Remove hidden neurons that are worth less than the average operation; return how many.

    neuron_cost: operations that an update of a neuron counts for
    most: how many to remove at once

    Neurons without synapses on the outgoing side lose those on the other one.
    """
    idle = ~out.matrix.mask.any(0)
    into.matrix.mask[idle] = 0.0
    cost = into.matrix.mask @ into.rate + out.rate * out.matrix.fan_out + neuron_cost
    gain = saliency(into, squares).sum(1) + saliency(out, squares).sum(0)
    live = ~idle
    if not neuron_cost or int(live.sum()) < 2:
        return 0
    # less than a tenth of what the others bring for the same operations
    share = gain / cost
    weak = live & (share < 0.1 * gain[live].sum() / cost[live].sum())
    chosen = torch.where(weak, share, torch.inf).argsort()[:most]
    chosen = chosen[weak[chosen]]
    into.matrix.mask[chosen] = 0.0
    out.matrix.mask[:, chosen] = 0.0
    return len(chosen)


# -- Rounding in training: what a chip's own quantiser makes of a policy's numbers.
#
# Decay factors, biases and thresholds of LIF neurons are those of the chip's registers.
#
# The channels of an observation must weigh exactly 1, 2 ... K times the same integer. Rounded
# each by
# itself, three events up and one event down three times would not cancel, and currents that hardly
# decay would drift away from the observation. So the weight of one event is rounded, and a policy
# with rounded weights has multiples of it on all channels, which the quantiser then leaves as they
# are: its scale is that of the largest weight, which is 255 on Loihi and a multiple of K for 3
# and 5.

Array = NDArray[np.float64]
_STEP = "weights"  # the kind of rounding, as an arithmetic's `ablation_steps` name it


def check_rounding(target: Chip) -> None:
    """Refuse chips whose rounding of weights alone is not defined."""
    if _STEP not in target.arithmetic.ablation_steps:
        raise ConfigError(
            f"rounding: the weights of {target.name} cannot be rounded by themselves, which "
            "training with rounding needs. Set rounding=false, or choose chip=loihi1 or int."
        )


def rounding_offsets(policy: DeltaSnnPolicy, target: Chip) -> dict[str, Tensor]:
    """Return what rounding adds to each field of DeltaWeights, by name.

    That of an observation is the error of the channel of one event. Of sigma-delta neurons only
    weights are rounded here.
    """
    artifact = delta_artifact(policy)
    exact = compile_program(artifact, chip("ideal"), limits=False)
    rounded = compile_program(artifact, target, limits=False)
    offsets = {
        name: torch.zeros_like(getattr(policy, name).weight) for name in ("into", "out", "past")
    }
    hidden = torch.nonzero(live_neurons(policy)).ravel()
    for before, after in zip(exact.layers, rounded.layers, strict=True):
        for name, source, error in _errors(exact, before, after, target):
            added = _per_observation(policy, error) if source == exact.input else error
            if name == "out" and isinstance(policy, DeltaMlpPolicy):  # by what a spike counts
                added = added / policy.threshold[hidden].double().numpy()[:, None]
            rows = hidden if name == "into" else torch.arange(policy.actions)
            columns = hidden if name == "out" else torch.arange(policy.observations)
            offsets[name][rows[:, None], columns[None]] = torch.from_numpy(added.T).float()
    # what pruning took out stays out
    offsets = {name: added * getattr(policy, name).mask for name, added in offsets.items()}
    if isinstance(policy, DeltaMlpPolicy):
        return offsets
    layers = zip(exact.layers, rounded.layers, strict=True)
    return offsets | _neuron_offsets(policy, hidden, layers, target)


@torch.no_grad()
def _neuron_offsets(
    policy: DeltaSnnPolicy, hidden: Tensor, layers: Iterable[tuple[Layer, Layer]], target: Chip
) -> dict[str, Tensor]:
    """Return what rounding adds to decay factors, biases and thresholds."""
    offsets = {"gamma": torch.zeros_like(policy.gamma)}
    offsets |= {name: torch.zeros_like(policy.bias) for name in ("beta", "bias", "threshold")}
    for before, after in layers:
        decay = torch.from_numpy(after.membrane_decay / target.arithmetic.decay_one)
        if before.name == "readout" and policy.hidden:
            offsets["gamma"] = decay.float() - policy.gamma
        if before.spiking:
            offsets["beta"][hidden] = decay.float() - policy.beta[hidden]
            for name, exact, rounded in (
                ("bias", before.voltage_bias, after.voltage_bias),
                ("threshold", before.threshold, after.threshold),
            ):
                offsets[name][hidden] = torch.from_numpy(rounded * after.scale - exact).float()
    return offsets


@torch.no_grad()
def add_offsets(policy: DeltaSnnPolicy, offsets: Mapping[str, Tensor]) -> None:
    """Add what rounding adds, so that the policy computes with the numbers of the chip."""
    for name in ("into", "out", "past"):
        if name in offsets:
            getattr(policy, name).weight += offsets[name]
    if "beta" in offsets:
        policy.set_decays(policy.beta + offsets["beta"], policy.gamma + offsets["gamma"])
        policy.bias.add_(offsets["bias"])
        policy.threshold.add_(offsets["threshold"])


@torch.no_grad()
def deployed(policy: Policy, target: Chip, rounding: bool) -> Policy:
    """Return the policy with the numbers that the chip holds; a float policy as it is.

    rounding: whether they are rounded; weights that round to 0 are taken out
    """
    if not rounding or not isinstance(policy, DeltaSnnPolicy):
        return policy
    copy = deepcopy(policy)
    add_offsets(copy, rounding_offsets(policy, target))
    for matrix in (copy.into, copy.out, copy.past):
        matrix.mask *= matrix.weight != 0
    return copy


def _errors(
    program: Program, before: Layer, after: Layer, target: Chip
) -> Iterator[tuple[str, str, Array]]:
    """Name of each kind of weights onto a layer, their source, and their errors (M, N)."""
    units = target.arithmetic.partly_rounded(before, after, _STEP)
    for exact, rounded in zip(before.synapses, units.synapses, strict=True):
        kind = "into" if before.spiking else "past" if exact.source == program.input else "out"
        yield kind, exact.source, rounded.weight * after.scale - exact.weight


def _per_observation(policy: DeltaSnnPolicy, error: Array) -> Array:
    """Error (obs, N) of one event of each observation, from those of all channels (M, N)."""
    first = error.reshape(policy.observations, 2 * policy.most, -1)[:, 0]
    return np.asarray(first / policy.step.double().numpy()[:, None])


# -- What the algorithm asks of a student: the loss of a batch, and its synapses with their
#    rates.

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
        self.offsets = under("offsets", dict(named))


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


# -- Steps of the delta encoder, by how much each observation matters and how often it moves.
#
# Thresholds of a delta network, by how much each neuron's activation varies.

_WINDOWS = 256  # on which sensitivities are measured
_PROJECTIONS = 8
_SMALLEST, _LARGEST = 0.1, 4.0  # steps [standard deviations]
_STILL = 1e-3  # standard deviation of an activation that hardly varies
_SAMPLE = 20_000  # states that show whether an observation is binary
_RARE = 2  # states: a value that fewer have is an outlier, as of a force that is nearly always zero
_SWING = 1e-2  # between two values; below it they are one value with noise


def binary_columns(observation: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which observations (obs,) take exactly two values, as contacts do, and each repeatedly."""
    some = observation[:: max(1, len(observation) // _SAMPLE)]
    found = np.array([_two_values(column) for column in some.T], np.bool_)
    # a sample may lack the rest of the values
    found[found] = [_two_values(column) for column in observation.T[found]]
    return found


def _two_values(column: NDArray[np.float64]) -> bool:
    values, counts = np.unique(column, return_counts=True)
    return len(values) == 2 and counts.min() >= _RARE and values[1] - values[0] >= _SWING


def retuned(
    policy: DeltaSnnPolicy, pool: WalkPool, binary: NDArray[np.bool_], config: SparseConfig
) -> NDArray[np.float64]:
    """Return steps (obs,) of equal marginal cost, with the configured geometric mean.

    An event costs its fan-out F, and E|dx| / step of them are sent; the error of the actions grows
    with (step^2 / 12) H, where H = E |d action / d x|^2. The least error for the operations is at

        step ~ (F E|dx| / H)^(1/3)

    Steps of binary observations, and of those that nothing reads, stay as they are.
    """
    step: NDArray[np.float64] = policy.step.double().numpy().copy()
    fan_out = policy.into.fan_out + policy.past.fan_out if policy.skip else policy.into.fan_out
    matters = _sensitivity(policy, pool, config)
    cost = fan_out.numpy() * pool.mean_move
    chosen = (cost > 0) & (matters > 0) & ~binary
    if not chosen.any():
        return step
    wanted = np.cbrt(cost[chosen] / matters[chosen])
    wanted *= config.step / np.exp(np.log(wanted).mean())
    step[chosen] = np.clip(wanted, _SMALLEST, _LARGEST)
    return step


@torch.no_grad()
def tuned_thresholds(policy: DeltaMlpPolicy, pool: WalkPool, config: SparseConfig) -> Tensor:
    """Return thresholds (H,), the policy's share of the standard deviation of each activation.

    That of a neuron whose activation hardly varies stays as it is.
    """
    batch = pool.sample(
        np.random.default_rng(0), _WINDOWS, config.window, config.burn_in, 0.0, 0.0, 1
    )
    seen = batch.seen[:, config.burn_in :]
    spread = torch.relu(seen @ policy.into().T + policy.bias).std((0, 1))
    return torch.where(spread > _STILL, policy.share * spread, policy.threshold)


def _sensitivity(
    policy: DeltaSnnPolicy, pool: WalkPool, config: SparseConfig
) -> NDArray[np.float64]:
    """Mean squared gradient H (obs,) of the actions, from random projections of them."""
    batch = pool.sample(
        np.random.default_rng(0), _WINDOWS, config.window, config.burn_in, 0.0, 0.0, 1
    )
    seen = batch.seen.clone().requires_grad_(True)
    moved = batch.moved.clone().requires_grad_(True)
    mean, _ = policy.unrolled(seen, moved, policy.weights(), 0, batch.begins)
    action = torch.tanh(mean[:, config.burn_in :])
    total = torch.zeros(policy.observations)
    generator = torch.Generator().manual_seed(0)
    for _ in range(_PROJECTIONS):
        noise = torch.randn(action.shape, generator=generator)
        found = torch.autograd.grad(
            (action * noise).sum(), (seen, moved), retain_graph=True, allow_unused=True
        )
        total += sum(each.square().sum((0, 1)) for each in found if each is not None)
    return (total / (_PROJECTIONS * action.shape[0] * action.shape[1])).double().numpy()


# -- Episodes of students: in float for collection, on the chip for validation.

FloatArray = NDArray[np.float64]


class DeltaController:
    """A DeltaSnnPolicy in torch as a BatchController."""

    def __init__(self, policy: DeltaSnnPolicy) -> None:
        self._policy = policy

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._state = self._policy.rest(robots)

    @torch.no_grad()
    def act_batch(self, observation: FloatArray) -> NDArray[Any]:
        """Return actions (B, act), or (B,) if discrete."""
        mean, _, _ = self._policy.advance(torch.from_numpy(observation).float(), self._state)
        return _numbers(self._policy.decide(mean))


def in_float(policy: Policy) -> BatchController:
    """Return the policy in torch."""
    if isinstance(policy, DeltaSnnPolicy):
        return DeltaController(policy)

    @torch.no_grad()
    def act(observation: FloatArray) -> NDArray[Any]:
        return _numbers(policy(torch.from_numpy(observation).float()))

    return Stateless(act)


class ChipController:
    """An artifact on a chip as a BatchController."""

    def __init__(self, artifact: Artifact, chip: Chip) -> None:
        self._controller = SpikingController(artifact, chip, ledger="none")
        self.act_batch = self._controller.act_batch

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._controller.reset(0)


def on_chip(policy: Policy, chip: Chip) -> BatchController:
    """Return the policy as the chip runs it; a float policy as it is."""
    if isinstance(policy, DeltaSnnPolicy):
        return ChipController(delta_artifact(policy), chip)
    return in_float(policy)


def _numbers(action: torch.Tensor) -> NDArray[Any]:
    return (action.double() if action.is_floating_point() else action).numpy()
