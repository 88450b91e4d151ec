"""Delta network: delta code, a layer of sigma-delta ReLU neurons, integrating readout.

    n     signed events of the observation              (runtime.codec.delta)
    sigma = sigma + W (step n)                          W times the levels of the code
    a     = max(sigma + b, 0)
    e     = a / threshold - q ;  k = sign(e) floor(|e| + 1/2) where |e| >= 1 ;  q = q + k
    y     = y + Wo (threshold k) + Ws (step n)          an MLP of rounded numbers
    action = tanh(y + c)

One timestep per control step. What is sent are changes alone, so that numbers which stay cost
nothing (O'Connor and Welling 2017; runtime.graph.neurons). It is a baseline for the spiking
policies: the same code, and a float network's activations.
"""

from typing import Any, Literal

import torch
from torch import Tensor

from spikedeploy.trainers.policies.delta_snn import DeltaSnnPolicy, DeltaState, DeltaWeights
from spikedeploy.trainers.policies.policy import Head, Latent


class DeltaMlpPolicy(DeltaSnnPolicy):
    """Signed events into a layer of sigma-delta neurons and, past it, into the readout.

    In its DeltaState `current` is sigma, and `membrane` q. Nothing decays.

    hidden, skip, most, code, events_above: as in DeltaSnnPolicy
    share: thresholds are to be so many standard deviations of their neuron's activation
    threshold: (H,) distance that a graded spike of 1 stands for
    """

    kind = "delta-mlp"

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: int = 16,
        skip: bool = True,
        most: int = 3,
        code: Literal["unary", "one-hot"] = "one-hot",
        events_above: int = 154,
        threshold: float = 0.5,
        clip: float = 4.0,
        head: Head = "continuous",
        clock: Literal["gated", "pipelined"] = "pipelined",
    ) -> None:
        super().__init__(
            observations, actions, hidden, skip, most, code, events_above,
            current_decay=1.0, clip=clip, head=head, clock=clock,
        )  # fmt: skip
        del self._beta, self._gamma
        self.share = threshold
        self.threshold.fill_(threshold)

    @property
    def beta(self) -> Tensor:
        """Decay factor of each sigma (H,): 1."""
        return torch.ones_like(self.bias)

    @property
    def gamma(self) -> Tensor:
        """Decay factor of each readout (act,): 1."""
        return torch.ones_like(self.action_bias)

    def advance(self, observation: Tensor, state: DeltaState) -> tuple[Tensor, Tensor, Tensor]:
        """Take one control step: return mean (B, act), events (B, obs) and graded spikes (B, H).

        `state` is moved on.
        """
        events = self.events(observation, state.level)
        state.level = state.level + events
        moved = self._arriving(events * self.step, state)
        state.current = state.current + moved @ self.into().T
        graded = self._graded(torch.relu(state.current + self.bias), state.membrane)
        state.membrane = state.membrane + graded
        delivered = self._delivered(graded, state)
        state.readout = state.readout + (delivered * self.threshold) @ self.out().T
        if self.skip:
            state.readout = state.readout + moved @ self.past().T
        return state.readout + self.action_bias, events, graded

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
        mean = seen @ weights.past.T if self.skip else seen.new_zeros(*seen.shape[:2], self.actions)
        if not self.hidden:
            return mean + self.action_bias, seen.new_zeros(*seen.shape[:2], 0)
        activation = torch.relu(seen @ weights.into.T + weights.bias)
        level, sent = self._sent(activation.detach(), burn_in, begins)
        held = level * self.threshold + (activation - activation.detach())
        if self.delay:  # the readout holds what had been sent a control step before
            first = torch.arange(seen.shape[1]) == burn_in
            rests = (begins[:, None] & first)[:, :, None]
            held = torch.cat([held[:, :1], held[:, :-1]], 1).masked_fill(rests, 0.0)
        change = torch.diff(activation, dim=1, prepend=activation[:, :1]).abs() / self.threshold
        messages = sent + (change - change.detach())
        return mean + held @ weights.out.T + self.action_bias, messages

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
        return Latent(mean, graded * self.threshold, ((graded != 0).to(mean.dtype).mean(),))

    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""
        settings = super().spec()
        del settings["current_decay"], settings["surrogate_width"], settings["integrated"]
        return {**settings, "threshold": self.share}
