"""Students: their loss on walks, synapses ranked, numbers as the chip has them.

The channels of an observation must weigh exactly 1, 2 ... K times the same integer. Rounded each by
itself, three events up and one event down three times would not cancel, and currents that hardly
decay would drift away from the observation. So the weight of one event is rounded, and a policy
with rounded weights has multiples of it on all channels, which the quantiser then leaves as they
are: its scale is that of the largest weight, which is 255 on Loihi and a multiple of K for 3 and 5.
"""

import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill.teacher import compute_cross_entropy
from spikedeploy.trainers.policies import (
    DeltaMlpPolicy,
    DeltaSnnPolicy,
    Policy,
    PrunedGruPolicy,
    PrunedMlpPolicy,
)
from spikedeploy.trainers.policies.delta import (
    DeltaWeights,
    delta_artifact,
    delta_codec,
    delta_encoder,
    live_layers,
    live_neurons,
)
from spikedeploy.trainers.policies.policy import PrunedWeight, SynapseGroup, in_bits
from spikedeploy.trainers.run_folder import with_prefix
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import WalkPool, Windows

FloatArray = NDArray[np.float64]
_SMOOTHING = 0.02  # weight of the newest batch in mean rates of hidden neurons
_TINY = 1e-12
_WEAK = 0.1  # of what the others bring for the same operations: neurons below are removed
_STEP = "weights"  # the kind of rounding, as an arithmetic's `ablation_steps` name it
_WINDOWS = 256  # on which sensitivities are measured
_PROJECTIONS = 8
_MIN_STEP, _MAX_STEP = 0.1, 4.0  # [standard deviations]
_MIN_SPREAD = 1e-3  # standard deviation of an activation that hardly varies
_SAMPLE = 20_000  # states that show whether an observation is binary
_RARE = 2  # states: a value that fewer have is an outlier, as of a force that is nearly always zero
_SWING = 1e-2  # between two values; below it they are one value with noise


# -- students: what learns from walks, and is pruned


class DeltaStudent:
    """A DeltaSnnPolicy, which learns from windows of walks.

    policy: what is trained
    readout: names of the parameters behind the last hidden layer, and past it
    hidden_rate: (H,) mean spikes of the hidden neurons in a control step; of neurons without
        memory T times those of the timestep that actions read
    offsets: what rounding by the chip adds to each field of DeltaWeights; none before `round`
    quanta: of which weights are rounded to multiples in each forward pass, by matrix
    each_pass: whether they are; otherwise offsets hold from one `round` to the next, so that what
        is computed changes smoothly with the weights
    """

    each_pass = True

    readout = frozenset({"out.weight", "past.weight", "action_bias", "_gamma"})

    def __init__(self, policy: DeltaSnnPolicy, config: SparseConfig) -> None:
        self.policy = policy
        self._config = config
        self.hidden_rate = torch.full((policy.hidden,), 0.15)
        self.offsets: dict[str, Tensor] = {}
        self.quanta: dict[str, Tensor] = {}
        self._event_rate = torch.ones(policy.observations)

    def prepare(self, pool: WalkPool) -> None:
        """Compute the pool's events with the policy's encoder: `loss` and `replay` need them."""
        precise = deepcopy(self.policy).double()
        normaliser = delta_codec(precise).normaliser
        rows = (normaliser(walk.observation.astype(np.float64)) for walk in pool.walks)
        policy = self.policy
        pool.encode(
            rows, delta_encoder(precise), policy.current_decay, policy.delay, policy.timesteps,
            moves=not policy.memoryless,
        )  # fmt: skip
        self._event_rate = pool.event_rate

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
        self.hidden_rate = torch.lerp(self.hidden_rate, rate.detach(), _SMOOTHING)
        excess = (rate.sum() / max(len(rate), 1) - c.rate_target).relu()
        return error, (rate * self._fan_out).sum() + c.rate_cost * excess

    @property
    def _fan_out(self) -> Tensor:
        """Synapses (H,) that a spike of each hidden neuron passes."""
        policy = self.policy
        return policy.out.fan_out + policy.back.fan_out if policy.deep else policy.out.fan_out

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

    def acting(self) -> Policy:
        """Return the policy with the numbers that are computed with."""
        return with_offsets(self.policy, self._rounding(self.policy.weights()))

    def hidden_operations(self, activities: list[Tensor]) -> Tensor:
        """Return the hidden neurons' operations for spikes (n, H), with a gradient."""
        return (activities[0].mean(0) * self._fan_out).sum()

    def adopt_rates(self, activities: list[Tensor]) -> None:
        """Take over how often hidden neurons spike, from spikes (n, H)."""
        self.hidden_rate = activities[0].mean(0)

    @property
    def neurons(self) -> int:
        """Hidden neurons that are left."""
        return int(live_neurons(self.policy).sum())

    def synapses(self) -> list[SynapseGroup]:
        """Return all synapses."""
        policy = self.policy
        found = list(self._around_hidden()) if policy.hidden else []
        if policy.deep:
            found.append(SynapseGroup(policy.back, self.hidden_rate))
        past = SynapseGroup(policy.past, self._event_rate)
        return [*found, past] if policy.skip else found

    def hidden_layers(self) -> list[tuple[SynapseGroup, SynapseGroup]]:
        """Return the synapses onto and from the neurons of the layer, if it is one."""
        return [self._around_hidden()] if self.policy.hidden and not self.policy.deep else []

    def _around_hidden(self) -> tuple[SynapseGroup, SynapseGroup]:
        into = SynapseGroup(self.policy.into, self._event_rate)
        return into, SynapseGroup(self.policy.out, self.hidden_rate)

    def tensors(self) -> dict[str, Tensor]:
        """Return rates, offsets and quanta of rounding, by name."""
        offsets = {f"offsets.{name}": added for name, added in self.offsets.items()}
        quanta = {f"quanta.{name}": each for name, each in self.quanta.items()}
        return {"hidden_rate": self.hidden_rate.clone(), **offsets, **quanta}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore what `tensors` returned."""
        self.hidden_rate = named["hidden_rate"]
        self.offsets, self.quanta = (with_prefix(n, named) for n in ("offsets", "quanta"))


class MlpStudent:
    """A PrunedMlpPolicy, which learns from single states: windows are observations alone.

    policy, readout: as in DeltaStudent
    """

    def __init__(self, policy: PrunedMlpPolicy, config: SparseConfig) -> None:
        self.policy = policy
        self._config = config
        # share of control steps in which each input, and each neuron of each hidden layer, is not 0
        self._input_rate = torch.ones(policy.observations)
        self._rates = [torch.full((width,), 0.5) for width in policy.hidden]
        last = len(policy.matrices) - 1
        self.readout = frozenset({f"matrices.{last}.weight", f"biases.{last}", "past.weight"})

    def prepare(self, pool: WalkPool) -> None:
        """Let windows hold the observations as they are, for `replay`; count which are not 0."""
        pool.take_observations()
        seen = (self.policy.normalizer(torch.from_numpy(w.observation)) for w in pool.walks)
        counts = [torch.count_nonzero(each, 0) for each in seen]
        self._input_rate = torch.stack(counts).sum(0) / pool.steps

    def round(self, target: Chip) -> None:
        """Compute with weights of so many bits, if the configuration says so."""
        for matrix in self._matrices:
            matrix.bits = self._config.bits

    @property
    def _matrices(self) -> list[PrunedWeight]:
        return [each for each in self.policy.modules() if isinstance(each, PrunedWeight)]

    def acting(self) -> Policy:
        """Return the policy with the numbers that are computed with."""
        return self.policy

    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of states, and the hidden neurons' operations in a control step."""
        c = self._config
        count = c.batch * (c.window - c.burn_in)
        observation, label = pool.states(rng, count, c.crash_windows, c.crash_steps)
        mean, (_, *hidden) = self.policy.activations(observation)
        pairs = zip(self._rates, _active(hidden), strict=True)
        self._rates = [torch.lerp(before, rate, _SMOOTHING) for before, rate in pairs]
        error = imitation(mean, label, self.policy, c.sharpness).mean()
        return error, self.hidden_operations(hidden)

    def replay(self, windows: Windows, burn_in: int) -> tuple[Tensor, list[Tensor]]:
        """Return means (B, L, act) and hidden activations (B, L, H) of windows."""
        count, length = windows.seen.shape[:2]
        mean, (_, *hidden) = self.policy.activations(windows.seen.flatten(0, 1))
        return mean.view(count, length, -1), [x.view(count, length, -1) for x in hidden]

    def hidden_operations(self, activities: list[Tensor]) -> Tensor:
        """Return the mean of activations (n, H) times their fan-outs, which stands for operations.

        The share of active neurons has no gradient.
        """
        pairs = zip(activities, self.policy.layers[1:], strict=True)
        costs = [(hidden.mean(0) * matrix.fan_out).sum() for hidden, matrix in pairs]
        return sum(costs, start=torch.zeros(()))

    def adopt_rates(self, activities: list[Tensor]) -> None:
        """Take over how often hidden neurons are not 0, from activations (n, H)."""
        self._rates = _active(activities)

    @property
    def neurons(self) -> int:
        """Hidden neurons that are left."""
        return sum(int(matrix.mask.any(0).sum()) for matrix in self.policy.layers[1:])

    def synapses(self) -> list[SynapseGroup]:
        """Return all synapses."""
        past = SynapseGroup(self.policy.past, self._input_rate)
        return [*self._layers(), past] if self.policy.skip else self._layers()

    def hidden_layers(self) -> list[tuple[SynapseGroup, SynapseGroup]]:
        """Return the synapses onto and from the neurons of each hidden layer."""
        return list(pairwise(self._layers()))

    def _layers(self) -> list[SynapseGroup]:
        rates = [self._input_rate, *self._rates]
        return [SynapseGroup(m, rate) for m, rate in zip(self.policy.layers, rates, strict=True)]

    def tensors(self) -> dict[str, Tensor]:
        """Return rates and whether weights are rounded, by name."""
        rates = {f"rate{number}": rate.clone() for number, rate in enumerate(self._rates)}
        rounds = any(matrix.bits is not None for matrix in self._matrices)
        return rates | ({"rounds": torch.tensor(True)} if rounds else {})

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore what `tensors` returned."""
        self._rates = [named[f"rate{number}"] for number in range(len(self._rates))]
        for matrix in self._matrices:
            matrix.bits = self._config.bits if "rounds" in named else None


class GruStudent(MlpStudent):
    """A PrunedGruPolicy, which learns from windows of walks, by imitation alone.

    policy: what is trained
    """

    policy: PrunedGruPolicy  # type: ignore[assignment]

    def __init__(self, policy: PrunedGruPolicy, config: SparseConfig) -> None:
        self.policy, self._config = policy, config
        self._rates = [torch.full((each.fan_out.numel(),), 0.5) for each in policy.groups]

    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of windows, and the ReLU layers' operations in a control step."""
        c, policy = self._config, self.policy
        batch = pool.sample(
            rng, c.batch, c.window, c.burn_in, c.first_windows, c.crash_windows, c.crash_steps
        )
        runs_on = 1 - batch.begins[:, None].to(batch.seen.dtype)
        with torch.no_grad():  # what comes before brings the memory up
            before = policy.unrolled(batch.seen[:, : c.burn_in], *policy.rest(len(batch.seen)))
        done = policy.unrolled(batch.seen[:, c.burn_in :], before.memory * runs_on)
        active = [(each != 0).float().mean((0, 1)) for each in done.inputs]
        pairs = zip(self._rates, active, strict=True)
        self._rates = [torch.lerp(earlier, rate, _SMOOTHING) for earlier, rate in pairs]
        label = batch.label[:, c.burn_in :]
        error = imitation(done.mean, label, policy, c.sharpness).mean()
        layers = range(1, 1 + len(policy.hidden))
        costs = [(done.inputs[k].mean((0, 1)) * policy.groups[k].fan_out).sum() for k in layers]
        return error, sum(costs, start=torch.zeros(()))

    @property
    def neurons(self) -> int:
        """Units of the ReLU layers and of the memory that are left."""
        policy = self.policy
        layers = [each.fan_out for each in policy.groups[1 : 1 + len(policy.hidden)]]
        memory = policy.back.fan_out + policy.out.fan_out
        return sum(int((fan_out > 0).sum()) for fan_out in (*layers, memory))

    def synapses(self) -> list[SynapseGroup]:
        """Return all synapses."""
        pairs = zip(self.policy.groups, self._rates, strict=True)
        return [SynapseGroup(matrix, rate) for matrix, rate in pairs]

    def hidden_layers(self) -> list[tuple[SynapseGroup, SynapseGroup]]:
        """Return none: gates have three rows a unit, which are not removed one by one."""
        return []


Student = DeltaStudent | MlpStudent


def _active(activations: Sequence[Tensor]) -> list[Tensor]:
    """Return the share of rows in which each neuron (H,) is not 0, layer by layer."""
    return [(hidden > 0).float().mean(0) for hidden in activations]


def student(policy: Policy, config: SparseConfig) -> Student:
    """Return the student for a policy."""
    if isinstance(policy, DeltaSnnPolicy):
        return DeltaStudent(policy, config)
    if isinstance(policy, PrunedMlpPolicy):
        return MlpStudent(policy, config)
    if isinstance(policy, PrunedGruPolicy):
        return GruStudent(policy, config)
    raise ConfigError(
        f"a policy of kind {policy.kind!r} cannot be pruned: choose policy.kind delta-snn, "
        "pruned-mlp or pruned-gru"
    )


def imitation(mean: Tensor, label: Tensor, policy: Policy, sharpness: float) -> Tensor:
    """Return the error of means (..., act) against the teacher's actions or logits (..., act)."""
    if policy.head == "continuous":
        return (torch.tanh(mean) - label).square().mean(-1)
    return compute_cross_entropy(mean, label, sharpness)


# -- pruning by operations: one ranking over all synapses, and whole neurons as units of it


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
    worths = [
        torch.where(each.matrix.mask > 0, _saliency(each, squares) / (each.uses + 1e-4), torch.inf)
        for each in synapses
    ]
    worth = torch.cat([each.flatten() for each in worths])
    rates = torch.cat([each.uses.flatten() for each in synapses])
    order = worth.argsort()
    count = int((rates[order].cumsum(0) < excess).sum()) + 1
    count = min(count, int(torch.isfinite(worth).sum()))
    drop = torch.zeros_like(worth)
    drop[order[:count]] = 1.0
    parts = torch.split(drop, [each.matrix.mask.numel() for each in synapses])
    for each, part in zip(synapses, parts, strict=True):
        each.matrix.mask[part.view_as(each.matrix.mask) > 0] = 0.0
    return count


def _saliency(synapses: SynapseGroup, squares: Mapping[PrunedWeight, Tensor]) -> Tensor:
    """Return what the loss would gain by each synapse (N, M), about; 0 where it is out."""
    matrix = synapses.matrix
    return matrix.weight.square() * (squares[matrix].sqrt() + _TINY) * matrix.mask


@torch.no_grad()
def remove_neuron(
    into: SynapseGroup,
    out: SynapseGroup,
    squares: Mapping[PrunedWeight, Tensor],
    neuron_cost: float,
) -> int:
    """Remove the hidden neuron that is worth least, where that is far less than the others.

    neuron_cost: operations that an update of a neuron counts for; 0 removes none

    Neurons without synapses on the outgoing side lose those on the other one. Returns how many
    were removed: 0 or 1.
    """
    idle = ~out.matrix.mask.any(0)
    into.matrix.mask[idle] = 0.0
    both = (into.uses * into.matrix.mask).sum(1) + (out.uses * out.matrix.mask).sum(0)
    cost = both + neuron_cost
    gain = _saliency(into, squares).sum(1) + _saliency(out, squares).sum(0)
    live = ~idle
    if not neuron_cost or int(live.sum()) < 2:
        return 0
    share = gain / cost
    weak = live & (share < _WEAK * gain[live].sum() / cost[live].sum())
    chosen = torch.where(weak, share, torch.inf).argsort()[:1]
    chosen = chosen[weak[chosen]]
    into.matrix.mask[chosen] = 0.0
    out.matrix.mask[:, chosen] = 0.0
    return len(chosen)


# -- rounding: what a chip's own quantiser makes of a policy's numbers


def check_rounding(target: Chip) -> None:
    """Refuse chips whose rounding of weights alone is not defined."""
    if _STEP not in target.arithmetic.ablation_steps:
        raise ConfigError(
            f"rounding: the weights of {target.name} cannot be rounded by themselves, which "
            "training with rounding needs. Set rounding=false, or choose chip=loihi1 or int."
        )


@torch.no_grad()
def rounding_offsets(
    policy: DeltaSnnPolicy, target: Chip
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Return what rounding adds to each field of DeltaWeights, and the quanta of each matrix.

    That of an observation is the error of the channel of one event. Decay factors, biases and
    thresholds of LIF neurons are those of the chip's registers; of sigma-delta neurons only weights
    are rounded here. Weights are rounded to multiples of their quanta; 0 for those that are out.
    """
    artifact = delta_artifact(policy)
    exact = compile_program(artifact, chip("ideal"), limits=False)
    rounded = compile_program(artifact, target, limits=False)
    weights, groups = vars(policy.weights()).items(), policy.groups
    offsets = {name: torch.zeros_like(each) for name, each in weights if each is not None}
    offsets |= {name: torch.zeros_like(each.whole_mask) for name, each in groups.items()}
    quanta = {name: torch.zeros_like(each.whole_mask) for name, each in groups.items()}
    layers = live_layers(policy)
    graded = isinstance(policy, DeltaMlpPolicy)
    for before, after in zip(exact.layers, rounded.layers, strict=True):
        units = target.arithmetic.partly_rounded(before, after, _STEP)
        # on the grid of the chip lie all weights of a layer, whatever is left of each matrix
        held = np.concatenate([np.abs(s.weight).ravel() for s in units.synapses])
        step = _grid(held.astype(np.int64), target) * after.scale
        for old, new in zip(before.synapses, units.synapses, strict=True):
            # from events, and from neurons
            names = ("into", "back") if before.name in layers else ("past", "out")
            name = names[old.source in layers]
            rows = layers.get(before.name, torch.arange(policy.actions))
            columns = layers.get(old.source, torch.arange(policy.observations))
            error = new.weight * after.scale - old.weight
            counts = np.ones(len(error))  # what a unit of the source's output counts
            if old.source == exact.input:
                # that of the channel of one event
                error = error.reshape(policy.observations, 2 * policy.most, -1)[:, 0]
                counts = policy.step.double().numpy()
            elif graded:  # by what a spike counts
                counts = policy.threshold[columns].double().numpy()
            for found, each in ((offsets, error), (quanta, np.broadcast_to(step, error.shape))):
                of_unit = torch.from_numpy((each / counts[:, None]).T).float()
                found[name][rows[:, None], columns[None]] = of_unit
        if graded:
            continue
        decay = torch.from_numpy(after.membrane_decay / target.arithmetic.decay_one).float()
        if before.name == "readout" and policy.hidden:
            offsets["gamma"] = decay - policy.gamma
        if before.spiking:
            live = layers[before.name]
            bias = after.voltage_bias * after.scale - before.voltage_bias
            threshold = after.threshold * after.scale - before.threshold
            offsets["beta"][live] = decay - policy.beta[live]
            offsets["bias"][live] = torch.from_numpy(bias).float()
            offsets["threshold"][live] = torch.from_numpy(threshold).float()
    # what pruning took out stays out
    matrices = {name: each.block(offsets[name]) * each.mask for name, each in groups.items()}
    steps = {name: each.block(quanta[name]).abs() * each.mask for name, each in groups.items()}
    return matrices if graded else offsets | matrices, steps


def _grid(held: NDArray[np.int64], target: Chip) -> int:
    """Return the distance of neighbouring weights of a layer, from those (n,) that it holds.

    Weights count 2**exponent times, with an exponent for all: the largest one needs it.
    """
    registers: Any = target.arithmetic
    unit = 1 << int(registers.mantissa_shift)
    over = max(int(held.max(initial=0)) / unit / registers.weight_max, 1.0)
    return int(registers.weight_step * unit << math.ceil(math.log2(over)))


@torch.no_grad()
def with_offsets(policy: DeltaSnnPolicy, offsets: Mapping[str, Tensor]) -> DeltaSnnPolicy:
    """Return a copy that computes with the numbers of the chip: those of the policy and these."""
    copy = deepcopy(policy)
    for name, matrix in copy.groups.items():
        if name in offsets:
            matrix.weight.add_(offsets[name])
    if "beta" in offsets:
        copy.set_decays(copy.beta + offsets["beta"], copy.gamma + offsets["gamma"])
        copy.bias.add_(offsets["bias"])
        copy.threshold.add_(offsets["threshold"])
    return copy


@torch.no_grad()
def round_for_chip(policy: Policy, target: Chip, rounding: bool, bits: int | None = None) -> Policy:
    """Return the policy with the numbers that the chip holds; a float one as it is, or in bits.

    rounding: whether they are rounded; weights that round to 0 are taken out
    bits: of a float policy's weights
    """
    if bits is not None:
        return in_bits(deepcopy(policy), bits)
    if not rounding or not isinstance(policy, DeltaSnnPolicy):
        return policy
    offsets, _ = rounding_offsets(policy, target)
    copy = with_offsets(policy, offsets)
    for matrix in copy.groups.values():
        matrix.mask *= matrix.weight != 0
        matrix.weight.mul_(matrix.mask)  # what is out is stored as zeros, which take no room
    return copy


# -- steps of the encoder, by how much each observation matters and how often it moves


def binary_columns(observation: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Mask (obs,) of observations that take exactly two values, each repeatedly, as contacts do."""
    some = observation[:: max(1, len(observation) // _SAMPLE)]
    found = np.array([_is_binary(column) for column in some.T], np.bool_)
    # a sample may lack the rest of the values
    found[found] = [_is_binary(column) for column in observation.T[found]]
    return found


def _is_binary(column: NDArray[np.floating[Any]]) -> bool:
    low, high = column.min(), column.max()
    ends = np.count_nonzero(column == low), np.count_nonzero(column == high)
    return bool(sum(ends) == len(column) and min(ends) >= _RARE and high - low >= _SWING)


def choose_steps(
    policy: DeltaSnnPolicy, pool: WalkPool, binary: NDArray[np.bool_], config: SparseConfig
) -> FloatArray:
    """Return steps (obs,) of equal marginal cost, with the configured geometric mean.

    An event costs its fan-out F, and E|dx| / step of them are sent; the error of the actions grows
    with (step^2 / 12) H, where H = E |d action / d x|^2. The least error for the operations is at

        step ~ (F E|dx| / H)^(1/3)

    Steps of binary observations, and of those that nothing reads, stay as they are.
    """
    step: FloatArray = policy.step.double().numpy().copy()
    fan_out = policy.into.fan_out + policy.past.fan_out if policy.skip else policy.into.fan_out
    matters = _sensitivity(policy, pool, config)
    cost = fan_out.numpy() * pool.mean_move
    chosen = (cost > 0) & (matters > 0) & ~binary
    if not chosen.any():
        return step
    wanted = np.cbrt(cost[chosen] / matters[chosen])
    wanted *= config.step / np.exp(np.log(wanted).mean())
    step[chosen] = np.clip(wanted, _MIN_STEP, _MAX_STEP)
    return step


def _sensitivity(policy: DeltaSnnPolicy, pool: WalkPool, config: SparseConfig) -> FloatArray:
    """Mean squared gradient H (obs,) of the actions, from random projections of them."""
    batch = pool.sample(np.random.default_rng(0), _WINDOWS, config.window, config.burn_in)
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


@torch.no_grad()
def choose_thresholds(policy: DeltaMlpPolicy, pool: WalkPool, config: SparseConfig) -> Tensor:
    """Return thresholds (H,), the policy's share of the standard deviation of each activation.

    That of a neuron whose activation hardly varies stays as it is.
    """
    batch = pool.sample(np.random.default_rng(0), _WINDOWS, config.window, config.burn_in)
    seen = batch.seen[:, config.burn_in :]
    spread = torch.relu(policy.into.drive(seen, policy.into()) + policy.bias).std((0, 1))
    return torch.where(spread > _MIN_SPREAD, policy.share * spread, policy.threshold)
