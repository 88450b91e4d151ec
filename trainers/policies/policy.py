"""Policy: the deployable part of what is trained, from observation to action."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.normaliser import TorchNormaliser

Head = Literal["continuous", "discrete"]


@dataclass(frozen=True)
class Latent:
    """Output of a policy before an action is chosen.

    mean: (B, act) action before tanh, or the logit of each action
    hidden: (B, H) last activations, the input of an algorithm's own heads
    rates: mean firing rate of each spiking layer, none in a float network [spikes / timestep]
    """

    mean: Tensor
    hidden: Tensor
    rates: tuple[Tensor, ...] = ()


class Policy(nn.Module):
    """Maps observations (B, obs) to deterministic actions.

    observations, actions: their numbers
    head: "continuous", actions (B, act) in [-1, 1], or "discrete", the index (B,) of an action
    normalizer: shift, scale and clip of the observations, part of the policy
    latent_size: width H of `Latent.hidden`
    """

    kind: str
    observations: int
    actions: int
    latent_size: int
    normalizer: TorchNormaliser  # the name is that of its tensors in checkpoints
    head: Head = "continuous"

    @abstractmethod
    def latent(self, observation: Tensor) -> Latent:
        """Return the output before an action is chosen."""

    @abstractmethod
    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""

    def forward(self, observation: Tensor) -> Tensor:
        """Return the deterministic action: (B, act), or (B,) int64 of a discrete head."""
        return self.decide(self.latent(observation).mean)

    def scores(self, observation: Tensor) -> Tensor:
        """Return the action before tanh, or the logits (B, act)."""
        return self.latent(observation).mean

    def decide(self, mean: Tensor) -> Tensor:
        """Return the deterministic action of `Latent.mean`."""
        return mean.argmax(-1) if self.head == "discrete" else torch.tanh(mean)

    def sample_encoding(self, observation: Tensor) -> Tensor:
        """Return spikes (B, ...) drawn by a random encoder; without one, the observation.

        Algorithms store it, so that they learn from the same spikes that were acted on.
        """
        return observation

    def forward_encoded(self, encoded: Tensor) -> Latent:
        """Return the output for what sample_encoding returned."""
        return self.latent(encoded)

    def features_of(self, observation: Tensor) -> Tensor:
        """Return the inputs (B, F) of the normaliser for raw observations."""
        return observation


def full_precision(layer: nn.Module, hidden: Tensor) -> Tensor:
    """Return the layer's output, computed without autocast."""
    # bfloat16 has 8 bits of precision: enough inside a network, too few for its output
    with torch.autocast("cpu", enabled=False):
        output: Tensor = layer(hidden.float() if hidden.dtype == torch.bfloat16 else hidden)
    return output
