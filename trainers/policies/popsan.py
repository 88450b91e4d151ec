"""PopSAN policy: population encoder, layers of CuBa-LIF neurons, learned decoder."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.encoders import TorchPopulationEncoder
from spikedeploy.trainers.policies.neurons import cuba_lif, firing_rates, mean_rate, surrogate
from spikedeploy.trainers.policies.normaliser import TorchNormaliser
from spikedeploy.trainers.policies.policy import Latent, Policy


class PopsanPolicy(Policy):
    """A population-coded spiking actor (Tang et al. 2020).

    layers: nn.Linear into each spiking layer; the last has P neurons for every action
    decoder_weight, decoder_bias: (act, P), (act,) from output rates to the action before tanh
    alpha, beta, threshold: decay factors of current and membrane, and threshold, of all neurons
    surrogate, surrogate_width: see `policies.neurons`
    """

    kind = "popsan"

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Sequence[int] = (512, 512),
        populations: int = 10,
        timesteps: int = 5,
        alpha: float = 0.9,
        beta: float = 0.8,
        threshold: float = 0.5,
        surrogate: str = "atan",
        surrogate_width: float | None = None,
        clip: float = 4.0,
    ) -> None:
        super().__init__()
        self.observations, self.actions, self.hidden = observations, actions, tuple(hidden)
        self.populations, self.timesteps = populations, timesteps
        self.alpha, self.beta, self.threshold = alpha, beta, threshold
        self.surrogate, self.surrogate_width = surrogate, surrogate_width
        self.normalizer = TorchNormaliser(observations, clip)
        self.encoder = TorchPopulationEncoder(observations, populations)
        widths = (observations * populations, *hidden, actions * populations)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(widths))
        bound = populations**-0.5
        self.decoder_weight = nn.Parameter(
            torch.empty(actions, populations).uniform_(-bound, bound)
        )
        self.decoder_bias = nn.Parameter(torch.zeros(actions))
        self.latent_size = widths[-1]

    def spikes(self, observation: Tensor) -> list[Tensor]:
        """Return the spikes (T, B, N) of the encoder and of every layer."""
        gradient = surrogate(self.surrogate, self.surrogate_width)
        rasters = [self.encoder(self.normalizer(observation), self.timesteps)]
        for layer in self.layers:
            drive = layer(rasters[-1])
            rasters.append(cuba_lif(drive, self.alpha, self.beta, self.threshold, gradient))
        return rasters

    def decode(self, rates: Tensor) -> Tensor:
        """Return the action before tanh (B, act) from output rates (B, act·P)."""
        grouped = rates.view(-1, self.actions, self.populations)
        return (grouped * self.decoder_weight).sum(-1) + self.decoder_bias

    def latent(self, observation: Tensor) -> Latent:
        """Return mean, output rates and the layers' mean rates."""
        layers = self.spikes(observation)[1:]
        rates = firing_rates(layers[-1])
        return Latent(self.decode(rates), rates, tuple(mean_rate(layer) for layer in layers))

    def trace(self, observation: Tensor) -> dict[str, Tensor]:
        """Return spikes (B, T, N) under "input", "lif1", "lif2" ..., and the "action" (B, act)."""
        rasters = self.spikes(observation)
        names = ["input", *(f"lif{k}" for k in range(1, len(rasters)))]
        spikes = {
            name: raster.transpose(0, 1).to(torch.uint8)
            for name, raster in zip(names, rasters, strict=True)
        }
        return {**spikes, "action": torch.tanh(self.decode(firing_rates(rasters[-1])))}

    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""
        return {
            "kind": self.kind,
            "observations": self.observations,
            "actions": self.actions,
            "hidden": list(self.hidden),
            "populations": self.populations,
            "timesteps": self.timesteps,
            "alpha": self.alpha,
            "beta": self.beta,
            "threshold": self.threshold,
            "surrogate": self.surrogate,
            "surrogate_width": self.surrogate_width,
            "clip": self.normalizer.clip,
        }
