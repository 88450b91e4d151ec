"""Policy: the deployable part of what is trained; its normalisation, and weights with masks."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from inspect import signature
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

Head = Literal["continuous", "discrete"]
_MIN_STD = 0.01  # observations are of order one; a constant one must not be amplified


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
    started: whether its weights are those of a trained file, which training goes on from
    """

    kind: str
    observations: int
    actions: int
    latent_size: int
    normalizer: "TorchNormaliser"  # the name is that of its tensors in checkpoints
    head: Head = "continuous"
    started = False

    @abstractmethod
    def latent(self, observation: Tensor) -> Latent:
        """Return the output before an action is chosen."""

    @property
    def clip(self) -> float:
        """Limit of normalised observations [standard deviations]."""
        return self.normalizer.clip

    @property
    def device(self) -> torch.device:
        """The device that it computes on."""
        return self.normalizer.mean.device

    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""
        found = {name: getattr(self, name) for name in signature(type(self)).parameters}
        for name, value in found.items():
            if isinstance(value, tuple):
                found[name] = list(value)
            elif hasattr(value, "spec"):
                found[name] = value.spec()
        return {"kind": self.kind, **found}

    def forward(self, observation: Tensor) -> Tensor:
        """Return the deterministic action: (B, act), or (B,) int64 of a discrete head."""
        return self.decide(self.latent(observation).mean)

    def scores(self, observation: Tensor) -> Tensor:
        """Return the action before tanh, or the logits (B, act)."""
        return self.latent(observation).mean

    def decide(self, mean: Tensor) -> Tensor:
        """Return the deterministic action of `Latent.mean`."""
        return mean.argmax(-1) if self.head == "discrete" else torch.tanh(mean)

    def env_action(self, mean: Tensor) -> NDArray[Any]:
        """Return the deterministic action of `Latent.mean` as environments take it."""
        action = self.decide(mean)
        return (action.double() if action.is_floating_point() else action).cpu().numpy()

    def sample_encoding(self, observation: Tensor) -> Tensor:
        """Return spikes (B, ...) drawn by a random encoder; without one, the observation.

        Algorithms store it, so that they learn from the same spikes that were acted on.
        """
        return observation

    def forward_encoded(self, encoded: Tensor) -> Latent:
        """Return the output for what sample_encoding returned."""
        return self.latent(encoded)


def full_precision(layer: nn.Module, hidden: Tensor) -> Tensor:
    """Return the layer's output, computed without autocast."""
    # bfloat16 has 8 bits of precision: enough inside a network, too few for its output
    with torch.autocast("cpu", enabled=False):
        output: Tensor = layer(hidden.float() if hidden.dtype == torch.bfloat16 else hidden)
    return output


class TorchNormaliser(nn.Module):
    """Shifts, scales and clips observations; part of every policy.

    mean, std: (obs,) [observation]
    clip: limit on both sides [standard deviations]
    """

    mean: Tensor
    std: Tensor

    def __init__(self, size: int, clip: float = 4.0) -> None:
        super().__init__()
        self.clip = clip
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def forward(self, observation: Tensor) -> Tensor:
        """Return normalised and clipped observations (B, obs)."""
        # x = clip((obs - mean) / std)
        return ((observation - self.mean) / self.std).clamp_(-self.clip, self.clip)

    def adopt(self, moments: "Moments") -> None:
        """Use the mean and standard deviation of these statistics."""
        for buffer, found in ((self.mean, moments.mean), (self.std, moments.std)):
            buffer.copy_(torch.from_numpy(found).float())


@dataclass
class Moments:
    """Running mean and variance in float64 (Chan et al. 1979).

    mean, square: (obs,) mean, and sum of squared deviations
    count: number of observations added
    """

    mean: NDArray[np.float64]
    square: NDArray[np.float64]
    count: int = 0

    @classmethod
    def empty(cls, size: int) -> "Moments":
        """Return the moments of no observations."""
        return cls(np.zeros(size), np.zeros(size))

    @classmethod
    def from_batch(cls, batch: NDArray[np.float64]) -> "Moments":
        """Return the moments of observations (B, obs)."""
        moments = cls.empty(batch.shape[1])
        moments.add(batch)
        return moments

    @classmethod
    def restored(cls, named: Mapping[str, Tensor], count: int) -> "Moments":
        """Return the moments of a checkpoint, from `tensors` and the count."""
        return cls(named["moments.mean"].numpy(), named["moments.square"].numpy(), count)

    def tensors(self) -> dict[str, Tensor]:
        """Return the arrays by name, for a checkpoint."""
        arrays = {"mean": self.mean, "square": self.square}
        return {f"moments.{name}": torch.from_numpy(array) for name, array in arrays.items()}

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation (obs,), at least 0.01; 1 before there are data."""
        if self.count < 2:
            return np.ones_like(self.mean)
        return np.maximum(np.sqrt(self.square / self.count), _MIN_STD)

    def add(self, batch: NDArray[np.float64]) -> None:
        """Add a batch of observations (B, obs)."""
        count, mean = len(batch), batch.mean(0)
        delta, total = mean - self.mean, self.count + count
        # M = M_a + M_b + delta^2 n_a n_b / n
        self.square += ((batch - mean) ** 2).sum(0) + delta**2 * (self.count * count / total)
        self.mean += delta * (count / total)
        self.count = total


# -- weights that are pruned


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

    @property
    def uses(self) -> Tensor:
        """Mean operations of each weight in a control step, of its shape."""
        return self.rate.expand_as(self.matrix.mask)
