"""Event-driven spiking policy: delta code, one layer of LIF neurons, leaky integrator readout.

    n     signed events of the observation              (runtime.codec.delta)
    I     = a I + W (step n)                            a just below 1: I is W times the observation
    V     = beta V + I + b ;  s = V > 1 ;  V = (1 - s) V
    y     = gamma y + Wo s + Ws (step n)                the events also reach the readout directly
    action = tanh(y + c)

An integrated skip has readouts of its own, which hardly decay, so that they hold what the
observation is and not only how it moved lately:

    y     = gamma y + Wo s ;  z = a z + Ws (step n) ;  action = tanh(y + z + c)

One timestep per control step; currents, membranes and readouts live on from one to the next.

The equations are those of a gated clock. Pipelined, as on a chip whose cores all advance in each
timestep, everything takes one timestep to arrive: events reach currents and readouts one control
step late, and hidden spikes the readout one later still (runtime.convention.Clock):

    I[t] = a I[t-1] + W (step n[t-1]) ;  y[t] = gamma y[t-1] + Wo s[t-1] + Ws (step n[t-1])
"""

from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.neurons import surrogate
from spikedeploy.trainers.policies.normaliser import TorchNormaliser
from spikedeploy.trainers.policies.policy import Head, Latent, Policy
from spikedeploy.trainers.policies.pruned import PrunedWeight

# Loihi's slowest decay: what lava and nengo-loihi make of a decay register of 0
CURRENT_DECAY = 4095 / 4096
_THRESHOLD = 1.0
_BETA, _GAMMA = 0.6, 0.5  # initial decay factors of membranes and readouts


@dataclass
class DeltaState:
    """State of a batch of robots between two control steps.

    level: (B, obs) events sent so far, with their signs
    current: (B, H) of the hidden neurons
    membrane: (B, H)
    readout: (B, act)
    integral: (B, act) of an integrated skip
    moved: (B, obs) step times events that arrive in the next control step, where pipelined
    spikes: (B, H) likewise of the hidden neurons
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

    hidden: neurons H of the layer; 0 leaves the readout alone: a delta-coded linear policy, whose
        readout decays as slowly as the currents do
    skip: whether events also reach the readout directly
    integrated: whether they do so through readouts that hardly decay
    most, code, events_above: of the encoder, see runtime.codec.delta.DeltaEncoder
    clock: "pipelined", or "gated" for software and hardware that can update layer after layer
    step: (obs,) distance that one event stands for [normalised observation]
    threshold: (H,) membrane above which a neuron spikes: 1, or the chip's nearest to it
    into, out, past: synapses onto the hidden neurons, from them, and past them
    """

    kind = "delta-snn"
    timesteps = 1
    step: Tensor
    threshold: Tensor

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: int = 8,
        skip: bool = True,
        most: int = 3,
        code: Literal["unary", "one-hot"] = "one-hot",
        events_above: int = 154,
        step: float = 0.5,
        current_decay: float = CURRENT_DECAY,
        surrogate_width: float = 2.0,
        clip: float = 4.0,
        head: Head = "continuous",
        integrated: bool = False,
        clock: Literal["gated", "pipelined"] = "pipelined",
    ) -> None:
        super().__init__()
        self.clock = clock
        self.observations, self.actions, self.hidden = observations, actions, hidden
        self.integrated = integrated and skip and hidden > 0
        self.skip, self.most, self.code = skip or not hidden, most, code
        self.events_above, self.head = events_above, head
        self.current_decay, self.surrogate_width = current_decay, surrogate_width
        self.latent_size = hidden
        self.normalizer = TorchNormaliser(observations, clip)
        self.register_buffer("step", torch.full((observations,), step))
        self.register_buffer("threshold", torch.full((hidden,), _THRESHOLD))
        spread = 0.6 * (2 / observations) ** 0.5
        self.into = PrunedWeight(torch.randn(hidden, observations) * spread)
        self.bias = nn.Parameter(torch.full((hidden,), 0.2))
        self.out = PrunedWeight(torch.randn(actions, hidden) * 0.75 / max(hidden, 1) ** 0.5)
        past = torch.zeros(actions, observations if self.skip else 0)
        self.past = PrunedWeight(past)
        self.action_bias = nn.Parameter(torch.zeros(actions))
        self._beta = nn.Parameter(torch.full((hidden,), _logit(_BETA)))
        self._gamma = nn.Parameter(torch.full((actions,), _logit(_GAMMA)))
        self._gradient = surrogate("atan", surrogate_width)

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
        return torch.where(far > self.events_above, events, torch.zeros_like(events))

    @property
    def delay(self) -> int:
        """Control steps from an event, or a hidden spike, to where it acts."""
        return int(self.clock == "pipelined")

    def rest(self, robots: int) -> DeltaState:
        """Return the state at the beginning of an episode."""
        zeros = self.action_bias.new_zeros
        seen, hidden = zeros(robots, self.observations), zeros(robots, self.hidden)
        actions = zeros(robots, self.actions)
        return DeltaState(seen, hidden, hidden, actions, actions, seen, hidden)

    def advance(self, observation: Tensor, state: DeltaState) -> tuple[Tensor, Tensor, Tensor]:
        """Take one control step: return mean (B, act), events (B, obs) and hidden spikes (B, H).

        `state` is moved on.
        """
        events = self.events(observation, state.level)
        state.level = state.level + events
        moved = self._arriving(events * self.step, state)
        state.current = self.current_decay * state.current + moved @ self.into().T
        membrane = self.beta * state.membrane + state.current + self.bias
        spikes = (membrane > self.threshold).to(membrane.dtype)
        state.membrane = membrane * (1 - spikes)
        drive: Tensor = self._delivered(spikes, state) @ self.out().T
        past = moved @ self.past().T if self.skip else 0.0
        if self.integrated:
            state.integral = self.current_decay * state.integral + past
        else:
            drive = drive + past
        state.readout = self.gamma * state.readout + drive
        return state.readout + state.integral + self.action_bias, events, spikes

    def _arriving(self, moved: Tensor, state: DeltaState) -> Tensor:
        """Return what arrives (B, obs) in a control step that sends `moved`."""
        if not self.delay:
            return moved
        arriving, state.moved = state.moved, moved
        return arriving

    def _delivered(self, spikes: Tensor, state: DeltaState) -> Tensor:
        """Return the spikes (B, H) that reach the readout when these are emitted."""
        if not self.delay:
            return spikes
        delivered, state.spikes = state.spikes, spikes
        return delivered

    def unrolled(
        self, seen: Tensor, moved: Tensor, weights: "DeltaWeights", burn_in: int, begins: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return means (B, L, act) and spikes (B, L, H) of windows of walks, from rest.

        seen: (B, L, obs) what the currents hold of the observation: the decayed sum of `moved`
        moved: (B, L, obs) step times the events that arrive, `delay` after they were sent
        weights: as `weights` returned them
        burn_in: control steps without gradient at the beginning, which bring the states up
        begins: (B,) whether an episode begins behind the burn-in: then states are at rest there
        """
        if not self.hidden:  # the readouts hold what currents would hold
            mean = seen @ weights.past.T + self.action_bias
            return mean, mean.new_zeros(*mean.shape[:2], 0)
        hidden, actions = (seen.new_zeros(len(seen), n) for n in (self.hidden, self.actions))
        states: tuple[Tensor, ...] = hidden, actions, hidden
        before: list[Tensor] = []
        if burn_in:  # a window without gradient brings the states up
            runs_on = 1 - begins[:, None].to(seen.dtype)
            with torch.no_grad():
                first = seen[:, :burn_in], moved[:, :burn_in]
                states, *before = self._window(*first, weights, states)
                states = tuple(state * runs_on for state in states)
        _, *after = self._window(seen[:, burn_in:], moved[:, burn_in:], weights, states)
        parts = zip(before, after, strict=True) if burn_in else ([each] for each in after)
        mean, spikes = (torch.cat(list(part), 1) for part in parts)
        # the integrals hold what currents would hold
        return mean + seen @ weights.past.T if self.integrated else mean, spikes

    def _window(
        self, seen: Tensor, moved: Tensor, weights: "DeltaWeights", states: tuple[Tensor, ...]
    ) -> tuple[tuple[Tensor, ...], Tensor, Tensor]:
        """Return states behind a window, and its means (B, L, act) and spikes (B, L, H).

        states: membranes (B, H), readouts (B, act) and spikes (B, H) of the control step before
        """
        membrane, readout, emitted = states
        raster = [emitted]
        for drive in (seen @ weights.into.T + weights.bias).unbind(1):
            membrane = weights.beta * membrane + drive
            spikes = _Spike.apply(membrane - weights.threshold, self._gradient)  # type: ignore[no-untyped-call]
            # no gradient through the reset
            membrane = membrane * (1 - spikes.detach())
            raster.append(spikes)
        emitted, *spiked = raster
        arriving = torch.stack(raster[:-1] if self.delay else spiked, 1)
        onto = arriving @ weights.out.T
        if self.skip and not self.integrated:
            onto = onto + moved @ weights.past.T
        means = []
        for drive in onto.unbind(1):
            readout = weights.gamma * readout + drive
            means.append(readout + self.action_bias)
        after = membrane, readout, raster[-1]
        return after, torch.stack(means, 1), torch.stack(spiked, 1)

    def weights(self) -> "DeltaWeights":
        """Return what `unrolled` computes with, masks and decay factors applied."""
        matrices = self.into(), self.out(), self.past()
        return DeltaWeights(*matrices, self.beta, self.gamma, self.bias, self.threshold)

    def latent(self, observation: Tensor) -> Latent:
        """Return the output of the first control step of an episode."""
        mean, _, spikes = self.advance(observation, self.rest(len(observation)))
        return Latent(mean, spikes, (spikes.mean(),))

    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""
        return {
            "kind": self.kind,
            "observations": self.observations,
            "actions": self.actions,
            "hidden": self.hidden,
            "skip": self.skip,
            "integrated": self.integrated,
            "most": self.most,
            "code": self.code,
            "events_above": self.events_above,
            "current_decay": self.current_decay,
            "surrogate_width": self.surrogate_width,
            "clip": self.normalizer.clip,
            "head": self.head,
            "clock": self.clock,
        }


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


class _Spike(torch.autograd.Function):
    """1 above 0, with a surrogate derivative."""

    @staticmethod
    def forward(ctx: Any, excess: Tensor, gradient: Any) -> Tensor:  # noqa: ANN401
        ctx.save_for_backward(excess)
        ctx.gradient = gradient
        return (excess > 0).to(excess.dtype)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:  # noqa: ANN401
        (excess,) = ctx.saved_tensors
        return upstream * ctx.gradient(excess), None


def _logit(share: float) -> float:
    return float(torch.logit(torch.tensor(share)))
