"""Float policies: a multilayer perceptron or linear map, and a pruned one."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.policy import (
    Head,
    Latent,
    Policy,
    PrunedWeight,
    TorchNormaliser,
    full_precision,
)
from spikedeploy.trainers.policies.shared_weights import Copies, he_normal, weights_between


class MlpPolicy(Policy):
    """A float network with ReLU; without hidden layers, a linear policy.

    hidden: widths of the hidden layers
    layers: the nn.Linear of each hidden layer, then that of the mean
    """

    kind = "mlp"

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Sequence[int] = (512, 512),
        clip: float = 4.0,
        head: Head = "continuous",
    ) -> None:
        super().__init__()
        self.head = head
        self.observations, self.actions, self.hidden = observations, actions, tuple(hidden)
        self.normalizer = TorchNormaliser(observations, clip)
        widths = (observations, *hidden, actions)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(widths))
        self.latent_size = widths[-2]

    def latent(self, observation: Tensor) -> Latent:
        """Return mean and last hidden activations."""
        hidden = self.normalizer(observation)
        for layer in self.layers[:-1]:
            hidden = torch.relu(layer(hidden))
        return Latent(full_precision(self.layers[-1], hidden), hidden)


class PrunedMlpPolicy(Policy):
    """A float network with ReLU, a linear path past it, and masks on all weights.

    hidden: widths of the hidden layers, of all copies together; none make it a linear policy
    skip: whether the observation also reaches the output directly
    copies: copies of a network that serves several parts of a body; None for one network
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
        copies: Copies | None = None,
    ) -> None:
        super().__init__()
        self.observations, self.actions, self.hidden = observations, actions, tuple(hidden)
        self.skip, self.head, self.copies = skip and bool(hidden), head, copies
        self.normalizer = TorchNormaliser(observations, clip)
        widths = list(pairwise((observations, *hidden, actions)))
        last = len(widths) - 1
        self.matrices = nn.ModuleList(
            weights_between(copies, pair, he_normal, reads=k == 0, acts=k == last)
            for k, pair in enumerate(widths)
        )
        self.biases = nn.ParameterList(torch.zeros(n) for _, n in widths)
        read = observations if self.skip else 0
        self.past = weights_between(copies, (read, actions), torch.zeros, reads=True, acts=True)
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
            inputs.append(torch.relu(matrix.drive(inputs[-1], matrix()) + bias))
        mean = last[0].drive(inputs[-1], last[0]()) + last[1]
        if self.skip:
            mean = mean + self.past.drive(seen, self.past())
        return mean, inputs

    def latent(self, observation: Tensor) -> Latent:
        """Return mean and last hidden activations."""
        mean, inputs = self.activations(observation)
        return Latent(full_precision(nn.Identity(), mean), inputs[-1])
