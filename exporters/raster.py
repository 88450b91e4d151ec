"""What a spiking policy hears in torch, chance throwing the dice of a chip and not torch's own."""

import torch
from torch import Tensor

from runtime.xorshift import Xorshift
from trainers.policies import SpikingMlpPolicy
from trainers.rate import RateEncoder


def raster(policy: SpikingMlpPolicy, observation: Tensor, dice: Xorshift) -> Tensor:
    """Return the input spikes (T, B, M) for the observations (B, obs) of B robots."""
    encoder = policy.encoder
    if not (isinstance(encoder, RateEncoder) and encoder.mode == "bernoulli"):
        return policy.encode(observation)
    drawn = torch.from_numpy(dice.draw(len(observation), policy.timesteps))
    # s[t] = byte[t] < n
    spikes = drawn.transpose(0, 1) < encoder.levels(policy.normalizer(observation))
    return spikes.to(observation.dtype)
