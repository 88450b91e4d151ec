"""Spiking policies of several timesteps an inference: encoders, PopSAN, spiking MLP."""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor, nn

from spikedeploy.trainers.policies.policy import Head, Latent, Policy, TorchNormaliser
from spikedeploy.trainers.surrogate_neurons import (
    cuba_lif,
    firing_rates,
    integrate_and_fire,
    mean_rate,
    surrogate,
)

_REACH = 3.0  # initial centres are spaced evenly within +-3 standard deviations (Tang et al. 2020)
_INITIAL_STD = math.sqrt(0.15)  # (Tang et al. 2020)
_THRESHOLD = 0.999  # (Tang et al. 2020); below one, so that a drive of one fires at every timestep
_LEVELS = 256  # of a rate: an 8-bit register that also holds one
Mode = Literal["regular", "bernoulli"]
Coding = Literal["regular", "bernoulli", "population"]


class TorchPopulationEncoder(nn.Module):
    """Population code: learned Gaussian receptive fields that drive integrate-and-fire neurons.

    `runtime.codec` defines the same codes in NumPy.

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
            drawn = torch.randint(_LEVELS, (timesteps, *levels.shape), device=levels.device)
            return (drawn < levels).to(observation.dtype)
        # the carries of an 8-bit accumulator that starts half full
        ticks = torch.arange(timesteps + 1, dtype=levels.dtype, device=levels.device)
        clock = ticks[:, None, None]
        # c[t] = floor((n t + 128) / 256) ; s[t] = c[t + 1] - c[t]
        carries = ((clock * levels + _LEVELS // 2) / _LEVELS).floor_()
        return (carries[1:] - carries[:-1]).to(observation.dtype)


class PopsanPolicy(Policy):
    """A population-coded spiking actor (Tang et al. 2020), of CuBa-LIF neurons.

    layers: nn.Linear into each spiking layer; the last has P neurons for every action
    decoder_weight, decoder_bias: (act, P), (act,) from output rates to the action before tanh
    alpha, beta, threshold: decay factors of current and membrane, and threshold, of all neurons
    surrogate, surrogate_width: see `trainers.surrogate_neurons`
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
        named = _batch_first(dict(zip(names, rasters, strict=True)))
        return {**named, "action": torch.tanh(self.decode(firing_rates(rasters[-1])))}


class CodedPolicy(Policy):
    """Spikes that code the observation, layers of neurons, and a linear readout of the last ones.

    encoder: from normalised observations to spikes
    coding: its kind
    timesteps: T of an inference, which starts from states of 0
    readout: nn.Linear from what the last layer puts out, on average over T, to `Latent.mean`
    """

    encoder: nn.Module
    coding: Coding
    timesteps: int
    readout: nn.Linear

    def _add_code(self, observations: int, populations: int, reach: float, clip: float) -> int:
        """Add normaliser and encoder; return the width of the code."""
        self.normalizer = TorchNormaliser(observations, clip)
        if self.coding == "population":
            self.encoder = TorchPopulationEncoder(observations, populations, reach)
        else:
            self.encoder = TorchRateEncoder(observations, self.coding, -reach, reach)
        return observations * (populations if self.coding == "population" else 1)

    def encode(self, observation: Tensor) -> Tensor:
        """Return the input spikes (T, B, M); a random code draws them anew at every call."""
        spikes: Tensor = self.encoder(self.normalizer(observation), self.timesteps)
        return spikes

    @abstractmethod
    def layers_of(self, raster: Tensor) -> dict[str, Tensor]:
        """Return the spikes (T, B, N) of every layer by its name, for input spikes (T, B, M)."""

    def spikes(self, raster: Tensor) -> list[Tensor]:
        """Return the spikes (T, B, N) of every layer for input spikes (T, B, M)."""
        return list(self.layers_of(raster).values())

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
        """Return spikes (B, T, N) of "input" and of layers by name, and the "action".

        raster: (B, T, M) replaces the encoder's spikes
        """
        inputs = self.encode(observation) if raster is None else raster.transpose(0, 1)
        # spikes have the weights' type, which checks in float64 rely on
        inputs = inputs.to(self.readout.weight.dtype)
        layers = self.layers_of(inputs)
        action = self.decide(self.forward_spikes(inputs).mean)
        return {**_batch_first({"input": inputs, **layers}), "action": action}


class SpikingMlpPolicy(CodedPolicy):
    """Layers of LIF neurons with a linear readout of the last layer's firing rates.

    layers: nn.Linear into each spiking layer
    beta, threshold: decay factor and threshold of every membrane, which a spike sets to zero
    surrogate, surrogate_width: see `trainers.surrogate_neurons`
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
        self.coding, self.populations, self.reach = coding, populations, reach
        self.timesteps, self.beta, self.threshold = timesteps, beta, threshold
        self.surrogate, self.surrogate_width = surrogate, surrogate_width
        self.head = head
        inputs = self._add_code(observations, populations, reach, clip)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise((inputs, *hidden)))
        for layer in self.layers:
            # (He et al. 2015); without it, deep layers do not spike at first
            nn.init.kaiming_uniform_(layer.get_parameter("weight"), nonlinearity="relu")
            nn.init.zeros_(layer.get_parameter("bias"))
        self.readout = nn.Linear(hidden[-1], actions)
        self.latent_size = hidden[-1]

    def layers_of(self, raster: Tensor) -> dict[str, Tensor]:
        """Return the spikes (T, B, N) of "lif1", "lif2" ... for input spikes (T, B, M)."""
        gradient = surrogate(self.surrogate, self.surrogate_width)
        found: dict[str, Tensor] = {}
        for number, layer in enumerate(self.layers, start=1):
            drive = layer(raster)
            raster = cuba_lif(drive, 0.0, self.beta, self.threshold, gradient)
            found[f"lif{number}"] = raster
        return found


def _batch_first(rasters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return spikes (T, B, N) as (B, T, N), by name."""
    return {name: raster.transpose(0, 1).to(torch.uint8) for name, raster in rasters.items()}
