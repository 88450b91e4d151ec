"""Weights with masks, and a small float network of them: the baseline of spiking policies."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.policy import (
    Head,
    Latent,
    Policy,
    TorchNormaliser,
    full_precision,
)


class PrunedWeight(nn.Module):
    """A weight matrix (N, M) and which of its synapses are left.

    weight: (N, M) trained
    mask: (N, M) 1 where a synapse is left, 0 where it was taken out
    """

    mask: Tensor

    def __init__(self, weight: Tensor) -> None:
        super().__init__()
        self.weight = nn.Parameter(weight)
        self.register_buffer("mask", torch.ones_like(weight))

    def forward(self) -> Tensor:
        """Return the weights (N, M), zero where a synapse was taken out."""
        return self.weight * self.mask

    @property
    def fan_out(self) -> Tensor:
        """Synapses (M,) that are left of each presynaptic neuron."""
        return self.mask.sum(0)


@dataclass(frozen=True)
class SynapseGroup:
    """Synapses of one kind, for penalties and pruning.

    matrix: their weights and masks
    rate: (M,) mean number of operations that one synapse of each presynaptic neuron takes in a
        control step: of a spiking neuron its spikes, of an input that is always read 1
    """

    matrix: PrunedWeight
    rate: Tensor

    @property
    def operations(self) -> Tensor:
        """Mean number of operations in a control step, a scalar."""
        # sum_j rate_j fan-out_j
        return (self.rate * self.matrix.fan_out).sum()


class PrunedMlpPolicy(Policy):
    """A float network with ReLU, a linear path past it, and masks on all weights.

    hidden: widths of the hidden layers; none make it a linear policy
    skip: whether the observation also reaches the output directly
    layers, biases: weights of each hidden layer, then of the output; and their biases
    past: weights of the skip connection
    """

    kind = "pruned-mlp"

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Sequence[int] = (16,),
        skip: bool = True,
        clip: float = 4.0,
        head: Head = "continuous",
    ) -> None:
        super().__init__()
        self.observations, self.actions, self.hidden = observations, actions, tuple(hidden)
        self.skip, self.head = skip and bool(hidden), head
        self.normalizer = TorchNormaliser(observations, clip)
        widths = list(pairwise((observations, *hidden, actions)))
        self.matrices = nn.ModuleList(_matrix(*pair) for pair in widths)
        self.biases = nn.ParameterList(torch.zeros(n) for _, n in widths)
        self.past = PrunedWeight(torch.zeros(actions, observations if self.skip else 0))
        self.latent_size = widths[-1][0]

    @property
    def layers(self) -> list[PrunedWeight]:
        """Weights of each hidden layer, then of the output."""
        return [matrix for matrix in self.matrices if isinstance(matrix, PrunedWeight)]

    def activations(self, observation: Tensor) -> tuple[Tensor, list[Tensor]]:
        """Return mean (B, act), and the inputs (B, M) of every matrix."""
        seen = self.normalizer(observation)
        inputs = [seen]
        *hidden, last = zip(self.layers, self.biases, strict=True)
        for matrix, bias in hidden:
            inputs.append(torch.relu(inputs[-1] @ matrix().T + bias))
        mean = inputs[-1] @ last[0]().T + last[1]
        if self.skip:
            mean = mean + seen @ self.past().T
        return mean, inputs

    def latent(self, observation: Tensor) -> Latent:
        """Return mean and last hidden activations."""
        mean, inputs = self.activations(observation)
        return Latent(full_precision(nn.Identity(), mean), inputs[-1])


def _matrix(inputs: int, outputs: int) -> PrunedWeight:
    # (He et al. 2015)
    return PrunedWeight(torch.randn(outputs, inputs) * (2 / inputs) ** 0.5)
