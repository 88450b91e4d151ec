"""Input spikes of a policy in torch, drawn with the generator of the chip, not of torch."""

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.trainers.policies import SpikingMlpPolicy
from spikedeploy.trainers.policies.encoders import TorchRateEncoder

# (B, T) -> random bytes (B, T, M), as the methods of Xorshift
RandomBytes = Callable[[int, int], NDArray[np.uint8]]


def raster(policy: SpikingMlpPolicy, observation: Tensor, rng: RandomBytes) -> Tensor:
    """Return the input spikes (T, B, M) for the observations (B, obs)."""
    encoder = policy.encoder
    if not (isinstance(encoder, TorchRateEncoder) and encoder.mode == "bernoulli"):
        return policy.encode(observation)
    drawn = torch.from_numpy(rng(len(observation), policy.timesteps))
    # s[t] = byte[t] < n
    spikes = drawn.transpose(0, 1) < encoder.levels(policy.normalizer(observation))
    return spikes.to(observation.dtype)
