"""The population encoder: each observation as the spikes of a few tuned neurons."""

import math

import torch
from torch import Tensor, nn

from spikedeploy.trainers.neurons import integrate_and_fire

REACH = 3.0  # initial centres lie evenly within this many standard deviations (Tang et al. 2020)
INITIAL_STD = math.sqrt(0.15)  # (Tang et al. 2020)
THRESHOLD = 0.999  # (Tang et al. 2020); below one, so that a drive of one fires at every timestep


class TorchPopulationEncoder(nn.Module):
    """Gaussian receptive fields, learned, that drive integrate-and-fire neurons.

    mean, std: (obs, P) centre and width of each field [normalised observation]
    threshold: membrane above which an encoding neuron spikes
    """

    def __init__(self, observations: int, populations: int, reach: float = REACH) -> None:
        super().__init__()
        spread = torch.linspace(-reach, reach, populations) if populations > 1 else torch.zeros(1)
        self.mean = nn.Parameter(spread.repeat(observations, 1))
        # the logarithm is what is learned, so that a width cannot turn negative
        self.log_std = nn.Parameter(torch.full_like(self.mean, math.log(INITIAL_STD)))
        self.threshold = THRESHOLD

    @property
    def std(self) -> Tensor:
        """Width of each field (obs, P)."""
        return self.log_std.exp()

    def forward(self, observation: Tensor, timesteps: int) -> Tensor:
        """Return spikes (T, B, obs·P) of normalised observations (B, obs)."""
        # A = exp(-1/2 ((x - mean) / std)^2)
        drive = torch.exp(-0.5 * ((observation[:, :, None] - self.mean) / self.std).square())
        return integrate_and_fire(drive.flatten(1), self.threshold, timesteps)
