"""Policies that see by events: counts of an event camera into convolutions, with a memory.

Float, from counts x (C, Y, X) of a control step:

    h = relu(K x + b) ... ;  f = relu(W h + b) ... ;  m = GRU(f) ;  logits = Wo m + c

or without convolutions, from counts that are summed over a grid, and from leaky traces of them,
r = lambda r + x, which are the memory of policies without a GRU.

Spiking, in one timestep a control step, with states that live on through an episode:

    s = LIF(K x) ... ;  h = LIF(i) ;  i = alpha i + W s + R h[t-1] ;  y = gamma y + Wo h + Ws s
    logits = y + c

Currents `i` of some hidden neurons decay slowly: they remember what a sign said, which a membrane
forgets with its next spike. Those of the others do not last (alpha = 0).

`x` are binary: of counts above 1 further channels (runtime.codec.events). Every layer takes a
timestep to arrive (clock "pipelined"), as on a chip whose cores all advance at once.

While they learn, both have a second head, which says what the signs did: none, left or right. It
is no part of what is deployed.
"""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, cast

import nir
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.codec.codec import Codec, Normaliser
from spikedeploy.runtime.codec.events import EventEncoder
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.network import to_array
from spikedeploy.trainers.neurons import integrate_many, lif, spike, surrogate
from spikedeploy.trainers.policies.delta import DT
from spikedeploy.trainers.policies.policy import (
    Head,
    Latent,
    Policy,
    PrunedKernel,
    PrunedWeight,
    TorchNormaliser,
)

SIGNS = 3  # none, left, right: of the second head
_THRESHOLD = 1.0
_RATE = 0.08  # initial share of timesteps in which a neuron of a spiking layer spikes
_FAST, _SLOW = (1.0, 5.0), (10.0, 100.0)  # time constants of membranes, of currents [timesteps]
_READOUT = 0.7  # initial decay factor of readouts
_SIGNS = 0.9  # of those of the second head, which remembers for longer
_CONVOLVED = 0.5  # initial decay factor of the membranes of convolutions


@dataclass(frozen=True)
class Unrolled:
    """Outputs of windows of L control steps.

    mean: (B, L, act) logits of the actions
    signs: (B, L, 3) logits of the second head
    inputs: of each group of synapses (L B, M), in the order of `VisionPolicy.synapses`
    state: behind the window
    """

    mean: Tensor
    signs: Tensor
    inputs: list[Tensor]
    state: list[Tensor]


class VisionPolicy(Policy):
    """What sees by events: counts (B, C·Y·X) in, the logit of each action out.

    shape: (C, Y, X) of the counts
    synapses: weights by name, in the order in which they are computed
    biases: of each of them, by the same name
    signs: second head, of the features that the first one reads
    """

    shape: tuple[int, int, int]
    synapses: nn.ModuleDict
    biases: nn.ParameterDict
    signs: nn.Linear

    @abstractmethod
    def rest(self, robots: int) -> list[Tensor]:
        """Return the state at the beginning of an episode."""

    @abstractmethod
    def unrolled(
        self, counts: Tensor, weights: Mapping[str, Tensor], state: Sequence[Tensor]
    ) -> Unrolled:
        """Return what windows of counts (B, L, C·Y·X) give, from a state on."""

    def weights(self) -> dict[str, Tensor]:
        """Return weights by name, masks applied."""
        return {name: self.matrix(name)() for name in self.synapses}

    def matrix(self, name: str) -> PrunedWeight:
        """Return weights and mask by name."""
        return cast(PrunedWeight, self.synapses[name])

    def inputs(self, name: str) -> int:
        """Return how many presynaptic neurons a group of synapses has."""
        return self.matrix(name).fan_out.numel()

    @abstractmethod
    def normalise(self, counts: Tensor) -> None:
        """Scale the first weights, layer by layer, to what counts (B, L, C·Y·X) bring."""

    @abstractmethod
    def slowed(self, times: float) -> "VisionPolicy":
        """Return a policy with the same time constants at so many times as many control steps."""

    def advance(self, observation: Tensor, state: list[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """Take one control step: return logits (B, act), and inputs (B, M) of each matrix.

        `state` is moved on.
        """
        done = self.unrolled(observation[:, None], self.weights(), state)
        state[:] = done.state
        return done.mean[:, 0], done.inputs

    def latent(self, observation: Tensor) -> Latent:
        """Return the output of the first control step of an episode."""
        mean, _ = self.advance(observation, self.rest(len(observation)))
        return Latent(mean, mean)

    def _convolutions(
        self, source: Sequence[int], channels: Sequence[int], kernels: Sequence[int],
        strides: Sequence[int],
    ) -> int:  # fmt: skip
        """Add convolutions conv1, conv2 ...; return how many numbers the last gives."""
        for number, sizes in enumerate(zip(channels, kernels, strides, strict=True), start=1):
            kernel = PrunedKernel(source, *sizes)
            self.synapses[f"conv{number}"], source = kernel, kernel.target
        return int(np.prod(source))

    def _dense(self, name: str, inputs: int, outputs: int, gain: float = 2.0) -> int:
        """Add a full matrix (He et al. 2015); return its width."""
        weight = torch.randn(outputs, inputs) * (gain / max(inputs, 1)) ** 0.5
        self.synapses[name] = PrunedWeight(weight)
        return outputs


class FloatVisionPolicy(VisionPolicy):
    """Counts, or sums of them over a grid, into ReLU layers and a GRU.

    pool: (y, x) cells of counts that are added up for a cell of the grid
    traces: decay factors of leaky traces of the grid, which are further inputs
    channels, kernels, strides: of each convolution
    hidden: widths of the dense layers
    gru: width of the GRU; 0 for none
    """

    kind = "vision"

    def __init__(
        self,
        observations: int,
        actions: int,
        shape: Sequence[int] = (2, 16, 32),
        pool: Sequence[int] = (1, 1),
        traces: Sequence[float] = (),
        channels: Sequence[int] = (8, 16),
        kernels: Sequence[int] = (5, 3),
        strides: Sequence[int] = (2, 2),
        hidden: Sequence[int] = (32,),
        gru: int = 32,
        clip: float = 4.0,
        head: Head = "discrete",
    ) -> None:
        super().__init__()
        self.observations, self.actions, self.head = observations, actions, head
        self.shape = cast(tuple[int, int, int], tuple(shape))
        self.pool, self.traces = tuple(pool), tuple(traces)
        self.channels, self.kernels, self.strides = tuple(channels), tuple(kernels), tuple(strides)
        self.hidden, self.gru = tuple(hidden), gru
        self.normalizer = TorchNormaliser(observations, clip)
        self.synapses = nn.ModuleDict()
        grid = (shape[0], shape[1] // pool[0], shape[2] // pool[1])
        source = ((1 + len(traces)) * grid[0], *grid[1:])
        self.grid = int(np.prod(grid))
        width = self._convolutions(source, channels, kernels, strides)
        for number, size in enumerate(hidden, start=1):
            width = self._dense(f"fc{number}", width, size)
        if gru:
            self._dense("gru", width, 3 * gru, 1.0)
            width = self._dense("back", gru, 3 * gru, 1.0) // 3
        self._dense("out", width, actions, 1.0)
        self.latent_size = width
        self.signs = nn.Linear(width, SIGNS)
        self.biases = nn.ParameterDict(
            {name: torch.zeros(self.matrix(name).weight.shape[0]) for name in self.synapses}
        )

    def rest(self, robots: int) -> list[Tensor]:
        """Return the state at the beginning of an episode: traces (B, k, grid), memory (B, H)."""
        zeros = self.signs.weight.new_zeros
        return [zeros(robots, len(self.traces), self.grid), zeros(robots, self.gru)]

    def unrolled(
        self, counts: Tensor, weights: Mapping[str, Tensor], state: Sequence[Tensor]
    ) -> Unrolled:
        """Return what windows of counts (B, L, C·Y·X) give, from a state on."""
        batch, length = counts.shape[:2]
        traces, memory = state
        x = self.normalizer(counts.flatten(0, 1))
        if self.pool != (1, 1):
            maps = avg_pool2d(x.view(-1, *self.shape), self.pool, divisor_override=1)
            x = maps.flatten(1)
        if self.traces:
            x, traces = self._with_traces(x.view(batch, length, -1), traces)
        inputs = []
        for name in self.synapses:
            if name in ("gru", "back", "out"):
                continue
            inputs.append(x)
            drive = self.matrix(name).drive(x, weights[name])
            maps = drive.view(len(drive), len(self.biases[name]), -1)
            x = torch.relu(maps + self.biases[name][:, None]).flatten(1)
        if self.gru:
            inputs.append(x)
            names = ("gru", "back")
            parameters = [weights[n] for n in names] + [self.biases[n] for n in names]
            rows, last = torch.gru(  # batch first, one layer, one direction
                x.view(batch, length, -1), memory[None], parameters,
                True, 1, 0.0, False, False, True,
            )  # fmt: skip
            memory = last[0]
            inputs.append(rows.flatten(0, 1))
            x = rows.flatten(0, 1)
        inputs.append(x)
        mean = self.matrix("out").drive(x, weights["out"]) + self.biases["out"]
        shape = batch, length, -1
        return Unrolled(mean.view(shape), self.signs(x).view(shape), inputs, [traces, memory])

    def _with_traces(self, grid: Tensor, traces: Tensor) -> tuple[Tensor, Tensor]:
        """Return the grid (B, L, M) with its traces behind it (B L, (1 + k) M), and the traces."""
        decay, rows = grid.new_tensor(self.traces)[:, None], []
        for now in grid.unbind(1):
            traces = decay * traces + now[:, None]
            rows.append(traces)
        # a trace of a steady count is that count
        scaled = torch.stack(rows, 1) * (1 - decay)
        return torch.cat([grid[:, :, None], scaled], 2).flatten(2).flatten(0, 1), traces

    @torch.no_grad()
    def normalise(self, counts: Tensor) -> None:
        """Scale weights, layer by layer, so that activations of counts (B, L, obs) are of size 1.

        Sparse events otherwise leave a plateau at the beginning of training.
        """
        for number, name in enumerate(self.synapses):
            if name in ("gru", "back", "out"):
                break
            x = self.unrolled(counts, self.weights(), self.rest(len(counts))).inputs[number]
            matrix = self.matrix(name)
            drive = matrix.drive(x, matrix())
            matrix.weight.div_(drive.square().mean().sqrt().clamp(min=1e-6))

    @torch.no_grad()
    def slowed(self, times: float) -> "FloatVisionPolicy":
        """Return a policy with the same time constants at so many times as many control steps.

        Each of these brings so many times fewer events, for which the first weights make up.
        ConfigError where it has leaky traces.
        """
        if self.traces:
            raise ConfigError("a policy with leaky traces has no other control rate; take another")
        policy = deepcopy(self)
        policy.matrix(next(iter(policy.synapses))).weight.mul_(times)
        if self.gru:
            # h' = z h + (1 - z) n: where the memory lasts, 1 - z = sigmoid(-a) is as much less
            policy.biases["gru"][self.gru : 2 * self.gru] += math.log(times)
        return policy


class SpikingVisionPolicy(VisionPolicy):
    """Binary events into convolutions of LIF neurons, a hidden layer, and leaky readouts.

    most: largest count that is told: "lif" has a channel of 1 and more, one of 2 and more ...; "if"
        takes counts as so many spikes of one channel
    channels, kernels, strides: of each convolution
    hidden: neurons of the layer behind them
    memory: those of them whose currents decay slowly
    recurrent: whether they are connected with each other
    skip: whether the last convolution also reaches the readouts
    neuron: "lif", whose spikes reset to 0, or "if", for Speck: without leak, bias and recurrence,
        several spikes a timestep, which subtract
    """

    kind = "vision-snn"
    timesteps = 1

    def __init__(
        self,
        observations: int,
        actions: int,
        shape: Sequence[int] = (2, 16, 32),
        most: int = 1,
        channels: Sequence[int] = (4, 8),
        kernels: Sequence[int] = (3, 3),
        strides: Sequence[int] = (2, 2),
        hidden: int = 64,
        memory: int = 0,
        recurrent: bool = True,
        skip: bool = True,
        neuron: Literal["lif", "if"] = "lif",
        clock: Literal["gated", "pipelined"] = "pipelined",
        surrogate_width: float = 2.0,
        clip: float = 255.0,
        head: Head = "discrete",
    ) -> None:
        super().__init__()
        self.observations, self.actions, self.head = observations, actions, head
        self.shape, self.most = cast(tuple[int, int, int], tuple(shape)), most
        self.channels, self.kernels, self.strides = tuple(channels), tuple(kernels), tuple(strides)
        self.hidden, self.memory, self.recurrent, self.skip = hidden, memory, recurrent, skip
        self.neuron, self.clock, self.surrogate_width = neuron, clock, surrogate_width
        self.normalizer = TorchNormaliser(observations, clip)
        self.synapses = nn.ModuleDict()
        width = self._convolutions(self._encoded, channels, kernels, strides)
        self._dense("hidden", width, hidden)
        if recurrent:
            self._dense("back", hidden, hidden, 0.5)
        self._dense("out", hidden, actions, 1.0)
        if skip:
            self._dense("past", width, actions, 0.0)
        self.latent_size = hidden
        # it also sees the last convolution, so that gradients reach that one directly
        self.signs = nn.Linear(hidden + width, SIGNS)
        self.biases = nn.ParameterDict({"out": torch.zeros(actions)})
        self.decays = nn.ParameterDict()
        if neuron == "lif":
            self._leak(memory)
        readout = torch.logit(torch.tensor(_READOUT))
        self.decays["out"] = readout.repeat(actions)
        self.decays["signs"] = torch.logit(torch.tensor(_SIGNS)).repeat(SIGNS)
        self._gradient = surrogate("atan", surrogate_width)

    def _leak(self, memory: int) -> None:
        """Add biases and decay factors of neurons, and of the currents of some of them."""
        for name in self.spiking:
            self.biases[name] = torch.zeros(self.matrix(name).weight.shape[0])
        beta, alpha = (_spread_decays(*each) for each in ((*_FAST, self.hidden), (*_SLOW, memory)))
        self.decays["hidden"] = torch.logit(beta)
        if memory:
            self.decays["current"] = torch.logit(alpha)
            with torch.no_grad():
                for name in ("hidden", "back") if self.recurrent else ("hidden",):
                    # a current that sums up steady noise is as large as one that does not
                    self.matrix(name).weight[-memory:] *= (1 - alpha**2).sqrt()[:, None]
        convolved = torch.logit(torch.tensor(_CONVOLVED))
        for name in self.spiking[:-1]:
            self.decays[name] = convolved.repeat(self.matrix(name).weight.shape[0])

    @property
    def spiking(self) -> list[str]:
        """Names of the layers that spike."""
        return [*(f"conv{k}" for k in range(1, len(self.channels) + 1)), "hidden"]

    @property
    def _encoded(self) -> tuple[int, int, int]:
        """Channels, rows and columns of what the encoder sends."""
        each = self.most if self.neuron == "lif" else 1
        return each * self.shape[0], self.shape[1], self.shape[2]

    def decay(self, name: str) -> Tensor:
        """Return decay factors, of each channel, hidden neuron or readout; of "lif" alone."""
        return torch.sigmoid(self.decays[name])

    @torch.no_grad()
    def slowed(self, times: float) -> "SpikingVisionPolicy":
        """Return the policy with the same time constants at so many times as many timesteps."""
        policy = deepcopy(self)
        for decays in policy.decays.values():
            decays.copy_(torch.logit(torch.sigmoid(decays.double()) ** (1 / times)))
        for name in policy.spiking if policy.neuron == "lif" else ():
            # as much is summed up: b' / (1 - beta') = b / (1 - beta)
            new, old = (torch.sigmoid(-each.decays[name].double()) for each in (policy, self))
            share = (new / old).float()
            policy.biases[name] *= share
            if name == "hidden" and policy.memory:  # so do currents that last
                for synapses in ("hidden", "back") if policy.recurrent else ("hidden",):
                    policy.matrix(synapses).weight[-policy.memory :] *= share[
                        -policy.memory :, None
                    ]
        return policy

    @property
    def current_decay(self) -> Tensor:
        """Return decay factors of the currents of hidden neurons."""
        found = self.signs.weight.new_zeros(self.hidden)
        if self.memory:
            found = torch.cat([found[self.memory :], torch.sigmoid(self.decays["current"])])
        return found

    def encode(self, counts: Tensor) -> Tensor:
        """Return the events (n, most C·Y·X) of counts (n, C·Y·X), 0 or 1; of "if" (n, C·Y·X)."""
        if self.neuron == "if":
            sent: Tensor = self.normalizer(counts).floor().clamp(0, self.most)
            return sent
        levels = torch.arange(1, self.most + 1, dtype=counts.dtype)[:, None]
        seen: Tensor = self.normalizer(counts).reshape(len(counts), self.shape[0], 1, -1)
        return (seen >= levels).to(self.signs.weight.dtype).flatten(1)

    def rest(self, robots: int) -> list[Tensor]:
        """Return the state at the beginning of an episode.

        Membranes of each spiking layer (B, N), what each sends (B, N), the events that are under
        way (B, M), the currents (B, H), and the readouts (B, act) and (B, 3).
        """
        zeros = self.signs.weight.new_zeros
        sizes = [self._size(name) for name in self.spiking]
        events = int(np.prod(self._encoded))
        return [
            zeros(robots, size)
            for size in (*sizes, *sizes, events, self.hidden, self.actions, SIGNS)
        ]

    def _size(self, name: str) -> int:
        matrix = self.matrix(name)
        return int(np.prod(matrix.target)) if isinstance(matrix, PrunedKernel) else self.hidden

    def unrolled(
        self,
        counts: Tensor,
        weights: Mapping[str, Tensor],
        state: Sequence[Tensor],
        seen: Mapping[str, tuple[Tensor, Tensor]] | None = None,
    ) -> Unrolled:
        """Return what windows of counts (B, L, C·Y·X) give, from a state on.

        seen: of "if", spikes and membranes (L, B, N) that layers had on a chip, by their names
        """
        batch, length = counts.shape[:2]
        layers = self.spiking
        count = len(layers)
        membranes, sent = list(state[:count]), list(state[count : 2 * count])
        under_way, current, readout, signs = state[2 * count :]
        # time comes first from here on: rows (L, B, N)
        rows = self.encode(counts.transpose(0, 1).flatten(0, 1)).view(length, batch, -1)
        inputs, before = [], under_way
        under_way = rows[-1]
        for k, name in enumerate(layers):
            arriving = self._late(rows, before)
            inputs.append(arriving.flatten(0, 1))
            drive = self.matrix(name).drive(inputs[-1], weights[name]).view(length, batch, -1)
            before = sent[k]
            if self.neuron == "if":
                on_chip = None if seen is None else seen[name]
                rows, membranes[k] = integrate_many(drive, membranes[k], on_chip)
            elif name == "hidden":
                rows, membranes[k], current = self._hidden_spikes(
                    drive, membranes[k], current, weights.get("back"), before
                )
            else:
                # one of each channel
                beta, bias = (
                    each.repeat_interleave(drive.shape[-1] // len(each))
                    for each in (self.decay(name), self.biases[name])
                )
                rows, membranes[k] = lif(drive + bias, beta, membranes[k], self._gradient)
            sent[k] = rows[-1]
        hidden = self._late(rows, before)
        if self.recurrent:
            inputs.append(hidden.flatten(0, 1))
        inputs.append(hidden.flatten(0, 1))
        onto = hidden @ weights["out"].T
        if self.skip:
            # `arriving` is what the hidden layer got: the last convolution, a timestep late
            inputs.append(arriving.flatten(0, 1))
            onto = onto + arriving @ weights["past"].T
        about = torch.cat([hidden, arriving], -1) @ self.signs.weight.T
        means, said = [], []
        gamma, delta = self.decay("out"), self.decay("signs")
        for drive, other in zip(onto.unbind(), about.unbind(), strict=True):
            readout, signs = gamma * readout + drive, delta * signs + other
            means.append(readout)
            said.append(signs)
        mean = torch.stack(means, 1) + self.biases["out"]
        behind = [*membranes, *sent, under_way, current, readout, signs]
        return Unrolled(mean, torch.stack(said, 1) + self.signs.bias, inputs, behind)

    def _late(self, rows: Tensor, before: Tensor) -> Tensor:
        """Return rows (L, B, N) as they arrive: pipelined, a control step after they were sent."""
        return torch.cat([before[None], rows[:-1]]) if self.clock == "pipelined" else rows

    def _hidden_spikes(
        self,
        drive: Tensor,
        membrane: Tensor,
        current: Tensor,
        back: Tensor | None,
        sent: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return spikes (L, B, H), and membranes and currents behind them.

        back: recurrent weights (H, H), through which spikes come back in the next timestep
        """
        alpha, beta, bias = self.current_decay, self.decay("hidden"), self.biases["hidden"]
        raster = []
        for x in drive.unbind():
            # I = alpha I + x + R s ; V = beta V + I + b
            current = alpha * current + x
            if back is not None:
                current = current + sent @ back.T
            sent, membrane = self._fired(beta * membrane + current + bias)
            raster.append(sent)
        return torch.stack(raster), membrane, current

    def _fired(self, membrane: Tensor) -> tuple[Tensor, Tensor]:
        """Return spikes, and membranes behind their reset."""
        # s = V > 1 ; V = (1 - s) V
        sent = spike(membrane - _THRESHOLD, self._gradient)
        return sent, membrane * (1 - sent.detach())  # no gradient through the reset

    @torch.no_grad()
    def normalise(self, counts: Tensor) -> None:
        """Scale weights, layer by layer, so that neurons spike now and then for these counts."""
        for k, name in enumerate(self.spiking):
            for _ in range(6):
                done = self.unrolled(counts, self.weights(), self.rest(len(counts)))
                last = done.inputs[k + 1]  # what this layer sends
                rate = last.mean().clamp(min=1e-3)
                self.matrix(name).weight.mul_((_RATE / rate).sqrt().clamp(0.5, 2.0))


def _spread_decays(first: float, last: float, count: int) -> Tensor:
    """Return decay factors of time constants, evenly spaced by their logarithms [timesteps]."""
    tau = np.geomspace(first, last, count)
    return torch.exp(-1 / torch.from_numpy(tau)).float()


def vision_artifact(
    policy: SpikingVisionPolicy, origin: Provenance | None = None, dt: float = DT
) -> Artifact:
    """Return the policy as an artifact, every number in float64; its states are kept.

        input (K C, Y, X) -> conv1 -> lif1 -> ... -> flat -> hidden -> lif -> out -> readout
                                                       |       back <-> lif          |
                                                       +------------ past -----------+-> action

    Spiking neurons have gains of 1; `readout` is an LI, and `action` adds its constant.
    """
    precise = deepcopy(policy).double()
    convention = Convention(
        dt=dt, reset="zero", source="as trained", state="kept", clock=policy.clock
    )
    if policy.neuron == "if":
        convention = replace(convention, reset="subtract", spikes="many", floor="threshold")
    return Artifact(_graph(precise, dt), vision_codec(precise), convention, origin)


def vision_codec(policy: SpikingVisionPolicy) -> Codec:
    """Return normaliser, encoder and decoder, as a file holds them."""
    normalizer = policy.normalizer
    return Codec(
        Normaliser(to_array(normalizer.mean), to_array(normalizer.std), normalizer.clip),
        EventEncoder(
            policy.observations,
            policy.shape[0],
            policy.most,
            "counts" if policy.neuron == "if" else "channels",
        ),
        policy.timesteps,
        "argmax" if policy.head == "discrete" else "tanh",
    )


def _graph(policy: SpikingVisionPolicy, dt: float) -> nir.NIRGraph:
    weights = {name: to_array(weight) for name, weight in policy.weights().items()}
    source: tuple[int, ...] = policy._encoded
    nodes: dict[str, nir.NIRNode] = {"input": nir.Input({"input": np.array(source)})}
    for number, name in enumerate(policy.spiking[:-1], start=1):
        kernel = cast(PrunedKernel, policy.matrix(name))
        has_bias = policy.neuron == "lif"
        bias = to_array(policy.biases[name]) if has_bias else np.zeros(kernel.target[0])
        nodes[name] = nir.Conv2d(
            source[1:], weights[name], kernel.stride, kernel.padding, 1, 1, bias,
        )  # fmt: skip
        nodes[f"lif{number}"] = _neurons(policy, name, kernel.target, dt)
        source = kernel.target
    nodes["flat"] = nir.Flatten({"input": np.array(source)}, 0, -1)
    last = f"lif{len(policy.spiking)}"
    if policy.neuron == "if":
        nodes["hidden"] = nir.Linear(weights["hidden"])
        nodes[last] = _neurons(policy, "hidden", (policy.hidden,), dt)
    elif policy.memory:
        nodes["hidden"], nodes[last] = nir.Linear(weights["hidden"]), _hidden_neurons(policy, dt)
    else:
        nodes["hidden"] = nir.Affine(weights["hidden"], to_array(policy.biases["hidden"]))
        nodes[last] = _neurons(policy, "hidden", (policy.hidden,), dt)
    nodes["out"] = nir.Linear(weights["out"])
    gamma = to_array(policy.decay("out"))
    tau = dt / (1 - gamma)
    nodes["readout"] = nir.LI(tau=tau, r=tau / dt, v_leak=np.zeros(tau.size))
    nodes["action"] = nir.Affine(np.eye(policy.actions), to_array(policy.biases["out"]))
    nodes["output"] = nir.Output({"output": np.array([policy.actions])})
    edges = list(pairwise(nodes))
    if policy.recurrent:
        nodes["back"] = nir.Linear(weights["back"])
        edges += [(last, "back"), ("back", last)]
    if policy.skip and weights["past"].any():
        nodes["past"] = nir.Linear(weights["past"])
        edges += [("flat", "past"), ("past", "readout")]
    return nir.NIRGraph(nodes, edges)


def _neurons(
    policy: SpikingVisionPolicy, name: str, shape: tuple[int, ...], dt: float
) -> nir.LIF | nir.IF:
    """Return the neurons (O, Y, X) of a convolution or (N,) of a matrix, with gains of 1."""
    zeros, threshold = np.zeros(shape), np.full(shape, _THRESHOLD)
    if policy.neuron == "if":
        return nir.IF(r=np.full(shape, 1 / dt), v_threshold=threshold, v_reset=zeros)
    decay = to_array(policy.decay(name)).reshape(-1, *(1,) * (len(shape) - 1))
    tau = np.broadcast_to(dt / (1 - decay), shape).copy()
    return nir.LIF(tau=tau, r=tau / dt, v_leak=zeros, v_threshold=threshold, v_reset=zeros)


def _hidden_neurons(policy: SpikingVisionPolicy, dt: float) -> nir.CubaLIF:
    """Return hidden neurons with gains of 1; their bias is that of the resting membrane."""
    beta, alpha = to_array(policy.decay("hidden")), to_array(policy.current_decay)
    tau_mem, tau_syn = dt / (1 - beta), dt / (1 - alpha)
    return nir.CubaLIF(
        tau_syn=tau_syn,
        tau_mem=tau_mem,
        r=tau_mem / dt,
        v_leak=to_array(policy.biases["hidden"]) / (1 - beta),
        v_reset=np.zeros(beta.size),
        v_threshold=np.full(beta.size, _THRESHOLD),
        w_in=tau_syn / dt,
    )
