"""Spiking multilayer perceptron: rate or population code, LIF layers, linear readout."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.encoders import TorchPopulationEncoder, TorchRateEncoder
from spikedeploy.trainers.policies.neurons import firing_rates, lif, mean_rate, surrogate
from spikedeploy.trainers.policies.normaliser import TorchNormaliser
from spikedeploy.trainers.policies.policy import Head, Latent, Policy

Coding = Literal["regular", "bernoulli", "population"]


class SpikingMlpPolicy(Policy):
    """Layers of LIF neurons with a linear readout of the last layer's firing rates.

    encoder: from normalised observations to spikes, as `coding` says
    layers: nn.Linear into each spiking layer
    readout: nn.Linear from the last layer's rates to `Latent.mean`
    beta, threshold: decay factor and threshold of every membrane, which a spike sets to zero
    surrogate, surrogate_width: see `policies.neurons`
    """

    kind = "spiking-mlp"

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Sequence[int] = (64, 64),
        coding: Coding = "regular",
        populations: int = 4,
        timesteps: int = 16,
        beta: float = 0.9,
        threshold: float = 0.7,
        surrogate: str = "fast-sigmoid",
        surrogate_width: float | None = None,
        clip: float = 4.0,
        head: Head = "continuous",
        reach: float = 1.0,
    ) -> None:
        super().__init__()
        self.observations, self.actions, self.hidden = observations, actions, tuple(hidden)
        self.coding, self.populations, self.timesteps = coding, populations, timesteps
        self.reach = reach
        self.beta, self.threshold = beta, threshold
        self.surrogate, self.surrogate_width = surrogate, surrogate_width
        self.head = head
        self.normalizer = TorchNormaliser(observations, clip)
        self.encoder = _encoder(coding, observations, populations, reach)
        inputs = observations * (populations if coding == "population" else 1)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise((inputs, *hidden)))
        for layer in self.layers:
            # (He et al. 2015); without it, deep layers do not spike at first
            nn.init.kaiming_uniform_(layer.get_parameter("weight"), nonlinearity="relu")
            nn.init.zeros_(layer.get_parameter("bias"))
        self.readout = nn.Linear(hidden[-1], actions)
        self.latent_size = hidden[-1]

    def encode(self, observation: Tensor) -> Tensor:
        """Return the input spikes (T, B, M); a random code draws them anew at every call."""
        spikes: Tensor = self.encoder(self.normalizer(observation), self.timesteps)
        return spikes

    def spikes(self, raster: Tensor) -> list[Tensor]:
        """Return the spikes (T, B, N) of every layer for input spikes (T, B, M)."""
        gradient = surrogate(self.surrogate, self.surrogate_width)
        rasters = [raster]
        for layer in self.layers:
            rasters.append(lif(layer(rasters[-1]), self.beta, self.threshold, gradient))
        return rasters[1:]

    def forward_spikes(self, raster: Tensor) -> Latent:
        """Return the output for input spikes (T, B, M)."""
        layers = self.spikes(raster)
        rates = firing_rates(layers[-1])
        return Latent(self.readout(rates), rates, tuple(mean_rate(layer) for layer in layers))

    def sample_encoding(self, observation: Tensor) -> Tensor:
        """Return input spikes (B, T, M) drawn by a random code; else the observation."""
        if self.coding != "bernoulli":
            return observation
        return self.encode(observation).transpose(0, 1).to(torch.uint8)

    def forward_encoded(self, encoded: Tensor) -> Latent:
        """Return the output for what sample_encoding returned."""
        if self.coding != "bernoulli":
            return self.latent(encoded)
        return self.forward_spikes(encoded.transpose(0, 1).to(self.readout.weight.dtype))

    def latent(self, observation: Tensor) -> Latent:
        """Return mean, output rates and the layers' mean rates."""
        return self.forward_spikes(self.encode(observation))

    def trace(self, observation: Tensor, raster: Tensor | None = None) -> dict[str, Tensor]:
        """Return spikes (B, T, N) under "input", "lif1", "lif2" ..., and the "action".

        raster: (B, T, M) replaces the encoder's spikes
        """
        inputs = self.encode(observation) if raster is None else raster.transpose(0, 1)
        # spikes have the weights' type, which checks in float64 rely on
        rasters = [inputs.to(self.readout.weight.dtype)]
        rasters += self.spikes(rasters[0])
        names = ["input", *(f"lif{k}" for k in range(1, len(rasters)))]
        spikes = {
            name: raster.transpose(0, 1).to(torch.uint8)
            for name, raster in zip(names, rasters, strict=True)
        }
        mean = self.readout(firing_rates(rasters[-1]))
        return {**spikes, "action": self.decide(mean)}

    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""
        return {
            "kind": self.kind,
            "observations": self.observations,
            "actions": self.actions,
            "hidden": list(self.hidden),
            "coding": self.coding,
            "populations": self.populations,
            "reach": self.reach,
            "timesteps": self.timesteps,
            "beta": self.beta,
            "threshold": self.threshold,
            "surrogate": self.surrogate,
            "surrogate_width": self.surrogate_width,
            "clip": self.normalizer.clip,
            "head": self.head,
        }


def _encoder(coding: Coding, observations: int, populations: int, reach: float) -> nn.Module:
    if coding == "population":
        return TorchPopulationEncoder(observations, populations, reach)
    return TorchRateEncoder(observations, coding, -reach, reach)
