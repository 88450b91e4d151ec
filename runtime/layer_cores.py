"""Chips whose cores compute a layer each (Speck): entries of their memories, and who takes which.

A layer with a kernel of c channels, f features and kx ky taps takes c 2^(ceil(log2 kx ky) +
ceil(log2 f)) entries of kernel memory, its f maps of y x neurons f 2^(ceil(log2 y) + ceil(log2 x))
of neuron memory (sinabs 3.1.3, source read). A linear map behind a Flatten is a kernel as large as
what is flattened.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import nir

from runtime.limits import LayerCore
from runtime.shapes import DENSE
from runtime.topology import Population
from runtime.windows import CONVOLUTIONS


@dataclass(frozen=True)
class Entries:
    """What a layer takes of the memories of its core."""

    kernel: int
    neurons: int

    def fit(self, core: LayerCore) -> bool:
        """Whether the core holds it."""
        return self.kernel <= core.kernel and self.neurons <= core.neurons


def entries(graph: nir.NIRGraph, population: Population) -> Entries:
    """The entries of a population, with the kernels of all that it hears."""
    features, *space = population.shape
    kernel = sum(_kernel(graph, connection.fan.maps) for connection in population.heard)
    return Entries(kernel, features * 2 ** sum(_bits(extent) for extent in space))


def assigned(layers: Sequence[Entries], cores: Sequence[LayerCore]) -> Mapping[int, int] | None:
    """A core of its own for each layer, the first that serve; None where there are too few."""
    holds: dict[int, int] = {}
    if not all(_place(k, layers, cores, holds, set()) for k in range(len(layers))):
        return None
    return {layer: core for core, layer in holds.items()}


def _place(
    layer: int,
    layers: Sequence[Entries],
    cores: Sequence[LayerCore],
    holds: dict[int, int],
    tried: set[int],
) -> bool:
    """Give the layer a free core, or one whose layer can move on to another."""
    fitting = [place for place, core in enumerate(cores) if layers[layer].fit(core)]
    for place in sorted(fitting, key=lambda place: place in holds):
        if place in tried:
            continue
        tried.add(place)
        if place not in holds or _place(holds[place], layers, cores, holds, tried):
            holds[place] = layer
            return True
    return False


def _kernel(graph: nir.NIRGraph, maps: Sequence[str]) -> int:
    """Entries of the kernels on one way."""
    total, flattened = 0, None
    for name in maps:
        node = graph.nodes[name]
        if isinstance(node, nir.Flatten):
            flattened = [int(n) for n in node.input_type["input"]]
        elif isinstance(node, CONVOLUTIONS):
            features, channels, *taps = (int(n) for n in node.weight.shape)
            total += _entries(channels * int(node.groups), math.prod(taps), features)
        elif isinstance(node, DENSE):
            channels, *space = flattened or [int(node.weight.shape[-1])]
            total += _entries(channels, math.prod(space), int(node.weight.shape[-2]))
    return total


def _entries(channels: int, taps: int, features: int) -> int:
    return int(channels * 2 ** (_bits(taps) + _bits(features)))


def _bits(number: int) -> int:
    """The binary logarithm, rounded up."""
    return (number - 1).bit_length()
