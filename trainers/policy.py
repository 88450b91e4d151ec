"""What a policy is: the deployable part of what is trained, observation in, action out."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn

from spikedeploy.trainers.normalizer import Normalizer

Head = Literal["continuous", "discrete"]


@dataclass(frozen=True)
class Latent:
    """What a policy computes before it decides.

    mean: (B, act) action before tanh, or the logit of each action
    hidden: (B, H) last activities, from which an algorithm may read more than the action
    rates: mean firing rate of each spiking layer, none in a float network [spikes / timestep]
    """

    mean: Tensor
    hidden: Tensor
    rates: tuple[Tensor, ...] = ()


class Policy(nn.Module):
    """Observation (B, obs) in, deterministic action out.

    observations, actions: their numbers
    head: "continuous", actions (B, act) in [-1, 1], or "discrete", the index (B,) of one of them
    normalizer: shift, scale and clip of the observations, part of the policy
    latent_size: width H of `Latent.hidden`
    """

    kind: str
    observations: int
    actions: int
    latent_size: int
    normalizer: Normalizer
    head: Head = "continuous"

    @abstractmethod
    def latent(self, observation: Tensor) -> Latent:
        """Return the state before squashing."""

    @abstractmethod
    def spec(self) -> dict[str, Any]:
        """Return what `build` needs to make an equal policy, for JSON."""

    def forward(self, observation: Tensor) -> Tensor:
        """Return the deterministic action: (B, act), or (B,) int64 of a discrete head."""
        return self.decide(self.latent(observation).mean)

    def scores(self, observation: Tensor) -> Tensor:
        """Return the action before tanh, or the logits (B, act)."""
        return self.latent(observation).mean

    def decide(self, mean: Tensor) -> Tensor:
        """Return the deterministic action of `Latent.mean`."""
        return mean.argmax(-1) if self.head == "discrete" else torch.tanh(mean)

    def perceive(self, observation: Tensor) -> Tensor:
        """Return what chance has made of the observation, (B, ...); without chance, itself.

        An algorithm keeps it, so that it learns from the same draw that was acted on.
        """
        return observation

    def respond(self, perceived: Tensor) -> Latent:
        """Return the state before deciding, for what was perceived."""
        return self.latent(perceived)

    def seen(self, observation: Tensor) -> Tensor:
        """Return what the normaliser sees (B, F) of raw observations."""
        return observation


def full_precision(layer: nn.Module, hidden: Tensor) -> Tensor:
    """Return the layer's output, computed outside of any autocast."""
    # bfloat16 keeps 8 bits: enough inside a network, too few for what it says
    with torch.autocast("cpu", enabled=False):
        output: Tensor = layer(hidden.float() if hidden.dtype == torch.bfloat16 else hidden)
    return output
