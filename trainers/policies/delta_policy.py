"""Event-driven policies: delta code, a layer of LIF or sigma-delta neurons, leaky readout.

    n     signed events of the observation              (runtime.codec.delta)
    I     = a I + W (step n)                            a just below 1: W times the observation
    V     = beta V + I + b ;  s = V > 1 ;  V = (1 - s) V
    y     = gamma y + Wo s + Ws (step n)                the events also reach the readout directly
    action = tanh(y + c)

An integrated skip has readouts of its own, which hardly decay, so that they hold what the
observation is and not only how it moved lately:

    y     = gamma y + Wo s ;  z = a z + Ws (step n) ;  action = tanh(y + z + c)

Of the hidden neurons some may be deep: they read no events, but what the others sent in the
timestep before, with currents that do not last:

    I     = R s[t-1]

Memoryless neurons are threshold units (McCulloch and Pitts 1943), as far as chips allow: beta and
gamma are 1/4096, so that a neuron spikes in each timestep in which its input is above the
threshold, and actions depend on the latest observations alone.

Currents, membranes and readouts live on from one control step to the next. A control step has T
timesteps; in each the encoder sends what is still missing, up to its most events, and the action is
that of the last.

The equations are those of a gated clock. Pipelined, as on a chip whose cores all advance in each
timestep, everything takes one timestep to arrive: events reach currents and readouts one timestep
late, and hidden spikes the readout one later still (runtime.convention.Clock):

    I[t] = a I[t-1] + W (step n[t-1]) ;  y[t] = gamma y[t-1] + Wo s[t-1] + Ws (step n[t-1])

With T = 1 an action is that of what was seen one to two control steps before, or three with deep
neurons; from T = 3 on, or 4, of what is seen now.
"""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import nir
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import pad

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.codec.codec import Codec, Normaliser
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.graph.neurons import SigmaDelta
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import DeltaMlpConfig, DeltaSnnConfig
from spikedeploy.trainers.neurons import spike, surrogate
from spikedeploy.trainers.policies.policy import (
    Head,
    Latent,
    Policy,
    PrunedWeight,
    TorchNormaliser,
)
from spikedeploy.trainers.policies.shared_weights import Copies, weights_between
from spikedeploy.trainers.torch_network import to_array

Array = NDArray[np.float64]

# Loihi's slowest decay: what lava and nengo-loihi make of a decay register of 0
CURRENT_DECAY = 4095 / 4096
_THRESHOLD = 1.0
_EVENTS_ABOVE = 154  # [1/256 steps], as runtime.codec.delta.DeltaEncoder has it
_STEP = 0.5  # [standard deviations] until steps are chosen
_BETA, _GAMMA = 0.6, 0.5  # initial decay factors of membranes and readouts
_DEEP_BETA, _DEEP_GAMMA = 0.7, 0.9  # of deep neurons, and of readouts where there are some
_MEMORYLESS = 1 / 4096  # Loihi's fastest decay, of a register of 4095
DEEP_NODE = "lif2"
DT = 1e-3  # [s] one timestep; policies have no unit of time, and chips run near this value


@dataclass
class DeltaState:
    """State of a batch of robots between two control steps.

    level: (B, obs) events sent so far, with their signs
    current: (B, H) of the hidden neurons
    membrane: (B, H)
    readout: (B, act)
    integral: (B, act) of an integrated skip
    moved: (B, obs) step times events that arrive in the next timestep, where pipelined
    spikes: (B, H) of the hidden neurons in the last timestep
    """

    level: Tensor
    current: Tensor
    membrane: Tensor
    readout: Tensor
    integral: Tensor
    moved: Tensor
    spikes: Tensor


class DeltaSnnPolicy(Policy):
    """Signed events into a small layer of LIF neurons and, past it, into the readout.

    settings: layers, code and clock, as in DeltaSnnConfig; `hidden` and `deep` are of each copy
    copies: copies of a network that serves several parts of a body; None for one network
    two_valued: observations with two values that are a step apart: their channels of several events
        are never used; of a one-hot code they weigh as much as that of one, so that they do not
        make a chip's weights coarser, of a unary code nothing
    current_decay: factor by which currents, and the integrals of a skip, keep what events brought
    hidden: neurons H of all copies together, the deep ones included; 0 leaves the readout alone: a
        delta-coded linear policy, whose readout decays as slowly as the currents do
    deep_neurons: (H,) which hidden neurons are deep
    step: (obs,) distance that one event stands for [normalised observation]
    threshold: (H,) membrane above which a neuron spikes: 1, or the chip's nearest to it
    into, out, past: synapses onto the hidden neurons, from them, and past them
    back: synapses from hidden neurons onto deep ones; its other masks are 0
    """

    kind = "delta-snn"
    current_decay = CURRENT_DECAY
    step: Tensor
    threshold: Tensor
    _beta: Tensor
    _gamma: Tensor

    def __init__(
        self,
        observations: int,
        actions: int,
        settings: DeltaSnnConfig | None = None,
        clip: float = 4.0,
        head: Head = "continuous",
        copies: Copies | None = None,
        two_valued: Sequence[int] = (),
    ) -> None:
        super().__init__()
        c = settings or DeltaSnnConfig()
        self.settings, self.two_valued, self.copies = c, tuple(two_valued), copies
        self.clock, self.timesteps, self.memoryless = c.clock, c.timesteps, c.memoryless
        parts = copies.count if copies else 1
        self.most, self.code, self.deep = c.most, c.code, parts * c.deep
        width = c.hidden + c.deep
        hidden = parts * width
        self.deep_neurons = torch.arange(hidden) % max(width, 1) >= c.hidden
        self.observations, self.actions, self.hidden = observations, actions, hidden
        self.skip = c.skip or not hidden
        self.integrated = (c.integrated or c.memoryless) and c.skip and hidden > 0
        self.head, self.latent_size = head, hidden
        self.normalizer = TorchNormaliser(observations, clip)
        self.register_buffer("step", torch.full((observations,), _STEP))
        self.register_buffer("threshold", torch.full((hidden,), _THRESHOLD))
        self.into = weights_between(
            copies, (observations, hidden), lambda n, m: torch.randn(n, m) * (0.6 * (2 / m) ** 0.5),
            reads=True,
        )  # fmt: skip
        self.bias = nn.Parameter(torch.full((hidden,), 0.2))
        self.out = weights_between(
            copies, (hidden, actions), lambda n, m: torch.randn(n, m) * 0.75 / max(m, 1) ** 0.5,
            acts=True,
        )  # fmt: skip
        if c.deep:
            self.back = weights_between(copies, (hidden, hidden), _back)
            # deep neurons read the others of their copy alone, and these read events alone
            self.into.mask[-c.deep :] = 0.0
            self.back.mask[: -c.deep] = 0.0
            self.back.mask[:, -c.deep :] = 0.0
        read = observations if self.skip else 0
        self.past = weights_between(copies, (read, actions), torch.zeros, reads=True, acts=True)
        self.action_bias = nn.Parameter(torch.zeros(actions))
        beta = torch.where(self.deep_neurons, _DEEP_BETA, _BETA)
        gamma = _DEEP_GAMMA if c.deep else _GAMMA
        if c.memoryless:
            beta, gamma = torch.full((hidden,), _MEMORYLESS), _MEMORYLESS
        decays = {"_beta": beta, "_gamma": torch.full((actions,), gamma)}
        for name, decay in decays.items():
            if c.memoryless:
                self.register_buffer(name, decay.logit())
            else:
                self.register_parameter(name, nn.Parameter(decay.logit()))
        # readouts that last for longer sum up more spikes
        self.out.weight.data *= (1 - gamma) / (1 - _GAMMA)
        self._gradient = surrogate("atan", c.surrogate_width)

    @property
    def groups(self) -> dict[str, PrunedWeight]:
        """All synapses, by the name of their field in DeltaWeights."""
        found = {"into": self.into, "out": self.out, "past": self.past}
        return {**found, "back": self.back} if self.deep else found

    @property
    def beta(self) -> Tensor:
        """Decay factor of each hidden neuron's membrane (H,)."""
        return torch.sigmoid(self._beta)

    def set_decays(self, beta: Tensor, gamma: Tensor) -> None:
        """Set the decay factors (H,) and (act,); those that are not trained stay as they are."""
        self._beta.data = torch.logit(beta)
        self._gamma.data = torch.logit(gamma) if self.hidden else self._gamma.data

    @property
    def gamma(self) -> Tensor:
        """Decay factor of each readout (act,)."""
        if not self.hidden:
            return torch.full_like(self._gamma, self.current_decay)
        return torch.sigmoid(self._gamma)

    def events(self, observation: Tensor, level: Tensor) -> Tensor:
        """Return the signed numbers of events (B, obs) of raw observations at these levels."""
        # X = rint(256 x / step) ; e = X - 256 q ; n = sign(e) min((|e| + 128) >> 8, K)
        parts = torch.round(256 * (self.normalizer(observation) / self.step))
        apart = parts.clamp(-(2**30), 2**30) - 256 * level
        far = apart.abs()
        events: Tensor = torch.floor((far + 128) / 256).clamp(max=self.most) * apart.sign()
        return torch.where(far > _EVENTS_ABOVE, events, torch.zeros_like(events))

    @property
    def delay(self) -> int:
        """Timesteps from an event, or a hidden spike, to where it acts."""
        return int(self.clock == "pipelined")

    def rest(self, robots: int) -> DeltaState:
        """Return the state at the beginning of an episode."""
        zeros = self.action_bias.new_zeros
        seen, hidden = zeros(robots, self.observations), zeros(robots, self.hidden)
        actions = zeros(robots, self.actions)
        return DeltaState(seen, hidden, hidden, actions, actions, seen, hidden)

    def advance(self, observation: Tensor, state: DeltaState) -> tuple[Tensor, Tensor, Tensor]:
        """Take one control step: return mean (B, act), events (B, T, obs), spikes (B, T, H).

        `state` is moved on.
        """
        sent = [self._tick(observation, state) for _ in range(self.timesteps)]
        events, spikes = (torch.stack(each, 1) for each in zip(*sent, strict=True))
        return state.readout + state.integral + self.action_bias, events, spikes

    def _tick(self, observation: Tensor, state: DeltaState) -> tuple[Tensor, Tensor]:
        """Take one timestep: return events (B, obs) and hidden spikes (B, H)."""
        events = self.events(observation, state.level)
        state.level = state.level + events
        moved = self._late(events * self.step, state)
        kept, before = self.current_decay * state.current, state.spikes
        if self.deep:
            kept = torch.where(self.deep_neurons, self.back.drive(before, self.back()), kept)
        state.current = kept + self.into.drive(moved, self.into())
        membrane = self.beta * state.membrane + state.current + self.bias
        spikes = (membrane > self.threshold).to(membrane.dtype)
        state.membrane = membrane * (1 - spikes)
        state.spikes = spikes
        drive = self.out.drive(before if self.delay else spikes, self.out())
        past = self.past.drive(moved, self.past()) if self.skip else 0.0
        if self.integrated:
            state.integral = self.current_decay * state.integral + past
        else:
            drive = drive + past
        state.readout = self.gamma * state.readout + drive
        return events, spikes

    def _late(self, sent: Tensor, state: DeltaState) -> Tensor:
        """Return what arrives in a timestep that sends so much: pipelined, what came before."""
        if not self.delay:
            return sent
        arriving, state.moved = state.moved, sent
        return arriving

    def unrolled(
        self, seen: Tensor, moved: Tensor, weights: "DeltaWeights", burn_in: int, begins: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return means (B, L, act) and spikes (B, L, H) of windows of walks, from rest.

        seen: (B, L T, obs) what the currents hold of the observation: the decayed sum of `moved`
        moved: (B, L T, obs) step times the events that arrive, `delay` after they were sent
        weights: as `weights` returned them
        burn_in: control steps without gradient at the beginning, which bring the states up
        begins: (B,) whether an episode begins behind the burn-in: then states are at rest there
        """
        burn_in *= self.timesteps
        if not self.hidden:  # the readouts hold what currents would hold
            mean = self.past.drive(self._last(seen), weights.past) + self.action_bias
            return mean, mean.new_zeros(*mean.shape[:2], 0)
        if self.memoryless:
            return self._without_memory(seen, weights, burn_in, begins)
        hidden, actions = (seen.new_zeros(len(seen), n) for n in (self.hidden, self.actions))
        runs_on = 1 - begins[:, None].to(seen.dtype)
        with torch.no_grad():  # a window without gradient brings the states up
            first = seen[:, :burn_in], moved[:, :burn_in]
            states, *before = self._window(*first, weights, (hidden, actions, hidden))
            states = tuple(state * runs_on for state in states)
        _, *after = self._window(seen[:, burn_in:], moved[:, burn_in:], weights, states)
        mean, spikes = (torch.cat(parts, 1) for parts in zip(before, after, strict=True))
        if self.integrated:  # the integrals hold what currents would hold
            mean = mean + self.past.drive(seen, weights.past)
        steps = spikes.reshape(len(spikes), -1, self.timesteps, self.hidden)
        return self._last(mean), steps.sum(2)

    def _without_memory(
        self, seen: Tensor, weights: "DeltaWeights", burn_in: int, begins: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Compute as `unrolled`, with zeros in the burn-in; only what the action depends on.

        Spikes are T times those of the timestep that the action reads.

        burn_in: timesteps
        """
        last = torch.arange(burn_in, seen.shape[1])[self.timesteps - 1 :: self.timesteps]
        width = self.hidden // (self.copies.count if self.copies else 1)
        shallow = width - int(self.deep_neurons[:width].sum())
        excess = (weights.bias - weights.threshold).view(-1, width)

        def first(late: int) -> Tensor:
            """Return spikes (B, L, K, n) of the first layer, so many timesteps before."""
            rows = last - late
            drive = self.into.read(seen[:, rows.clamp(min=0)]) @ weights.into[:shallow].T
            spikes = spike(drive + excess[:, :shallow], self._gradient)
            rests = begins[:, None] & (rows < burn_in)
            return spikes.masked_fill(rests[:, :, None, None], 0.0)

        spikes = first(self.delay)
        if weights.back is not None:
            drive = first(2) @ weights.back[shallow:, :shallow].T
            deep = spike(drive + excess[:, shallow:], self._gradient)
            rests = begins[:, None] & (last - 1 < burn_in)
            deep = deep.masked_fill(rests[:, :, None, None], 0.0)
            spikes = torch.cat([spikes, deep], -1)
        spikes = spikes.flatten(2)
        mean = self.out.drive(spikes, weights.out) + self.action_bias
        if self.skip:
            mean = mean + self.past.drive(seen[:, last], weights.past)
        before = (0, 0, burn_in // self.timesteps, 0)
        return pad(mean, before), pad(self.timesteps * spikes, before)

    def _last(self, rows: Tensor) -> Tensor:
        """Return the rows (B, L, n) of the last timesteps of control steps, of all (B, L T, n)."""
        return rows[:, self.timesteps - 1 :: self.timesteps]

    def _window(
        self, seen: Tensor, moved: Tensor, weights: "DeltaWeights", states: tuple[Tensor, ...]
    ) -> tuple[tuple[Tensor, ...], Tensor, Tensor]:
        """Return states behind a window, and its means (B, L, act) and spikes (B, L, H).

        states: membranes (B, H), readouts (B, act) and spikes (B, H) of the control step before
        """
        membrane, readout, emitted = states
        raster, means = [emitted], [readout]
        for drive in (self.into.drive(seen, weights.into) + weights.bias).unbind(1):
            if weights.back is not None:
                drive = drive + self.back.drive(raster[-1], weights.back)
            membrane = weights.beta * membrane + drive
            spikes = spike(membrane - weights.threshold, self._gradient)
            # no gradient through the reset
            membrane = membrane * (1 - spikes.detach())
            raster.append(spikes)
        spiked = torch.stack(raster, 1)
        onto = self.out.drive(spiked[:, :-1] if self.delay else spiked[:, 1:], weights.out)
        if self.skip and not self.integrated:
            onto = onto + self.past.drive(moved, weights.past)
        for drive in onto.unbind(1):
            readout = weights.gamma * readout + drive
            means.append(readout + self.action_bias)
        return (membrane, readout, raster[-1]), torch.stack(means, 1)[:, 1:], spiked[:, 1:]

    def weights(self) -> "DeltaWeights":
        """Return what `unrolled` computes with, masks and decay factors applied."""
        matrices = {name: matrix() for name, matrix in self.groups.items()}
        return DeltaWeights(
            **matrices, beta=self.beta, gamma=self.gamma, bias=self.bias, threshold=self.threshold
        )

    def latent(self, observation: Tensor) -> Latent:
        """Return the output of the first control step of an episode."""
        mean, _, spikes = self.advance(observation, self.rest(len(observation)))
        return Latent(mean, spikes.sum(1), (spikes.mean(),))

    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""
        return super().spec() | {"settings": self.settings.model_dump()}


@dataclass(frozen=True)
class DeltaWeights:
    """Weights, decay factors, biases and thresholds of a DeltaSnnPolicy, masks applied.

    into: (H, obs), or the block that copies share
    out: (act, H), likewise
    past: (act, obs), likewise
    beta: (H,)
    gamma: (act,)
    bias: (H,)
    threshold: (H,)
    back: (H, H), or the block that copies share; None without deep neurons
    """

    into: Tensor
    out: Tensor
    past: Tensor
    beta: Tensor
    gamma: Tensor
    bias: Tensor
    threshold: Tensor
    back: Tensor | None = None


def _back(n: int, m: int) -> Tensor:
    """Return initial weights (n, m) of deep neurons, as if an eighth of the others spiked."""
    weight: Tensor = torch.randn(n, m) * (8 / max(m, 1)) ** 0.5 * 0.6
    return weight


class DeltaMlpPolicy(DeltaSnnPolicy):
    """Delta network: signed events into a layer of sigma-delta ReLU neurons, and past it.

        sigma = sigma + W (step n)                      W times the levels of the code
        a     = max(sigma + b, 0)
        e     = a / threshold - q ;  k = sign(e) floor(|e| + 1/2) where |e| >= 1 ;  q = q + k
        y     = y + Wo (threshold k) + Ws (step n)      an MLP of rounded numbers

    What is sent are changes alone, so that numbers which stay cost nothing (O'Connor and Welling
    2017; runtime.graph.neurons). It is a baseline for the spiking policies: the same code, and a
    float network's activations. In its DeltaState `current` is sigma, and `membrane` q. Nothing
    decays. A control step has one timestep.

    settings: as in DeltaMlpConfig; its threshold is in standard deviations of the activation
    threshold: (H,) distance that a graded spike of 1 stands for
    """

    kind = "delta-mlp"
    current_decay = 1.0

    def __init__(
        self,
        observations: int,
        actions: int,
        settings: DeltaMlpConfig | None = None,
        clip: float = 4.0,
        head: Head = "continuous",
        two_valued: Sequence[int] = (),
    ) -> None:
        own = settings or DeltaMlpConfig()
        network = DeltaSnnConfig(**own.model_dump(exclude={"kind", "threshold"}))
        super().__init__(observations, actions, network, clip, head, None, two_valued)
        del self._beta, self._gamma
        self.settings = own  # type: ignore[assignment]
        self.share = own.threshold
        self.threshold.fill_(own.threshold)

    @property
    def beta(self) -> Tensor:
        """Decay factor of each sigma (H,): 1."""
        return torch.ones_like(self.bias)

    @property
    def gamma(self) -> Tensor:
        """Decay factor of each readout (act,): 1."""
        return torch.ones_like(self.action_bias)

    def _tick(self, observation: Tensor, state: DeltaState) -> tuple[Tensor, Tensor]:
        """Take one timestep: return events (B, obs) and graded spikes (B, H)."""
        events = self.events(observation, state.level)
        state.level = state.level + events
        moved, before = self._late(events * self.step, state), state.spikes
        state.current = state.current + self.into.drive(moved, self.into())
        graded = self._graded(torch.relu(state.current + self.bias), state.membrane)
        state.membrane = state.membrane + graded
        state.spikes, delivered = graded, before if self.delay else graded
        state.readout = state.readout + self.out.drive(delivered * self.threshold, self.out())
        if self.skip:
            state.readout = state.readout + self.past.drive(moved, self.past())
        return events, graded

    def _graded(self, activation: Tensor, sent: Tensor) -> Tensor:
        """Return the graded spikes (B, H) of activations when so much was sent [thresholds]."""
        apart = activation / self.threshold - sent
        far = apart.abs()
        graded = torch.floor(far + 0.5) * apart.sign()
        return torch.where(far >= 1, graded, torch.zeros_like(graded))

    def unrolled(
        self, seen: Tensor, moved: Tensor, weights: DeltaWeights, burn_in: int, begins: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return means (B, L, act) and messages (B, L, H), 0 or 1, of windows of walks.

        Rounding passes gradients on as they are; those of a message are of |change| / threshold,
        the number of messages that would be sent without a dead zone. Arguments as in
        DeltaSnnPolicy; before a window as much was sent as its first activation is, rounded.
        """
        mean = seen.new_zeros(*seen.shape[:2], self.actions)
        if self.skip:
            mean = self.past.drive(seen, weights.past)
        if not self.hidden:
            return mean + self.action_bias, seen.new_zeros(*seen.shape[:2], 0)
        activation = torch.relu(self.into.drive(seen, weights.into) + weights.bias)
        level, sent = self._sent(activation.detach(), burn_in, begins)
        held = level * self.threshold + (activation - activation.detach())
        if self.delay:  # the readout holds what had been sent a control step before
            first = torch.arange(seen.shape[1]) == burn_in
            rests = (begins[:, None] & first)[:, :, None]
            held = torch.cat([held[:, :1], held[:, :-1]], 1).masked_fill(rests, 0.0)
        change = torch.diff(activation, dim=1, prepend=activation[:, :1]).abs() / self.threshold
        messages = sent + (change - change.detach())
        return mean + self.out.drive(held, weights.out) + self.action_bias, messages

    @torch.no_grad()
    def _sent(self, activation: Tensor, burn_in: int, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return what was sent so far [thresholds], and whether something is, each (B, L, H)."""
        sent = torch.floor(activation[:, 0] / self.threshold + 0.5)
        runs_on = 1 - begins[:, None].to(activation.dtype)
        levels, messages = [], []
        for t in range(activation.shape[1]):
            if t == burn_in:
                sent = sent * runs_on
            graded = self._graded(activation[:, t], sent)
            sent = sent + graded
            levels.append(sent)
            messages.append((graded != 0).to(activation.dtype))
        return torch.stack(levels, 1), torch.stack(messages, 1)

    def latent(self, observation: Tensor) -> Latent:
        """Return the output of the first control step of an episode."""
        mean, _, graded = self.advance(observation, self.rest(len(observation)))
        graded = graded.sum(1)
        return Latent(mean, graded * self.threshold, ((graded != 0).to(mean.dtype).mean(),))


def delta_artifact(
    policy: DeltaSnnPolicy, origin: Provenance | None = None, dt: float = DT
) -> Artifact:
    """Return the policy as an artifact, every number in float64; its states are kept.

        input (M) -> fc1 -> lif1 -> fc2 -> readout -> action -> output (act)
        input (M) ------> skip ----------> readout, or integral -> action
                         lif1 -> deep -> lif2 -> fc3 -> readout

    `lif1` is a CubaLIF whose synaptic current hardly decays, `readout` and `integral` are LI, all
    with gains of 1; `action` adds the constant c to each readout. Channels of the encoder carry
    their own weights, so event k of a one-hot code weighs k times as much. Of a DeltaMlpPolicy the
    neurons are `sd1`, sigma-delta neurons, and the readout is an I; fc2 weighs each graded spike
    with the threshold that it counts. Hidden neurons without synapses on one of their sides are
    left out.
    """
    precise = deepcopy(policy).double()
    convention = Convention(dt=dt, source="as trained", state="kept", clock=policy.clock)
    graph, graded = _graph(precise, dt), {}
    if "sd1" in graph.nodes:
        live = live_layers(precise)["sd1"]
        numbers = _spike_size(precise)[live], precise.bias[live]
        graded["sd1"] = SigmaDelta(*map(to_array, numbers))
    return Artifact(graph, delta_codec(precise), convention, origin, graded)


def delta_codec(policy: DeltaSnnPolicy) -> Codec:
    """Return normaliser, encoder and decoder, as a file holds them."""
    normalizer = policy.normalizer
    return Codec(
        Normaliser(to_array(normalizer.mean), to_array(normalizer.std), normalizer.clip),
        delta_encoder(policy),
        policy.timesteps,
        "argmax" if policy.head == "discrete" else "tanh",
        "last" if policy.timesteps > 1 else "mean",
    )


def delta_encoder(policy: DeltaSnnPolicy) -> DeltaEncoder:
    """Return the encoder; observations that no synapse reads send nothing."""
    step = np.where(_used_observations(policy).numpy(), to_array(policy.step), np.inf)
    return DeltaEncoder(step, policy.most, policy.code, _EVENTS_ABOVE)


def live_neurons(policy: DeltaSnnPolicy) -> Tensor:
    """Return which hidden neurons (H,) have synapses on both sides: others change no action."""
    # a neuron without input may still spike by its bias, as a clock of its own
    active = policy.into.whole_mask.any(1) | (policy.bias.detach() > 0)
    read = policy.out.whole_mask.any(0)
    if policy.deep:
        active |= policy.back.whole_mask.any(1)
        read |= policy.back.whole_mask.any(0)
    return active & read


def live_layers(policy: DeltaSnnPolicy) -> dict[str, Tensor]:
    """Return the indices of live hidden neurons by the node in which they are; no empty ones."""
    live, deep = live_neurons(policy), policy.deep_neurons
    layers = {hidden_node(policy): live & ~deep, DEEP_NODE: live & deep}
    return {name: torch.nonzero(which).ravel() for name, which in layers.items() if which.any()}


def channel_weights(policy: DeltaSnnPolicy, weight: Array) -> Array:
    """Return weights (N, M) of the encoder's channels, from those of the observation (N, obs)."""
    k = np.arange(1, policy.most + 1)
    each = np.tile(k if policy.code == "one-hot" else np.ones_like(k), (policy.observations, 1))
    each[list(policy.two_valued)] = 1 if policy.code == "one-hot" else k == 1
    signed = np.concatenate([each, -each], 1)  # K channels of rising values, then of falling ones
    moved: Array = weight * to_array(policy.step)
    return np.reshape(moved[:, :, None] * signed, (len(weight), -1))


def event_channels(policy: DeltaSnnPolicy, events: Array) -> NDArray[np.uint8]:
    """Return input spikes (S, M) of signed events (S, obs), where some synapse reads them."""
    k = np.arange(1, policy.most + 1)
    sign = np.array([[1], [-1]])
    signed = np.where(_used_observations(policy).numpy(), events, 0)[:, :, None, None] * sign
    spikes = signed == k if policy.code == "one-hot" else signed >= k
    return np.reshape(spikes, (len(events), -1)).astype(np.uint8)


def _used_observations(policy: DeltaSnnPolicy) -> Tensor:
    """Return which observations (obs,) some synapse reads."""
    used = policy.into.whole_mask[live_neurons(policy)].any(0)
    return used | policy.past.whole_mask.any(0) if policy.skip else used


def _graph(policy: DeltaSnnPolicy, dt: float) -> nir.NIRGraph:
    width = 2 * policy.most * policy.observations
    nodes: dict[str, nir.NIRNode] = {"input": nir.Input({"input": np.array([width])})}
    edges: list[tuple[str, str]] = []
    layers, name = live_layers(policy), hidden_node(policy)
    for number, (node, live) in enumerate(layers.items(), 2):
        nodes[node] = _neurons(policy, live, dt)
        out = to_array((policy.out.whole() * _spike_size(policy))[:, live])
        nodes[f"fc{number}"] = nir.Linear(out)
        edges += [(node, f"fc{number}"), (f"fc{number}", "readout")]
    if name in layers:
        nodes["fc1"] = nir.Linear(
            channel_weights(policy, to_array(policy.into.whole()[layers[name]]))
        )
        edges += [("input", "fc1"), ("fc1", name)]
    if DEEP_NODE in layers:
        onto = policy.back.whole()[layers[DEEP_NODE]]
        # neurons that lost all their synapses may still spike by their bias
        source, weight = "input", onto.new_zeros(len(onto), width)
        if name in layers:
            source, weight = name, onto[:, layers[name]]
        nodes["deep"] = nir.Linear(to_array(weight))
        edges += [(source, "deep"), ("deep", DEEP_NODE)]
    integral = np.full(policy.actions, policy.current_decay)
    zeros = policy.step.new_zeros(policy.actions, len(policy.step))
    past = policy.past.whole() if policy.skip else zeros
    if not edges or bool(past.any()):  # the input is read, if only with weights of 0
        nodes["skip"] = nir.Linear(channel_weights(policy, to_array(past)))
        edges.append(("input", "skip"))
        if policy.integrated and layers:
            nodes["integral"] = _readout(policy, integral, dt)
            edges += [("skip", "integral"), ("integral", "action")]
        else:
            edges.append(("skip", "readout"))
    alone = policy.integrated and not layers  # the readout is then the integral
    nodes["readout"] = _readout(policy, integral if alone else to_array(policy.gamma), dt)
    nodes["action"] = nir.Affine(np.eye(policy.actions), to_array(policy.action_bias))
    nodes["output"] = nir.Output({"output": np.array([policy.actions])})
    edges += [("readout", "action"), ("action", "output")]
    return nir.NIRGraph(nodes, edges)


def hidden_node(policy: DeltaSnnPolicy) -> str:
    """Return the name of the hidden neurons' node."""
    return "sd1" if isinstance(policy, DeltaMlpPolicy) else "lif1"


def _spike_size(policy: DeltaSnnPolicy) -> Tensor:
    """Return what a spike of each hidden neuron (H,) stands for."""
    if isinstance(policy, DeltaMlpPolicy):
        return policy.threshold
    return torch.ones_like(policy.bias)


def _neurons(policy: DeltaSnnPolicy, live: Tensor, dt: float) -> nir.CubaLIF | nir.I:
    """Return the hidden neurons; the bias of LIF neurons is their resting membrane."""
    if isinstance(policy, DeltaMlpPolicy):
        return nir.I(np.full(len(live), 1 / dt))
    beta, bias = to_array(policy.beta[live]), to_array(policy.bias[live])
    # tau = dt / (1 - decay) ; gains of 1 ; V = beta V + I + (1 - beta) v_leak
    deep = policy.deep_neurons[live].numpy()
    tau_mem, tau_syn = dt / (1 - beta), dt / (1 - np.where(deep, 0.0, policy.current_decay))
    return nir.CubaLIF(
        tau_syn=tau_syn,
        tau_mem=tau_mem,
        r=tau_mem / dt,
        v_leak=bias / (1 - beta),
        v_reset=np.zeros(beta.size),
        v_threshold=to_array(policy.threshold[live]),
        w_in=tau_syn / dt,
    )


def _readout(policy: DeltaSnnPolicy, decay: Array, dt: float) -> nir.LI | nir.I:
    if isinstance(policy, DeltaMlpPolicy):
        return nir.I(np.full(policy.actions, 1 / dt))
    tau = dt / (1 - decay)
    return nir.LI(tau=tau, r=tau / dt, v_leak=np.zeros(tau.size))
