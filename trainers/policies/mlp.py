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
        # (He et al. 2015)
        self.matrices = nn.ModuleList(
            PrunedWeight(torch.randn(n, m) * (2 / m) ** 0.5) for m, n in widths
        )
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
