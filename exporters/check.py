"""Checks of an exported file: what was compared, on which spikes, and the counters behind it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import ports

_RATE = 0.3  # spikes of an input in a timestep
_BATCH = 250  # observations; each takes a few kilobytes of spikes in a PopSAN


@dataclass(frozen=True)
class ParityCheck:
    """A line of a parity report.

    name: what was compared.
    passed: whether both agree.
    detail: the numbers.
    """

    name: str
    passed: bool
    detail: str


@dataclass
class MismatchCounter:
    """Counts of compared integers, such as spikes, and of those that differ."""

    compared: int = 0
    differing: int = 0

    def add(
        self, one: Mapping[str, NDArray[np.integer]], other: Mapping[str, NDArray[np.integer]]
    ) -> None:
        """Compare the rasters (B, T, N) of every layer of `one` with those in `other`."""
        for name, raster in one.items():
            self.compared += raster.size
            self.differing += int(np.count_nonzero(raster != other[name]))

    def __str__(self) -> str:
        found = f"{self.differing:,} differ" if self.differing else "all equal"
        return f"{self.compared:,} compared, {found}"


@dataclass
class LargestDifference:
    """The largest absolute difference so far."""

    largest: float = 0.0

    def add(self, one: NDArray[np.floating], other: NDArray[np.floating]) -> None:
        """Compare two arrays of actions (B, act)."""
        # np.max passes NaN on, so that a NaN is a difference
        self.largest = float(np.max([self.largest, np.abs(one - other).max()]))

    def within(self, limit: float) -> bool:
        """Return True if no difference exceeds the limit."""
        return self.largest <= limit


def random_spikes(rng: np.random.Generator, *shape: int) -> NDArray[np.uint8]:
    """Independent input spikes of this shape, at a rate of 0.3 for each timestep."""
    return (rng.random(shape) < _RATE).astype(np.uint8)


def batches(observations: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield the observations in batches of BATCH."""
    for start in range(0, len(observations), _BATCH):
        yield observations[start : start + _BATCH]


def compare_float(name: str, one: Artifact, other: Artifact, timesteps: int) -> ParityCheck:
    """Compare the spikes of every layer of two networks in float64 on one random raster."""
    rng = np.random.default_rng(0)
    rasters = [
        random_spikes(rng, 1, timesteps, *port.shape).astype(np.float64)
        for port in ports(one.graph.inputs)
    ]
    spikes: list[dict[str, Any]] = []
    for artifact in (one, other):  # by the number of the layer, in the order in which they run
        graph = FloatGraph(artifact)
        inputs = (port.name for port in ports(artifact.graph.inputs))
        trace = graph.run(dict(zip(inputs, rasters, strict=True)))
        layers = [each for each in graph.timing.names if each in graph.spiking]
        spikes.append({f"{k}": trace[each] for k, each in enumerate(layers)})
    counter = MismatchCounter()
    counter.add(spikes[0], spikes[1])
    return ParityCheck(name, not counter.differing and bool(counter.compared), f"spikes: {counter}")
