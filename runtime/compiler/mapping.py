"""The mapping of a network onto the cores of a chip.

Populations take cores one after another, each its own. A population that is too large for a core
is divided into blocks of neighbouring neurons, as large as each other but for the last; of all
divisions that fit it takes the one into the fewest cores. Utilisation is the share of a resource
that is used.

Loihi's synapses lie in words of 64 bits: the synapses of an axon in blocks of up to 64, each block
with 10 bits of its own and rounded up to whole words (nengo-loihi 1.1.0, bits_per_axon). A sparse
list names the neuron of each synapse, a dense one stores every weight of the core, zeros included.

Where each core computes a layer (Speck), memories have entries, and every layer takes a core. A
layer with a kernel of c channels, f features and kx ky taps takes c 2^(ceil(log2 kx ky) +
ceil(log2 f)) entries of kernel memory, its f maps of y x neurons f 2^(ceil(log2 y) + ceil(log2 x))
of neuron memory (sinabs 3.1.3, source read). A linear map behind a Flatten is a kernel as large as
what is flattened. A core knows one extent of a kernel: one that is not square takes the square that
holds it.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import Chip, LayerCore, Limits, SynapticMemory
from spikedeploy.runtime.compiler.lowering import Lowering, Population, Projection
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE

Counts: TypeAlias = NDArray[np.int64]

_WORD = 64  # [bit]
_BLOCK = 64  # synapses
_OVERHEAD = 10  # [bit] of a block
_INDEX_BITS = (6, 7, 8, 9, 10, 11, 12)
_DELAY_BITS = 6


@dataclass(frozen=True)
class Placement:
    """A population, an input or the bias on its cores.

    name: of the node.
    kind: "input", "neurons" or "bias".
    neurons: all of them.
    synapses: that reach it.
    fan_in, fan_out: the most of a neuron.
    cores: it takes; 0 where the chip has none.
    first: the number of its first core, from 0; None where it has none.
    block: neurons of its fullest core, or entries of a neuron memory.
    memory: synaptic memory of its fullest core, as in Load, or entries of a kernel memory.
    axons_in: of its fullest core, as in Load.
    axons_out: of its fullest core.
    estimated: whether memory and axons are estimates, because the synapses are not listed.
    """

    name: str
    kind: str
    neurons: int
    fan_out: int
    block: int
    synapses: int = 0
    fan_in: int = 0
    cores: int = 0
    first: int | None = None
    memory: int | None = None
    axons_in: int = 0
    axons_out: int = 0
    estimated: bool = False


@dataclass(frozen=True)
class CoreMapping:
    """A network on the cores of a chip.

    placements: inputs, populations and bias.
    cores: all of them; None where the chip has none.
    chips: as many as hold the cores; None where that is not known.
    """

    placements: tuple[Placement, ...]
    cores: int | None
    chips: int | None

    @cached_property
    def of_neurons(self) -> dict[str, Placement]:
        """The placement of each population."""
        return {each.name: each for each in self.placements if each.kind == "neurons"}


def map_to_cores(network: Lowering, chip: Chip) -> CoreMapping:
    """The network on the chip; where a population does not fit, its smallest division."""
    limits, populations = chip.limits, network.populations
    if limits is not None and limits.layer_cores:
        return _one_core_each(network, limits)
    if limits is None or (limits.neurons_per_core is None and limits.memory is None):
        return CoreMapping(tuple(_unplaced(network, p) for p in populations), None, None)

    lists = chip.arithmetic.weight_lists
    loads = {p.name: Loads(p, limits, lists) for p in populations}
    blocks = _divide(network, limits, loads)
    cores = {p.name: -(-p.size // blocks[p.name]) for p in populations}
    placements = [
        replace(
            _unplaced(network, p),
            cores=cores[p.name],
            block=block,
            **loads[p.name].find_fullest(block)._asdict(),
            axons_out=block * _target_cores(network, p.name, cores),
            estimated=any(projection.weight is None for projection in p.presynaptic),
        )
        for p, block in zip(populations, blocks.values(), strict=True)
    ]
    if limits.input_cores:
        inputs, found = len(network.inputs), list(_inputs(network, limits, cores))
        placements = [*found[:inputs], *placements, *found[inputs:]]
    first, numbered = 0, []
    for placement in placements:
        numbered.append(replace(placement, first=first))
        first += placement.cores
    return CoreMapping(tuple(numbered), first, limits.cores and -(-first // limits.cores))


def _unplaced(network: Lowering, population: Population) -> Placement:
    """A population on a chip without cores that are known."""
    return Placement(
        name=population.name,
        kind="neurons",
        neurons=population.size,
        synapses=population.synapses,
        fan_in=population.fan_in,
        fan_out=int(network.fan_out(population.name).max()),
        block=population.size,
        axons_in=sum(projection.out.size for projection in population.presynaptic),
        estimated=any(projection.estimated for projection in population.presynaptic),
    )


def _source(
    name: str, kind: str, neurons: int, cores: int, targets: int, fan_out: int
) -> Placement:
    """Place neurons without synapses on some cores, with axons to some others."""
    block = -(-neurons // cores)
    axons = block * targets
    return Placement(name, kind, neurons, fan_out, block, cores=cores, memory=0, axons_out=axons)


def _inputs(network: Lowering, limits: Limits, cores: Mapping[str, int]) -> Iterator[Placement]:
    """Neurons that hand on the spikes of the inputs, and the one of the bias."""
    for name, width in network.inputs.items():
        targets = _target_cores(network, name, cores)
        most = limits.neurons_per_core or width
        if limits.axons_out is not None and targets:
            most = max(min(most, limits.axons_out // targets), 1)
        fan_out = int(network.fan_out(name).max())
        yield _source(name, "input", width, -(-width // most), targets, fan_out)
    # the one neuron that spikes in every timestep, if any layer has a bias
    if biased := [p for p in network.populations if p.biased]:
        targets = sum(cores[p.name] for p in biased)
        yield _source("bias", "bias", 1, 1, targets, sum(p.size for p in biased))


# the division of populations into blocks


def _divide(network: Lowering, limits: Limits, loads: Mapping[str, "Loads"]) -> dict[str, int]:
    """Choose the block of each population, given the target cores that a core can reach."""
    blocks = {p.name: p.size for p in network.populations}
    cores = dict.fromkeys(blocks, 1)
    for _ in range(len(blocks) + 2):
        before = dict(blocks)
        for population in reversed(network.populations):
            name, targets = population.name, _target_cores(network, population.name, cores)
            blocks[name] = _block(population, limits, loads[name], targets)
            cores[name] = -(-population.size // blocks[name])
        if blocks == before:
            break
    return blocks


def _target_cores(network: Lowering, name: str, cores: Mapping[str, int]) -> int:
    """Cores that a neuron of a population, or an input, projects to; at most its synapses."""
    synapses: dict[str, int] = {}
    for projection in network.leaving.get(name, ()):
        most = int(projection.out.max())
        synapses[projection.target] = synapses.get(projection.target, 0) + most
    return sum(min(cores[target], most) for target, most in synapses.items())


def _block(population: Population, limits: Limits, loads: "Loads", targets: int) -> int:
    """Return the neurons of a core for which the fewest cores are used; 1 where nothing fits."""
    most = min(population.size, limits.neurons_per_core or population.size)
    if limits.axons_out is not None and targets:
        most = min(most, limits.axons_out // targets)
    low, high = 0, most  # a block of low neurons fits, one of high + 1 does not
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if loads.fit(middle) else (low, middle - 1)
    if not low:
        return 1
    # the registers of a core hold so many decays and thresholds
    registers = ((population.decays, limits.decays), (population.thresholds, limits.thresholds))
    cores = max(-(-population.size // low), *(-(-n // m) for n, m in registers if m is not None), 1)
    even = -(-population.size // cores)
    return even if loads.fit(even) else min(low, even)


# what synapses take of the memory of a core


class Load(NamedTuple):
    """Load of one core of a division, where it is fullest.

    memory: synaptic memory [bit], or None where the chip's is not known.
    axons_in: different sources, the always-on axon of biases among them.
    """

    memory: int | None
    axons_in: int


class Loads:
    """Loads of a population's cores, by the neurons that a core takes.

    limits: of the chip.
    lists: that hold the weights of an axon; 2 where each sign has its own.
    """

    def __init__(self, population: Population, limits: Limits, lists: int) -> None:
        self._limits, self._lists = limits, lists
        self._projections = population.presynaptic
        self._biased = limits.input_cores and population.biased
        self._found: dict[int, Load] = {}

    def find_fullest(self, block: int) -> Load:
        """Load of the fullest core when a core takes `block` neurons."""
        if block not in self._found:
            self._found[block] = self._load(block)
        return self._found[block]

    def fit(self, block: int) -> bool:
        """True if a core has room for so many neurons."""
        (memory, axons), limits = self.find_fullest(block), self._limits
        roomy = limits.memory is None or memory is None or memory <= limits.memory.size
        return roomy and (limits.axons_in is None or axons <= limits.axons_in)

    def _load(self, block: int) -> Load:
        axons, bits, memory = int(self._biased), 0, self._limits.memory
        for projection in self._projections:
            counts = _count_in_blocks(projection, block, self._lists)
            axons += int(np.count_nonzero(sum(counts), axis=0).max())
            if memory is not None:
                found = sum(list_bits(each, block, memory, projection.delayed) for each in counts)
                bits += int(np.max(found))
        if memory is None:
            return Load(None, axons)
        if self._biased:
            bits += int(list_bits(np.array([[block]]), block, memory, delayed=False)[0])
        return Load(bits, axons)


def _count_in_blocks(projection: Projection, block: int, lists: int) -> list[Counts]:
    """(M, k) synapses of each source in each block of targets; of 2 lists, one for each sign.

    Where synapses are not listed an estimate, (M, 1): as many sources as they could have, each
    with its share.
    """
    if projection.weight is None:
        synapses = block * int(projection.into.max())
        axons = min(synapses, projection.out.size)
        return [np.full((axons, 1), -(-synapses // max(axons, 1)))]
    starts, weight = np.arange(0, projection.into.size, block), projection.weight
    signs = [weight > 0, weight < 0] if lists == 2 else [weight != 0]
    return [np.add.reduceat(each, starts, axis=1, dtype=np.int64) for each in signs]


def list_bits(counts: Counts, neurons: int, memory: SynapticMemory, delayed: bool) -> Counts:
    """Size of one list in each of k cores [bit].

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


def axon_bits(synapses: Counts, bits: int) -> Counts:
    """Size of an axon of so many synapses of so many bits, in whole words [bit]."""
    blocks, rest = np.divmod(synapses, _BLOCK)
    full = _words(_BLOCK * bits + _OVERHEAD)
    return np.asarray(blocks * full + np.where(rest, _words(rest * bits + _OVERHEAD), 0))


def index_bits(neurons: int) -> int:
    """Bits that name one of so many neurons in a sparse list."""
    needed = math.ceil(math.log2(neurons)) if neurons > 1 else 0
    return next((bits for bits in _INDEX_BITS if bits >= needed), needed)


def _words(bits: Counts | int) -> Counts:
    return np.asarray(-(-np.asarray(bits) // _WORD) * _WORD)


# layers that take a core each


class Entries(NamedTuple):
    """Memory that a layer takes of its core."""

    kernel: int
    neurons: int


def _one_core_each(network: Lowering, limits: Limits) -> CoreMapping:
    """A core for each layer; without numbers where they do not all find one."""
    taken = [entries(network.graph, population) for population in network.populations]
    cores = assign(taken, limits.layer_cores)
    placements = tuple(
        replace(
            _unplaced(network, population),
            cores=1,
            first=None if cores is None else cores[place],
            block=taken[place].neurons,
            memory=taken[place].kernel,
        )
        for place, population in enumerate(network.populations)
    )
    return CoreMapping(placements, len(placements), None if cores is None else 1)


def assign(layers: Sequence[Entries], cores: Sequence[LayerCore]) -> Mapping[int, int] | None:
    """A core of its own for each layer, the first that serve; None where there are too few."""
    holds: dict[int, int] = {}
    if not all(_assign_one(layer, layers, cores, holds, set()) for layer in range(len(layers))):
        return None
    return {layer: core for core, layer in holds.items()}


def _assign_one(
    layer: int,
    layers: Sequence[Entries],
    cores: Sequence[LayerCore],
    holds: dict[int, int],
    tried: set[int],
) -> bool:
    """Give the layer a free core, or one whose layer can move on to another."""
    kernel, neurons = layers[layer]
    fitting = [
        n for n, core in enumerate(cores) if kernel <= core.kernel and neurons <= core.neurons
    ]
    for core in sorted(fitting, key=lambda each: each in holds):
        if core in tried:
            continue
        tried.add(core)
        if core not in holds or _assign_one(holds[core], layers, cores, holds, tried):
            holds[core] = layer
            return True
    return False


def entries(graph: nir.NIRGraph, population: Population) -> Entries:
    """The entries of a population, with the kernels of all that projects onto it."""
    features, *space = population.shape
    kernel = sum(_kernel_entries(graph, each.maps) for each in population.presynaptic)
    return Entries(kernel, features * 2 ** sum(_log2(extent) for extent in space))


def _kernel_entries(graph: nir.NIRGraph, maps: Sequence[str]) -> int:
    total, flattened = 0, None
    for node in (graph.nodes[name] for name in maps):
        if isinstance(node, nir.Flatten):
            flattened = [int(n) for n in node.input_type["input"]]
            continue
        if isinstance(node, CONVOLUTIONS):
            features, channels, *space = (int(n) for n in node.weight.shape)
            channels *= int(node.groups)
        elif isinstance(node, DENSE):
            features = int(node.weight.shape[-2])
            channels, *space = flattened or [int(node.weight.shape[-1])]
        else:
            continue
        # the square that holds the kernel; a linear map without maps is a kernel of 1 x 1
        taps = max(space, default=1) ** 2
        total += channels * 2 ** (_log2(taps) + _log2(features))
    return total


def _log2(number: int) -> int:
    return (number - 1).bit_length()


# shares of what there is


# of neurons, memory, axons_in and axons_out, of 1; None where the chip has no such limit
Shares: TypeAlias = dict[str, float | None]


def placement_utilisation(placement: Placement, limits: Limits) -> Shares:
    """The shares of the fullest core of a layer that are taken."""
    if not limits.layer_cores or placement.first is None:
        return mapping_utilisation([replace(placement, cores=1, neurons=placement.block)], limits)
    core = limits.layer_cores[placement.first]
    memory, neurons = (placement.memory or 0) / core.kernel, placement.block / core.neurons
    return {"neurons": neurons, "memory": memory, "axons_in": None, "axons_out": None}


def mapping_utilisation(placed: Sequence[Placement], limits: Limits) -> Shares:
    """The shares of all cores that are taken; each core counts as the fullest of its layer."""
    cores = sum(placement.cores for placement in placed)

    def share(taken: int, most: int | None) -> float | None:
        return taken / (most * cores) if most and cores else None

    memory = None if limits.memory is None else limits.memory.size
    return {
        "neurons": share(sum(p.neurons for p in placed), limits.neurons_per_core),
        "memory": share(sum((p.memory or 0) * p.cores for p in placed), memory),
        "axons_in": share(sum(p.axons_in * p.cores for p in placed), limits.axons_in),
        "axons_out": share(sum(p.axons_out * p.cores for p in placed), limits.axons_out),
    }
