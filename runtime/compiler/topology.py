"""The topology of a graph: its populations, and how many synapses lead from each to each.

Any sound graph has one, so that every node of a network that fits nowhere can still be told why: of
the synapses it has a map of each projection, which counts what leaves each source and reaches each
target, and is a matrix only where the graph has one.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias, TypeVar

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.chains import window_of_map
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.neurons import NEURONS, SPIKING
from spikedeploy.runtime.graph.order import Edge, in_waves, neighbours, order, reach, sources
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE, POOLS, shape_of

Counts: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]
_K = TypeVar("_K")
_V = TypeVar("_V")

BIASED = (nir.Affine, *CONVOLUTIONS)
_POPULATIONS = (*NEURONS, nir.Threshold)
_MAPS = (*DENSE, *CONVOLUTIONS, *POOLS)

# ways to nodes without spikes, and the nodes on them: following more takes seconds
_MAX_WAYS = 1 << 16


@dataclass(frozen=True, eq=False)
class Projection:
    """All synapses that come from M sources to N targets by one way.

    source, target: names of an input or population, and of a population.
    out: (M,) synapses of each source.
    into: (N,) of each target.
    weight: (M, N) where they are listed; None where they are not (convolutions), or no longer.
    largest: greatest magnitude among their weights.
    biased: whether a map between them adds something in every timestep.
    delayed: whether a Delay is between them.
    late: whether the way closes a loop.
    most: whether the counts are the most that it can be: two maps in a row, whose product is not
        made.
    maps: names of the nodes between them that have a fan or flatten.
    """

    source: str
    target: str
    out: Counts
    into: Counts
    weight: Floats | None = None
    largest: float = 1.0
    biased: bool = False
    delayed: bool = False
    late: bool = False
    most: bool = False
    maps: tuple[str, ...] = ()

    @property
    def is_one_to_one(self) -> bool:
        """True while no map with a fan of its own is between them."""
        same = self.weight is None and not self.most and self.out.size == self.into.size
        return same and bool((self.out == 1).all() and (self.into == 1).all())

    def in_blocks(self, block: int, lists: int) -> list[Counts]:
        """(M, k) synapses of each source in each block of targets; of 2 lists, one for each sign.

        Where synapses are not listed an estimate, (M, 1): as many sources as they could have, each
        with its share.
        """
        if self.weight is None:
            synapses = block * int(self.into.max())
            axons = min(synapses, self.out.size)
            return [np.full((axons, 1), -(-synapses // max(axons, 1)))]
        starts = np.arange(0, self.into.size, block)
        ends = np.minimum(starts + block, self.into.size)
        counts = [
            np.subtract(before[ends], before[starts], dtype=np.int64).T for before in self._before
        ]
        return counts if lists == 2 else [counts[0] + counts[1]]

    @cached_property
    def _before(self) -> NDArray[np.int32]:
        """(2, N + 1, M) positive and negative synapses onto the targets before each.

        Added up once, because a mapping tries many blocks.
        """
        before = np.zeros((2, self.into.size + 1, self.out.size), np.int32)
        if self.weight is not None:
            np.cumsum(self.weight.T > 0, axis=0, out=before[0, 1:])
            np.cumsum(self.weight.T < 0, axis=0, out=before[1, 1:])
        return before


def _merge(ways: Sequence[Projection]) -> Projection:
    first, *others = ways
    if not others:
        return first
    return replace(
        first,
        out=np.minimum(np.sum([way.out for way in ways], axis=0), first.into.size),
        into=np.minimum(np.sum([way.into for way in ways], axis=0), first.out.size),
        weight=None,
        largest=sum(way.largest for way in ways),
        biased=any(way.biased for way in ways),
        delayed=any(way.delayed for way in ways),
        late=any(way.late for way in ways),
        most=True,
        maps=tuple(dict.fromkeys(name for way in ways for name in way.maps)),
    )


def _extend(way: Projection, name: str, node: nir.NIRNode) -> Projection:
    if isinstance(node, nir.Delay):
        return replace(way, delayed=way.delayed or bool(node.delay.any()))
    if isinstance(node, nir.Scale):
        return replace(way, largest=way.largest * float(np.abs(node.scale).max()))
    if isinstance(node, (*_MAPS, nir.Flatten)):
        way = replace(way, maps=(*way.maps, name))
    if not isinstance(node, _MAPS):
        return way
    out, into, weight, most = _fans(name, node)
    own = 1.0 if isinstance(node, POOLS) else float(np.abs(node.weight).max())
    biased = isinstance(node, BIASED) and bool(node.bias.any())
    if way.is_one_to_one:
        largest = way.largest * own
        return replace(
            way, out=out, into=into, weight=weight, largest=largest, biased=biased, most=most
        )
    return replace(
        way,
        out=np.minimum(way.out * out.max(), into.size),
        into=np.minimum(into * way.into.max(), way.out.size),
        weight=None,
        largest=way.largest * own * float(way.into.max()),
        biased=way.biased or biased,
        most=True,
    )


def _fans(name: str, node: nir.NIRNode) -> tuple[Counts, Counts, Floats | None, bool]:
    """Of one map: `out`, `into`, `weight` and `most`, as in Projection."""
    if isinstance(node, (*CONVOLUTIONS, *POOLS)):
        window = window_of_map(name, node)
        # zeros of a kernel are synapses
        each = node.weight.shape[1] if isinstance(node, CONVOLUTIONS) else 1
        all_ = np.ones((window.target[0], each, *window.kernel), np.int64)
        return window.fan_out(all_), window.over_axons(all_, np.add), None, False
    # (..., N, M): of a stack of maps, each has its own part
    out, into = (np.count_nonzero(node.weight, axis=axis).ravel() for axis in (-2, -1))
    listed = node.weight.ndim == 2
    return out, into, node.weight.T if listed else None, not listed


@dataclass(frozen=True, eq=False)
class Population:
    """Neurons of one node.

    name: of the node.
    shape: of the node.
    presynaptic: the projections onto it.
    leaves: whether its spikes or membranes leave the chip.
    decays: different sets of time constants among its neurons.
    thresholds: different thresholds among them.
    """

    name: str
    shape: tuple[int, ...]
    presynaptic: tuple[Projection, ...]
    leaves: bool
    decays: int
    thresholds: int

    @property
    def size(self) -> int:
        """Neurons, N."""
        return math.prod(self.shape)

    @property
    def biased(self) -> bool:
        """True if a map adds something to it in every timestep."""
        return any(projection.biased for projection in self.presynaptic)

    @property
    def fan_in(self) -> int:
        """Synapses of the neuron that has most; no more than that, where ways are many."""
        return sum(int(projection.into.max()) for projection in self.presynaptic)

    @property
    def synapses(self) -> int:
        """All that reach it."""
        return sum(int(projection.into.sum()) for projection in self.presynaptic)

    @property
    def recurrent(self) -> bool:
        """True if a loop closes here."""
        return any(projection.late for projection in self.presynaptic)


@dataclass(frozen=True, eq=False)
class Topology:
    """The populations of a graph.

    graph: that they are of.
    inputs: M of each input.
    populations: in an order in which those that close no loop come after their sources.
    host: names of the maps behind the last neurons, which the host computes, and of the neurons
        that it integrates.
    """

    graph: nir.NIRGraph
    inputs: dict[str, int]
    populations: tuple[Population, ...]
    host: tuple[str, ...]

    def leaving(self, name: str) -> list[Projection]:
        """The projections that start in an input or population."""
        return self._leaving.get(name, [])

    @cached_property
    def _leaving(self) -> dict[str, list[Projection]]:
        found: dict[str, list[Projection]] = {}
        for projection in (c for p in self.populations for c in p.presynaptic):
            found.setdefault(projection.source, []).append(projection)
        return found

    def fan_out(self, name: str, targets: Collection[str] | None = None) -> Counts:
        """(M,) synapses that each spike of an input or population reaches, in these targets."""
        found = self.leaving(name)
        out = [c.out for c in found if targets is None or c.target in targets]
        return np.sum(out, axis=0) if out else np.zeros(1, np.int64)


def topology(graph: nir.NIRGraph, membranes: bool = True, graded: Collection[str] = ()) -> Topology:
    """The topology of a sound, flat graph.

    membranes: whether they can leave the chip; else the host integrates neurons without a
        threshold that only outputs are reached from.
    graded: names of nodes without a threshold that spike all the same.
    """
    kinds = _POPULATIONS if membranes else (*SPIKING, nir.Threshold)
    on_chip = {n for n, node in graph.nodes.items() if isinstance(node, kinds) or n in graded}
    ports_ = graph.inputs.keys() | graph.outputs.keys()
    last = graph.nodes.keys() - reach(on_chip, sources(graph)) - ports_
    # from the outputs backwards: the host computes no loop, and nothing that leads into one
    host = {*in_waves(last, ((target, source) for source, target in graph.edges))}
    ahead, behind = neighbours(graph.edges), host | graph.outputs.keys()
    return Topology(
        graph=graph,
        inputs={name: math.prod(shape_of(node)) for name, node in sorted(graph.inputs.items())},
        populations=tuple(
            Population(
                name=name,
                shape=shape_of(graph.nodes[name]),
                presynaptic=presynaptic,
                leaves=not behind.isdisjoint(ahead.get(name, ())),
                decays=_different(graph.nodes[name], ("tau", "tau_syn", "tau_mem")),
                thresholds=_different(graph.nodes[name], ("v_threshold", "threshold")),
            )
            for name, presynaptic in _projections(graph).items()
            if name not in host
        ),
        host=tuple(sorted(host)),
    )


def _projections(graph: nir.NIRGraph) -> dict[str, tuple[Projection, ...]]:
    try:
        names, late = order(graph)
    except ArtifactError:  # a loop without a neuron, which a Delay may open
        into = [edge for edge in graph.edges if isinstance(graph.nodes[edge[1]], nir.Delay)]
        names, late = order(graph, into)
    before = sources(graph)
    populations = [n for n in names if isinstance(graph.nodes[n], _POPULATIONS)]
    ways: dict[str, dict[str, Projection]] = {}
    for name in (*populations, *graph.inputs):
        ones = np.broadcast_to(np.int64(1), math.prod(shape_of(graph.nodes[name])))
        ways[name] = {name: Projection(name, "", ones, ones)}
    followed = 0
    for name in (name for name in names if name not in ways):
        found = arriving(name, before, ways, late, _closing)
        followed += sum(1 + len(way.maps) for each in found.values() for way in each)
        if followed > _MAX_WAYS:
            raise ArtifactError(
                f"node {name!r}: {followed} ways lead by here from neurons over nodes without "
                f"spikes; at most {_MAX_WAYS}. Join nodes without spikes between them into one."
            )
        node = graph.nodes[name]
        ways[name] = {source: _extend(_merge(each), name, node) for source, each in found.items()}
    return {
        name: tuple(
            replace(way, target=name)
            for each in arriving(name, before, ways, late, _closing).values()
            for way in each
        )
        for name in populations
    }


def _closing(source: str, way: Projection) -> tuple[str, Projection]:
    return source, replace(way, late=True)


def _different(node: nir.NIRNode, fields: tuple[str, ...]) -> int:
    """Different sets of these parameters among the neurons of a node."""
    code = np.zeros(1, np.int64)
    for values in (np.ravel(getattr(node, field)) for field in fields if hasattr(node, field)):
        _, place = np.unique(values, return_inverse=True)
        # at most as many as there are neurons: the product fits
        _, code = np.unique(code * len(values) + place, return_inverse=True)
    return int(code.max()) + 1


def arriving(
    name: str,
    before: Mapping[str, Sequence[str]],
    put: Mapping[str, Mapping[_K, _V]],
    late: frozenset[Edge],
    delay: Callable[[_K, _V], tuple[_K, _V]],
) -> dict[_K, list[_V]]:
    """Outputs of the nodes before this one, by key; over late edges as `delay` makes them."""
    found: dict[_K, list[_V]] = {}
    for near in before[name]:
        for each in put.get(near, {}).items():
            key, value = delay(*each) if (near, name) in late else each
            found.setdefault(key, []).append(value)
    return found
