"""Networks of random weights that benchmarks run: a chip's integers, and rates as asked for."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.codec.population import PopulationEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace

Raster = NDArray[np.uint8]

ONE = 4096  # a decay factor of 1
SHIFT = 6  # from a weight to state units


@dataclass(frozen=True)
class Net:
    """A feed-forward network of equal layers, for us and for peers.

    weights: (M, N) of each layer, int16.
    thresholds: of each layer [weights]; half a weight off, so that nothing ties.
    alpha, beta: decay factors of current and membrane a timestep; alpha 0 has no current.
    timesteps: T.
    program: the same for `loihi1`.
    """

    name: str
    weights: list[NDArray[np.int16]]
    thresholds: list[float]
    alpha: float
    beta: float
    timesteps: int
    program: Program


def popsan(raster: Raster, seed: int = 0) -> Net:
    """The shape of the hexapod's policy, with its decays; layers spike at 12, 8 and 10 %."""
    sizes, rates = (770, 512, 512, 180), (0.12, 0.08, 0.10)
    return calibrate("770-512-512-180", sizes, rates, 0.5, 0.75, raster, seed)


def kart(raster: Raster, seed: int = 0) -> Net:
    """The shape of a kart's driver: LIF neurons, rate coded; layers spike at 15 %."""
    sizes, rates = (20, 64, 64, 5), (0.15, 0.15, 0.15)
    return calibrate("20-64-64-5", sizes, rates, 0.0, 3686 / ONE, raster, seed)


def bernoulli(batch: int, timesteps: int, width: int, rate: float, seed: int = 0) -> Raster:
    """Independent spikes (B, T, M)."""
    return (np.random.default_rng(seed).random((batch, timesteps, width)) < rate).astype(np.uint8)


def encode(batch: int, timesteps: int, seed: int = 0) -> Raster:
    """Spikes (B, T, 770) of PopSAN's encoder for observations drawn from a normal distribution."""
    centres = np.tile(np.linspace(-3, 3, 10), (77, 1))
    encoder = PopulationEncoder(centres, np.full((77, 10), 0.15**0.5))
    observations = np.random.default_rng(seed).normal(size=(batch, 77))
    return np.ascontiguousarray(encoder.encode(observations, timesteps))


def calibrate(
    name: str,
    sizes: tuple[int, ...],
    rates: tuple[float, ...],
    alpha: float,
    beta: float,
    raster: Raster,
    seed: int,
) -> Net:
    """A network whose layers spike at such rates when the raster comes in."""
    rng = np.random.default_rng(seed)
    weights = [rng.integers(-127, 128, shape).astype(np.int16) for shape in pairwise(sizes)]
    decays = (round(alpha * ONE), round(beta * ONE))
    layers: list[Layer] = []
    for k, (weight, rate) in enumerate(zip(weights, rates, strict=True), start=1):
        layers.append(layer(k, weight, decays, threshold=1))
        layers[-1] = replace(layers[-1], threshold=_threshold(program(layers), raster, rate))
    thresholds = [float(a.threshold[0]) / (1 << SHIFT) for a in layers]
    return Net(name, weights, thresholds, alpha, beta, raster.shape[1], program(layers))


def layer(k: int, weight: NDArray[Any], decays: tuple[int, int], threshold: int) -> Layer:
    """Layer k, counted from 1, whose input is the layer before it; the threshold is in weights."""
    ones = np.ones(weight.shape[1], np.int64)
    return Layer(
        name=f"layer{k}",
        synapses=(Synapses(f"layer{k - 1}" if k > 1 else "input", weight, delay=1),),
        bias=0 * ones,
        voltage_bias=0 * ones,
        threshold=_between(threshold) * ones,
        current_decay=decays[0] * ones,
        membrane_decay=decays[1] * ones,
        scale=1.0,
        start=k,
    )


def program(layers: list[Layer]) -> Program:
    """The layers on `loihi1`."""
    width = len(layers[0].synapses[0].weight)
    convention = Convention(1e-3)
    return Program(chip("loihi1"), convention, "input", width, tuple(layers), layers[-1].name, None)


def _threshold(program: Program, raster: Raster, rate: float) -> NDArray[np.int64]:
    """(N,) threshold at which the last layer spikes at the rate; found by halving."""
    sample, ones = raster[:32], np.ones(program.layers[-1].size, np.int64)
    low, high = 1, 1 << 16
    while high - low > 1:
        middle = (low + high) // 2
        last = replace(program.layers[-1], threshold=_between(middle) * ones)
        spiking = replace(program, layers=(*program.layers[:-1], last))
        mean = trace(spiking, sample)[last.name].spikes.mean()
        low, high = (middle, high) if mean > rate else (low, middle)
    return _between(low) * ones


def _between(threshold: int) -> int:
    """In state units, half a weight above."""
    return (threshold << SHIFT) + (1 << SHIFT) // 2
