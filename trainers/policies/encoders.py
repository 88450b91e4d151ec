"""Torch encoders of the spiking policies; `runtime.codec` defines the same codes in NumPy."""

import math
from typing import Literal

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.neurons import integrate_and_fire

_REACH = 3.0  # initial centres are spaced evenly within +-3 standard deviations (Tang et al. 2020)
_INITIAL_STD = math.sqrt(0.15)  # (Tang et al. 2020)
_THRESHOLD = 0.999  # (Tang et al. 2020); below one, so that a drive of one fires at every timestep
_LEVELS = 256  # of a rate: an 8-bit register that also holds one
Mode = Literal["regular", "bernoulli"]


class TorchPopulationEncoder(nn.Module):
    """Population code: learned Gaussian receptive fields that drive integrate-and-fire neurons.

    mean, std: (obs, P) centre and width of each field [normalised observation]
    threshold: membrane above which an encoding neuron spikes
    """

    def __init__(self, observations: int, populations: int, reach: float = _REACH) -> None:
        super().__init__()
        spread = torch.linspace(-reach, reach, populations) if populations > 1 else torch.zeros(1)
        self.mean = nn.Parameter(spread.repeat(observations, 1))
        # widths are learned as logarithms, so that they stay positive
        self.log_std = nn.Parameter(torch.full_like(self.mean, math.log(_INITIAL_STD)))
        self.threshold = _THRESHOLD

    @property
    def std(self) -> Tensor:
        """Width of each field (obs, P)."""
        return self.log_std.exp()

    def forward(self, observation: Tensor, timesteps: int) -> Tensor:
        """Return spikes (T, B, obs·P) of normalised observations (B, obs)."""
        # A = exp(-1/2 ((x - mean) / std)^2)
        drive = torch.exp(-0.5 * ((observation[:, :, None] - self.mean) / self.std).square())
        return integrate_and_fire(drive.flatten(1), self.threshold, timesteps)


class TorchRateEncoder(nn.Module):
    """Rate code: one neuron for each observation, with a rate proportional to its value.

    low, high: (obs,) values that map to rates of 0 and 1
    mode: "regular" spaces the spikes evenly, "bernoulli" draws each independently
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
        return (share * _LEVELS).round_()

    def forward(self, observation: Tensor, timesteps: int) -> Tensor:
        """Return spikes (T, B, obs) of normalised observations (B, obs)."""
        levels = self.levels(observation)
        if self.mode == "bernoulli":
            drawn = torch.randint(_LEVELS, (timesteps, *levels.shape))
            return (drawn < levels).to(observation.dtype)
        return _regular(levels, timesteps).to(observation.dtype)


def _regular(levels: Tensor, timesteps: int) -> Tensor:
    """Return the spikes (T, B, obs): carries of an 8-bit accumulator that starts half full."""
    clock = torch.arange(timesteps + 1, dtype=levels.dtype)[:, None, None]
    # c[t] = floor((n t + 128) / 256) ; s[t] = c[t + 1] - c[t]
    carried = ((clock * levels + _LEVELS // 2) / _LEVELS).floor_()
    return carried[1:] - carried[:-1]
