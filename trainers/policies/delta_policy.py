"""Event-driven policies: delta code, a layer of LIF neurons, leaky readout; and their NIR graphs.

    n     signed events of the observation              (runtime.codec.delta)
    I     = a I + W (step n)                            a just below 1: W times the observation
    V     = beta V + I + b ;  s = V > 1 ;  V = (1 - s) V
    y     = gamma y + Wo s + Ws (step n)                the events also reach the readout directly
    action = tanh(y + c)

An integrated skip has readouts of its own, which hardly decay, so that they hold what the
observation is and not only how it moved lately:

    y     = gamma y + Wo s ;  z = a z + Ws (step n) ;  action = tanh(y + z + c)

Currents, membranes and readouts live on from one control step to the next. A control step has T
timesteps; in each the encoder sends what is still missing, up to its most events, and the action is
that of the last.

The equations are those of a gated clock. Pipelined, as on a chip whose cores all advance in each
timestep, everything takes one timestep to arrive: events reach currents and readouts one timestep
late, and hidden spikes the readout one later still (runtime.convention.Clock):

    I[t] = a I[t-1] + W (step n[t-1]) ;  y[t] = gamma y[t-1] + Wo s[t-1] + Ws (step n[t-1])

With T = 1 an action is that of what was seen one to two control steps before; from T = 3 on, of
what is seen now.
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

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.codec.codec import Codec, Normaliser
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import DeltaSnnConfig
from spikedeploy.trainers.policies.policy import (
    Head,
    Latent,
    Policy,
    PrunedWeight,
    TorchNormaliser,
)
from spikedeploy.trainers.surrogate_neurons import spike, surrogate
from spikedeploy.trainers.torch_network import to_array

Array = NDArray[np.float64]

# Loihi's slowest decay: what lava and nengo-loihi make of a decay register of 0
CURRENT_DECAY = 4095 / 4096
_THRESHOLD = 1.0
_EVENTS_ABOVE = 154  # [1/256 steps], as runtime.codec.delta.DeltaEncoder has it
_STEP = 0.5  # [standard deviations] until steps are chosen
_BETA, _GAMMA = 0.6, 0.5  # initial decay factors of membranes and readouts
HIDDEN_NODE = "lif1"
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

    settings: layers, code and clock
    two_valued: observations with two values that are a step apart: their channels of several events
        are never used; of a one-hot code they weigh as much as that of one, so that they do not
        make a chip's weights coarser, of a unary code nothing
    current_decay: factor by which currents, and the integrals of a skip, keep what events brought
    hidden: neurons H; 0 leaves the readout alone: a delta-coded linear policy, whose readout decays
        as slowly as the currents do
    step: (obs,) distance that one event stands for [normalised observation]
    threshold: (H,) membrane above which a neuron spikes: 1, or the chip's nearest to it
    into, out, past: synapses onto the hidden neurons, from them, and past them
    """

    kind = "delta-snn"
    current_decay = CURRENT_DECAY
    step: Tensor
    threshold: Tensor

    def __init__(
        self,
        observations: int,
        actions: int,
        settings: DeltaSnnConfig | None = None,
        clip: float = 4.0,
        head: Head = "continuous",
        two_valued: Sequence[int] = (),
    ) -> None:
        super().__init__()
        c = settings or DeltaSnnConfig()
        self.settings, self.two_valued = c, tuple(two_valued)
        self.clock, self.timesteps, self.most, self.code = c.clock, c.timesteps, c.most, c.code
        self.observations, self.actions, self.hidden = observations, actions, c.hidden
        self.skip = c.skip or not c.hidden
        self.integrated = c.integrated and c.skip and c.hidden > 0
        self.head, self.latent_size = head, c.hidden
        self.normalizer = TorchNormaliser(observations, clip)
        self.register_buffer("step", torch.full((observations,), _STEP))
        self.register_buffer("threshold", torch.full((c.hidden,), _THRESHOLD))
        self.into = PrunedWeight(
            torch.randn(c.hidden, observations) * (0.6 * (2 / observations) ** 0.5)
        )
        self.bias = nn.Parameter(torch.full((c.hidden,), 0.2))
        self.out = PrunedWeight(torch.randn(actions, c.hidden) * 0.75 / max(c.hidden, 1) ** 0.5)
        self.past = PrunedWeight(torch.zeros(actions, observations if self.skip else 0))
        self.action_bias = nn.Parameter(torch.zeros(actions))
        self._beta = nn.Parameter(torch.full((c.hidden,), _BETA).logit())
        self._gamma = nn.Parameter(torch.full((actions,), _GAMMA).logit())
        self._gradient = surrogate("atan", c.surrogate_width)

    @property
    def groups(self) -> dict[str, PrunedWeight]:
        """All synapses, by the name of their field in DeltaWeights."""
        return {"into": self.into, "out": self.out, "past": self.past}

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

    def initial_states(self, robots: int) -> DeltaState:
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
        state.current = self.current_decay * state.current + moved @ self.into().T
        membrane = self.beta * state.membrane + state.current + self.bias
        spikes = (membrane > self.threshold).to(membrane.dtype)
        state.membrane = membrane * (1 - spikes)
        before, state.spikes = state.spikes, spikes
        drive = (before if self.delay else spikes) @ self.out().T
        past = moved @ self.past().T if self.skip else 0.0
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
            mean = self._last(seen) @ weights.past.T + self.action_bias
            return mean, mean.new_zeros(*mean.shape[:2], 0)
        hidden, actions = (seen.new_zeros(len(seen), n) for n in (self.hidden, self.actions))
        runs_on = 1 - begins[:, None].to(seen.dtype)
        with torch.no_grad():  # a window without gradient brings the states up
            first = seen[:, :burn_in], moved[:, :burn_in]
            states, *before = self._window(*first, weights, (hidden, actions, hidden))
            states = tuple(state * runs_on for state in states)
        _, *after = self._window(seen[:, burn_in:], moved[:, burn_in:], weights, states)
        mean, spikes = (torch.cat(parts, 1) for parts in zip(before, after, strict=True))
        if self.integrated:  # the integrals hold what currents would hold
            mean = mean + seen @ weights.past.T
        steps = spikes.reshape(len(spikes), -1, self.timesteps, self.hidden)
        return self._last(mean), steps.sum(2)

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
        for drive in (seen @ weights.into.T + weights.bias).unbind(1):
            membrane = weights.beta * membrane + drive
            spikes = spike(membrane - weights.threshold, self._gradient)
            # no gradient through the reset
            membrane = membrane * (1 - spikes.detach())
            raster.append(spikes)
        spiked = torch.stack(raster, 1)
        onto = (spiked[:, :-1] if self.delay else spiked[:, 1:]) @ weights.out.T
        if self.skip and not self.integrated:
            onto = onto + moved @ weights.past.T
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
        mean, _, spikes = self.advance(observation, self.initial_states(len(observation)))
        return Latent(mean, spikes.sum(1), (spikes.mean(),))

    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""
        return super().spec() | {"settings": self.settings.model_dump()}


@dataclass(frozen=True)
class DeltaWeights:
    """Weights, decay factors, biases and thresholds of a DeltaSnnPolicy, masks applied.

    into: (H, obs)
    out: (act, H)
    past: (act, obs)
    beta: (H,)
    gamma: (act,)
    bias: (H,)
    threshold: (H,)
    """

    into: Tensor
    out: Tensor
    past: Tensor
    beta: Tensor
    gamma: Tensor
    bias: Tensor
    threshold: Tensor


def delta_artifact(
    policy: DeltaSnnPolicy, origin: Provenance | None = None, dt: float = DT
) -> Artifact:
    """Return the policy as an artifact, every number in float64; its states are kept.

        input (M) -> fc1 -> lif1 -> fc2 -> readout -> action -> output (act)
        input (M) ------> skip ----------> readout, or integral -> action

    `lif1` is a CubaLIF whose synaptic current hardly decays, `readout` and `integral` are LI, all
    with gains of 1; `action` adds the constant c to each readout. Channels of the encoder carry
    their own weights, so event k of a one-hot code weighs k times as much. Hidden neurons without
    synapses on one of their sides are left out.
    """
    precise = deepcopy(policy).double()
    convention = Convention(dt=dt, source="as trained", state="kept", clock=policy.clock)
    return Artifact(_graph(precise, dt), delta_codec(precise), convention, origin)


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
    active = policy.into.mask.any(1) | (policy.bias.detach() > 0)
    return active & policy.out.mask.any(0)


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
    used = policy.into.mask[live_neurons(policy)].any(0)
    return used | policy.past.mask.any(0) if policy.skip else used


def _graph(policy: DeltaSnnPolicy, dt: float) -> nir.NIRGraph:
    width = 2 * policy.most * policy.observations
    nodes: dict[str, nir.NIRNode] = {"input": nir.Input({"input": np.array([width])})}
    edges: list[tuple[str, str]] = []
    live = live_neurons(policy)
    has_hidden = bool(live.any())
    if has_hidden:
        nodes[HIDDEN_NODE] = _neurons(policy, live, dt)
        nodes["fc2"] = nir.Linear(to_array(policy.out()[:, live]))
        nodes["fc1"] = nir.Linear(channel_weights(policy, to_array(policy.into()[live])))
        edges += [(HIDDEN_NODE, "fc2"), ("fc2", "readout")]
        edges += [("input", "fc1"), ("fc1", HIDDEN_NODE)]
    integral = np.full(policy.actions, policy.current_decay)
    zeros = policy.step.new_zeros(policy.actions, len(policy.step))
    past = policy.past() if policy.skip else zeros
    if not edges or bool(past.any()):  # the input is read, if only with weights of 0
        nodes["skip"] = nir.Linear(channel_weights(policy, to_array(past)))
        edges.append(("input", "skip"))
        if policy.integrated and has_hidden:
            nodes["integral"] = _readout(integral, dt)
            edges += [("skip", "integral"), ("integral", "action")]
        else:
            edges.append(("skip", "readout"))
    alone = policy.integrated and not has_hidden  # the readout is then the integral
    nodes["readout"] = _readout(integral if alone else to_array(policy.gamma), dt)
    nodes["action"] = nir.Affine(np.eye(policy.actions), to_array(policy.action_bias))
    nodes["output"] = nir.Output({"output": np.array([policy.actions])})
    edges += [("readout", "action"), ("action", "output")]
    return nir.NIRGraph(nodes, edges)


def _neurons(policy: DeltaSnnPolicy, live: Tensor, dt: float) -> nir.CubaLIF:
    """Return the hidden neurons that are live, whose bias is their resting membrane."""
    beta, bias = to_array(policy.beta[live]), to_array(policy.bias[live])
    # tau = dt / (1 - decay) ; gains of 1 ; V = beta V + I + (1 - beta) v_leak
    tau_mem, tau_syn = dt / (1 - beta), np.full(beta.shape, dt / (1 - policy.current_decay))
    return nir.CubaLIF(
        tau_syn=tau_syn,
        tau_mem=tau_mem,
        r=tau_mem / dt,
        v_leak=bias / (1 - beta),
        v_reset=np.zeros(beta.size),
        v_threshold=to_array(policy.threshold[live]),
        w_in=tau_syn / dt,
    )


def _readout(decay: Array, dt: float) -> nir.LI:
    tau = dt / (1 - decay)
    return nir.LI(tau=tau, r=tau / dt, v_leak=np.zeros(tau.size))
