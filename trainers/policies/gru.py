"""A pruned float policy with a memory: ReLU layers into a GRU, and a linear path past both.

    h = relu(W x + b) ... ;  m = GRU(h, m) ;  action = tanh(Wo m + Ws x + c)

What copies for parts of a body share are the weights of all groups, and the biases of the GRU.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.copies import Copies, he_normal, weights_between
from spikedeploy.trainers.policies.policy import (
    Head,
    Latent,
    Policy,
    PrunedWeight,
    TorchNormaliser,
)


@dataclass(frozen=True)
class Remembered:
    """Outputs of windows of L control steps.

    mean: (B, L, act)
    inputs: (B, L, M) of each group of weights, in the order of `PrunedGruPolicy.groups`
    memory: (B, H) behind the window
    """

    mean: Tensor
    inputs: list[Tensor]
    memory: Tensor


class PrunedGruPolicy(Policy):
    """A float network with a memory, and masks on all weights.

    hidden: widths of the ReLU layers, one at least, of all copies together
    gru: units H of the memory, of all copies together
    skip, copies: as in PrunedMlpPolicy
    layers: weights of the ReLU layers
    gates, back: onto reset, update and new of the memory, from the last layer and from the memory
    out, past: onto the actions, from the memory and from the observation
    """

    kind = "pruned-gru"

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Sequence[int] = (64,),
        gru: int = 64,
        skip: bool = True,
        clip: float = 4.0,
        head: Head = "continuous",
        copies: Copies | None = None,
    ) -> None:
        super().__init__()
        self.observations, self.actions, self.hidden = observations, actions, tuple(hidden)
        self.gru, self.skip, self.head, self.copies = gru, skip, head, copies
        self.latent_size = gru
        self.normalizer = TorchNormaliser(observations, clip)
        widths = list(pairwise((observations, *hidden)))
        self.layers = nn.ModuleList(
            weights_between(copies, pair, he_normal, reads=k == 0) for k, pair in enumerate(widths)
        )
        self.gates = weights_between(copies, (widths[-1][1], 3 * gru), _scaled)
        self.back = weights_between(copies, (gru, 3 * gru), _scaled)
        self.out = weights_between(copies, (gru, actions), _scaled, acts=True)
        read = observations if skip else 0
        self.past = weights_between(copies, (read, actions), torch.zeros, reads=True, acts=True)
        self.biases = nn.ParameterList(torch.zeros(width) for _, width in widths)
        self.gate_bias = nn.Parameter(torch.zeros(len(self.gates.weight)))
        self.back_bias = nn.Parameter(torch.zeros(len(self.back.weight)))
        self.action_bias = nn.Parameter(torch.zeros(actions))

    @property
    def groups(self) -> list[PrunedWeight]:
        """All weights, in the order in which they are computed; past the memory last."""
        layers = [layer for layer in self.layers if isinstance(layer, PrunedWeight)]
        every = [*layers, self.gates, self.back, self.out]
        return [*every, self.past] if self.skip else every

    def rest(self, robots: int) -> list[Tensor]:
        """Return the memory (B, H) at the beginning of an episode."""
        return [self.action_bias.new_zeros(robots, self.gru)]

    def unrolled(self, observation: Tensor, memory: Tensor) -> Remembered:
        """Return what windows of observations (B, L, obs) give, from a memory (B, H) on."""
        seen = self.normalizer(observation)
        hidden, inputs = seen, [seen]
        for layer, bias in zip(self.groups, self.biases, strict=False):
            hidden = torch.relu(layer.drive(hidden, layer()) + bias)
            inputs.append(hidden)
        rows, behind = self._remember(hidden, memory)
        before = torch.cat([memory[:, None], rows[:, :-1]], 1)
        inputs += [before, rows]
        mean = self.out.drive(rows, self.out()) + self.action_bias
        if self.skip:
            mean = mean + self.past.drive(seen, self.past())
            inputs.append(seen)
        return Remembered(mean, inputs, behind)

    def _remember(self, hidden: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return the memory (B, L, H) in each control step, and behind the last (B, H)."""
        batch, length = hidden.shape[:2]
        count = self.copies.count if self.copies else 1
        # a row of each copy: (B K, L, n)
        each = hidden.view(batch, length, count, -1).transpose(1, 2).flatten(0, 1)
        parameters = [self.gates(), self.back(), self.gate_bias, self.back_bias]
        rows, last = torch.gru(  # batch first, one layer, one direction
            each, memory.reshape(1, batch * count, -1), parameters,
            True, 1, 0.0, False, False, True,
        )  # fmt: skip
        rows = rows.view(batch, count, length, -1).transpose(1, 2)
        return rows.reshape(batch, length, -1), last.reshape(batch, -1)

    def advance(self, observation: Tensor, state: list[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """Take one control step: return mean (B, act), and inputs (B, M) of each group.

        `state` is moved on.
        """
        done = self.unrolled(observation[:, None], state[0])
        state[0] = done.memory
        return done.mean[:, 0], [each[:, 0] for each in done.inputs]

    def latent(self, observation: Tensor) -> Latent:
        """Return the output of the first control step of an episode."""
        state = self.rest(len(observation))
        mean, _ = self.advance(observation, state)
        return Latent(mean, state[0])


def _scaled(n: int, m: int) -> Tensor:
    """Return initial weights (n, m) that keep the size of what they read."""
    weight: Tensor = torch.randn(n, m) * m**-0.5
    return weight
