"""Float policy: a multilayer perceptron, or a linear map."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.features import Features
from spikedeploy.trainers.policies.normaliser import TorchNormaliser
from spikedeploy.trainers.policies.policy import Head, Latent, Policy, full_precision


class MlpPolicy(Policy):
    """A float network with ReLU; without hidden layers, a linear policy.

    hidden: widths of the hidden layers
    features: its inputs; None for all observations
    layers: the nn.Linear of each hidden layer, then that of the mean
    """

    kind = "mlp"

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Sequence[int] = (512, 512),
        features: Features | None = None,
        clip: float = 4.0,
        head: Head = "continuous",
    ) -> None:
        super().__init__()
        self.head = head
        self.observations, self.actions, self.hidden = observations, actions, tuple(hidden)
        self.features = features or Features("all", observations, [], [])
        self.normalizer = TorchNormaliser(self.features.size, clip)
        widths = (self.features.size, *hidden, actions)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(widths))
        self.latent_size = widths[-2]

    def features_of(self, observation: Tensor) -> Tensor:
        """Return the features (B, F) of raw observations."""
        features: Tensor = self.features(observation)
        return features

    def latent(self, observation: Tensor) -> Latent:
        """Return mean and last hidden activations."""
        hidden = self.normalizer(self.features_of(observation))
        for layer in self.layers[:-1]:
            hidden = torch.relu(layer(hidden))
        return Latent(full_precision(self.layers[-1], hidden), hidden)

    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""
        return {
            "kind": self.kind,
            "observations": self.observations,
            "actions": self.actions,
            "hidden": list(self.hidden),
            "features": self.features.spec(),
            "clip": self.normalizer.clip,
            "head": self.head,
        }
