"""The mapping of a network onto the cores of a chip.

Populations take cores one after another, each its own. A population that is too large for a core
is divided into blocks of neighbouring neurons, as large as each other but for the last; of all
divisions that fit it takes the one into the fewest cores. Utilisation is what is taken of what
there is.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TypeAlias

import nir

from spikedeploy.runtime.chips.chip import Chip, Limits
from spikedeploy.runtime.design_rules.core_memory import Load, assigned, entries, load
from spikedeploy.runtime.design_rules.topology import Population, Topology

Weigh: TypeAlias = Callable[[Population, int], Load]


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
    synapses: int
    fan_in: int
    fan_out: int
    cores: int
    first: int | None
    block: int
    memory: int | None
    axons_in: int
    axons_out: int
    estimated: bool


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


def mapping(network: Topology, chip: Chip, graph: nir.NIRGraph) -> CoreMapping:
    """The network on the chip; where a population does not fit, its smallest division."""
    limits = chip.limits
    if limits is not None and limits.layer_cores:
        return _by_layers(network, graph, limits)
    if limits is None or (limits.neurons_per_core is None and limits.memory is None):
        return CoreMapping(tuple(_uncored(network, p) for p in network.populations), None, None)

    @cache
    def weigh(population: Population, block: int) -> Load:
        return load(population, limits, chip.arithmetic.weight_lists, block)

    blocks = _divided(network, limits, weigh)
    cores = {p.name: -(-p.size // blocks[p.name]) for p in network.populations}
    placements = [
        _placed(network, p, blocks[p.name], weigh(p, blocks[p.name]), cores)
        for p in network.populations
    ]
    if limits.input_cores:
        placements = [*_inputs(network, limits, cores), *placements, *_bias(network, cores)]
    total = sum(placement.cores for placement in placements)
    chips = None if limits.cores is None else -(-total // limits.cores)
    return CoreMapping(tuple(_numbered(placements)), total, chips)


def _numbered(placements: Iterable[Placement]) -> Iterator[Placement]:
    """The placements with their first cores, one behind the other."""
    first = 0
    for placement in placements:
        yield replace(placement, first=first)
        first += placement.cores


def _by_layers(network: Topology, graph: nir.NIRGraph, limits: Limits) -> CoreMapping:
    """A core for each layer; without numbers where they do not all find one."""
    taken = [entries(graph, population) for population in network.populations]
    cores = assigned(taken, limits.layer_cores)
    placements = tuple(
        replace(
            _uncored(network, population),
            cores=1,
            first=None if cores is None else cores[place],
            block=taken[place].neurons,
            memory=taken[place].kernel,
        )
        for place, population in enumerate(network.populations)
    )
    return CoreMapping(placements, len(placements), None if cores is None else 1)


def _divided(network: Topology, limits: Limits, weigh: Weigh) -> dict[str, int]:
    """The block of each population; a core has axons for so many target cores of its neurons."""
    blocks = {p.name: p.size for p in network.populations}
    cores = dict.fromkeys(blocks, 1)
    for _ in range(len(blocks) + 2):
        before = dict(blocks)
        for population in reversed(network.populations):
            targets = _target_cores(network, population.name, cores)
            blocks[population.name] = _block(population, limits, weigh, targets)
            cores[population.name] = -(-population.size // blocks[population.name])
        if blocks == before:
            break
    return blocks


def _target_cores(network: Topology, name: str, cores: dict[str, int]) -> int:
    """Cores that a neuron of a population, or an input, projects to; at most its synapses."""
    synapses: dict[str, int] = {}
    for projection in network.leaving(name):
        most = int(projection.fan.out.max())
        synapses[projection.target] = synapses.get(projection.target, 0) + most
    return sum(min(cores[target], most) for target, most in synapses.items())


def _block(population: Population, limits: Limits, weigh: Weigh, targets: int) -> int:
    """Neurons of a core when it takes the fewest cores; 1 where nothing fits."""
    most = min(population.size, limits.neurons_per_core or population.size)
    if limits.axons_out is not None and targets:
        most = min(most, limits.axons_out // targets)
    low, high = 0, most  # a block of low neurons fits, one of high + 1 does not
    while low < high:
        middle = (low + high + 1) // 2
        fits = _fits(weigh(population, middle), limits)
        low, high = (middle, high) if fits else (low, middle - 1)
    if not low:
        return 1
    cores = max(-(-population.size // low), _configured(population, limits))
    even = -(-population.size // cores)
    return even if _fits(weigh(population, even), limits) else min(low, even)


def _configured(population: Population, limits: Limits) -> int:
    """The fewest cores whose registers hold all its decays and thresholds."""
    pairs = ((population.decays, limits.decays), (population.thresholds, limits.thresholds))
    return max(1 if limit is None else -(-found // limit) for found, limit in pairs)


def _fits(found: Load, limits: Limits) -> bool:
    memory = limits.memory is None or found.memory is None or found.memory <= limits.memory.size
    return memory and (limits.axons_in is None or found.axons_in <= limits.axons_in)


def _placed(
    network: Topology, population: Population, block: int, found: Load, cores: dict[str, int]
) -> Placement:
    return replace(
        _uncored(network, population),
        cores=cores[population.name],
        block=block,
        memory=found.memory,
        axons_in=found.axons_in,
        axons_out=block * _target_cores(network, population.name, cores),
        estimated=any(projection.fan.weight is None for projection in population.presynaptic),
    )


def _uncored(network: Topology, population: Population) -> Placement:
    """A population on a chip without cores that are known."""
    return Placement(
        name=population.name,
        kind="neurons",
        neurons=population.size,
        synapses=population.synapses,
        fan_in=population.fan_in,
        fan_out=_fan_out(network, population.name),
        cores=0,
        first=None,
        block=population.size,
        memory=None,
        axons_in=sum(projection.fan.out.size for projection in population.presynaptic),
        axons_out=0,
        estimated=any(projection.fan.most for projection in population.presynaptic),
    )


def _fan_out(network: Topology, name: str) -> int:
    return int(network.fan_out(name).max())


def _inputs(network: Topology, limits: Limits, cores: dict[str, int]) -> Iterator[Placement]:
    """Neurons that hand on the spikes of the inputs."""
    for name, width in network.inputs.items():
        targets = _target_cores(network, name, cores)
        most = limits.neurons_per_core or width
        if limits.axons_out is not None and targets:
            most = max(min(most, limits.axons_out // targets), 1)
        taken = -(-width // most)
        block = -(-width // taken)
        yield _source(name, "input", width, taken, block, targets, _fan_out(network, name))


def _bias(network: Topology, cores: dict[str, int]) -> Iterator[Placement]:
    """The one neuron that spikes in every timestep, if any layer has a bias."""
    biased = [p for p in network.populations if p.biased]
    if biased:
        targets = sum(cores[p.name] for p in biased)
        yield _source("bias", "bias", 1, 1, 1, targets, sum(p.size for p in biased))


def _source(
    name: str, kind: str, neurons: int, cores: int, block: int, targets: int, fan_out: int
) -> Placement:
    axons = block * targets
    return Placement(name, kind, neurons, 0, 0, fan_out, cores, None, block, 0, 0, axons, False)


@dataclass(frozen=True)
class _Utilisation:
    """Shares of 1; None where the chip has no such limit.

    neurons: of the cores that are taken.
    memory: of their synaptic memory, each counted as the fullest of its layer.
    axons_in, axons_out: likewise.
    """

    neurons: float | None
    memory: float | None
    axons_in: float | None
    axons_out: float | None


def of_placement(placement: Placement, limits: Limits) -> _Utilisation:
    """Of the fullest core of a layer."""
    if limits.layer_cores and placement.first is not None:
        core = limits.layer_cores[placement.first]
        memory = (placement.memory or 0) / core.kernel
        return _Utilisation(placement.block / core.neurons, memory, None, None)
    return _shares([(1, placement)], limits, [placement.block])


def of_mapping(mapping: CoreMapping, limits: Limits) -> _Utilisation:
    """Of all cores that are taken."""
    placed = [(placement.cores, placement) for placement in mapping.placements]
    return _shares(placed, limits, [placement.neurons for placement in mapping.placements])


def _shares(
    placed: list[tuple[int, Placement]], limits: Limits, neurons: Iterable[int]
) -> _Utilisation:
    cores = sum(number for number, _ in placed)
    size = None if limits.memory is None else limits.memory.size

    def share(each: Iterable[int | None], most: int | None) -> float | None:
        total = sum(found or 0 for found in each)
        return total / (most * cores) if most and cores else None

    return _Utilisation(
        neurons=share(neurons, limits.neurons_per_core),
        memory=share(((p.memory or 0) * number for number, p in placed), size),
        axons_in=share((p.axons_in * number for number, p in placed), limits.axons_in),
        axons_out=share((p.axons_out * number for number, p in placed), limits.axons_out),
    )
