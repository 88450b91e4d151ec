"""Rate codes: each observation as the spikes of one neuron; `runtime.rate` is the definition."""

from typing import Literal

import torch
from torch import Tensor, nn

LEVELS = 256  # of a rate: an 8-bit register that also holds one
Mode = Literal["regular", "bernoulli"]


class TorchRateEncoder(nn.Module):
    """One neuron for each observation, which spikes the more often the larger the number is.

    low, high: (obs,) observations that never spike and that spike at every timestep
    mode: "regular" spaces the spikes evenly, "bernoulli" draws each
    """

    low: Tensor
    high: Tensor

    def __init__(self, observations: int, mode: Mode, low: float = -1.0, high: float = 1.0) -> None:
        super().__init__()
        self.mode = mode
        self.register_buffer("low", torch.full((observations,), low))
        self.register_buffer("high", torch.full((observations,), high))

    def levels(self, observation: Tensor) -> Tensor:
        """Return the rates (B, obs) of normalised observations (B, obs) [1/256 per timestep]."""
        # n = round(256 clip((x - low) / (high - low), 0, 1)), halves to even
        share = ((observation - self.low) / (self.high - self.low)).clamp(0.0, 1.0)
        return (share * LEVELS).round_()

    def forward(self, observation: Tensor, timesteps: int) -> Tensor:
        """Return spikes (T, B, obs) of normalised observations (B, obs)."""
        levels = self.levels(observation)
        if self.mode == "bernoulli":
            rng = torch.randint(LEVELS, (timesteps, *levels.shape))
            return (rng < levels).to(observation.dtype)
        return regular(levels, timesteps).to(observation.dtype)


def regular(levels: Tensor, timesteps: int) -> Tensor:
    """Return the spikes (T, B, obs): the carries of an 8-bit accumulator that begins half full."""
    clock = torch.arange(timesteps + 1, dtype=levels.dtype)[:, None, None]
    # c[t] = floor((n t + 128) / 256) ; s[t] = c[t + 1] - c[t]
    carried = ((clock * levels + LEVELS // 2) / LEVELS).floor_()
    return carried[1:] - carried[:-1]
