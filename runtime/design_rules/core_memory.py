"""What the synapses of a block of neurons take of the memory of a core.

Loihi's synapses lie in words of 64 bits: the synapses of an axon in blocks of up to 64, each block
with 10 bits of its own and rounded up to whole words (nengo-loihi 1.1.0, bits_per_axon). A sparse
list names the neuron of each synapse, a dense one stores every weight of the core, zeros included.

Where each core computes a layer (Speck), memories have entries, and every layer takes a core. A
layer with a kernel of c channels, f features and kx ky taps takes c 2^(ceil(log2 kx ky) +
ceil(log2 f)) entries of kernel memory, its f maps of y x neurons f 2^(ceil(log2 y) + ceil(log2 x))
of neuron memory (sinabs 3.1.3, source read). A linear map behind a Flatten is a kernel as large as
what is flattened.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import LayerCore, Limits, SynapticMemory
from spikedeploy.runtime.design_rules.topology import Population, Projection
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE

Counts = NDArray[np.int64]

_WORD = 64
_BLOCK = 64
_OVERHEAD = 10
_INDEX_BITS = (6, 7, 8, 9, 10, 11, 12)
_DELAY_BITS = 6


def axon_bits(synapses: Counts, bits: int) -> Counts:
    """What an axon of so many synapses of so many bits takes in words [bit]."""
    blocks, rest = np.divmod(synapses, _BLOCK)
    full = _words(_BLOCK * bits + _OVERHEAD)
    return np.asarray(blocks * full + np.where(rest, _words(rest * bits + _OVERHEAD), 0))


def list_bits(counts: Counts, neurons: int, memory: SynapticMemory, delayed: bool) -> Counts:
    """What one list takes in each of k cores [bit].

    counts: (M, k) synapses of each axon in each core.
    neurons: of a core.
    delayed: whether each synapse has a delay of its own.
    """
    if memory.cost == "bits":
        return np.asarray(counts.sum(axis=0) * memory.weight_bits)
    bits = memory.weight_bits + (_DELAY_BITS if delayed else 0)
    sparse = axon_bits(counts, bits + index_bits(neurons)).sum(axis=0)
    dense = np.count_nonzero(counts, axis=0) * axon_bits(np.array([neurons]), bits)
    return np.asarray(np.minimum(sparse, dense))


def index_bits(neurons: int) -> int:
    """What names one of so many neurons in a sparse list."""
    needed = math.ceil(math.log2(neurons)) if neurons > 1 else 0
    return next((bits for bits in _INDEX_BITS if bits >= needed), needed)


def _words(bits: Counts | int) -> Counts:
    return np.asarray(-(-np.asarray(bits) // _WORD) * _WORD)


@dataclass(frozen=True)
class Load:
    """What one core of a division holds, where it is fullest.

    memory: synaptic memory [bit], or None where the chip's is not known.
    axons_in: different sources, the always-on axon of biases among them.
    """

    memory: int | None
    axons_in: int


def load(population: Population, limits: Limits, lists: int, block: int) -> Load:
    """What the fullest core holds when a core takes `block` neurons."""
    each = [_load(projection, limits, lists, block) for projection in population.presynaptic]
    memory = None if limits.memory is None else sum(found.memory or 0 for found in each)
    axons = sum(found.axons_in for found in each)
    if limits.input_cores and population.biased:
        axons += 1
        if memory is not None and limits.memory is not None:
            ones = np.array([[block]])
            memory += int(list_bits(ones, block, limits.memory, delayed=False)[0])
    return Load(memory, axons)


def _load(projection: Projection, limits: Limits, lists: int, block: int) -> Load:
    fan = projection.fan
    if fan.weight is None:
        return _estimated(projection, limits, block)
    counts = fan.in_blocks(block, lists)
    axons = int(np.count_nonzero(sum(counts), axis=0).max())
    if limits.memory is None:
        return Load(None, axons)
    bits = sum(list_bits(count, block, limits.memory, fan.delayed) for count in counts)
    return Load(int(np.max(bits)), axons)


def _estimated(projection: Projection, limits: Limits, block: int) -> Load:
    """Where synapses are not listed: as many sources as they could have, each with its share."""
    fan = projection.fan
    synapses = block * int(fan.into.max())
    axons = min(synapses, fan.out.size)
    if limits.memory is None or not axons:
        return Load(None if limits.memory is None else 0, axons)
    each = np.full((axons, 1), -(-synapses // axons))
    return Load(int(list_bits(each, block, limits.memory, fan.delayed)[0]), axons)


@dataclass(frozen=True)
class Entries:
    """What a layer takes of the memories of its core."""

    kernel: int
    neurons: int

    def fit(self, core: LayerCore) -> bool:
        """Whether the core holds it."""
        return self.kernel <= core.kernel and self.neurons <= core.neurons


def entries(graph: nir.NIRGraph, population: Population) -> Entries:
    """The entries of a population, with the kernels of all that projects onto it."""
    features, *space = population.shape
    kernel = sum(_kernel(graph, projection.fan.maps) for projection in population.presynaptic)
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
