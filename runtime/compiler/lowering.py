"""Lowering: a graph as populations of neurons, and the projections between them.

It works for any valid graph, so that a report can name the obstacle at every node even if the
network fits no chip. For each projection it counts the synapses by source and by target, and names
the chain of nodes that they come from. compiler.synapses computes the weights of such chains.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.errors import ArtifactError, RuleError
from spikedeploy.runtime.graph.discretisation import NEURONS, SPIKING
from spikedeploy.runtime.graph.order import Edge, in_waves, neighbours, order, reach, sources
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE, POOLS, Shape, shape_of, window_of

Counts: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]

BIASED = (nir.Affine, *CONVOLUTIONS)
_POPULATIONS = (*NEURONS, nir.Threshold)
_MAPS = (*DENSE, *CONVOLUTIONS, *POOLS)
LINEAR = (*_MAPS, nir.Scale, nir.Flatten, nir.Delay)

# ways to nodes without spikes, and the nodes on them: following more takes seconds
_MAX_WAYS = 1 << 16


@dataclass(frozen=True, eq=False)
class Projection:
    """All synapses that come from M sources to N targets by one way.

    source, target: names of an input or population, and of a population or Output.
    out: (M,) synapses of each source.
    into: (N,) of each target.
    way: names of the nodes between them; None where several ways have joined.
    maps: names of the nodes between them that have a fan or flatten.
    weight: (M, N) where they are listed; None where they are not (convolutions), or no longer.
    largest: greatest magnitude among their weights.
    biased: whether a map between them adds something in every timestep.
    delayed: whether a Delay is between them.
    late: whether the way closes a loop.
    estimated: whether the counts are upper bounds: the product of two successive maps is not
        computed.
    """

    source: str
    target: str
    out: Counts
    into: Counts
    way: tuple[str, ...] | None = ()
    maps: tuple[str, ...] = ()
    weight: Floats | None = None
    largest: float = 1.0
    biased: bool = False
    delayed: bool = False
    late: bool = False
    estimated: bool = False

    @property
    def is_one_to_one(self) -> bool:
        """True while no map with a fan of its own is between them."""
        if self.weight is not None or self.estimated or self.out.size != self.into.size:
            return False
        return bool((self.out == 1).all() and (self.into == 1).all())


def _join(ways: Sequence[Projection]) -> Projection:
    """Merge paths from one source into one, with the most synapses that they can have."""
    first, *others = ways
    if not others:
        return first
    return replace(
        first,
        out=np.minimum(np.sum([way.out for way in ways], axis=0), first.into.size),
        into=np.minimum(np.sum([way.into for way in ways], axis=0), first.out.size),
        way=None,
        maps=tuple(dict.fromkeys(name for way in ways for name in way.maps)),
        weight=None,
        largest=sum(way.largest for way in ways),
        biased=any(way.biased for way in ways),
        delayed=any(way.delayed for way in ways),
        late=any(way.late for way in ways),
        estimated=True,
    )


def _extend(way: Projection, name: str, node: nir.NIRNode) -> Projection:
    """Return the path with one more node."""
    way = replace(way, way=way.way if way.way is None else (*way.way, name))
    if isinstance(node, nir.Delay):
        return replace(way, delayed=way.delayed or bool(node.delay.any()))
    if isinstance(node, nir.Scale):
        return replace(way, largest=way.largest * float(np.abs(node.scale).max()))
    if isinstance(node, (*_MAPS, nir.Flatten)):
        way = replace(way, maps=(*way.maps, name))
    if not isinstance(node, _MAPS):
        return way
    out, into, weight = _fans(name, node)
    own = 1.0 if isinstance(node, POOLS) else float(np.abs(node.weight).max())
    biased = way.biased or (isinstance(node, BIASED) and bool(node.bias.any()))
    if way.is_one_to_one:
        estimated = isinstance(node, DENSE) and weight is None
        largest = way.largest * own
        return replace(
            way, out=out, into=into, weight=weight, largest=largest, biased=biased,
            estimated=estimated,
        )  # fmt: skip
    return replace(
        way,
        out=np.minimum(way.out * out.max(), into.size),
        into=np.minimum(into * way.into.max(), way.out.size),
        weight=None,
        largest=way.largest * own * float(way.into.max()),
        biased=biased,
        estimated=True,
    )


def _fans(name: str, node: nir.NIRNode) -> tuple[Counts, Counts, Floats | None]:
    """Return `out`, `into` and `weight` of one map, as in Projection."""
    if not isinstance(node, DENSE):
        window = window_of_map(name, node)
        # zeros of a kernel are synapses
        each = node.weight.shape[1] if isinstance(node, CONVOLUTIONS) else 1
        ones = np.ones((window.target[0], each, *window.kernel), np.int64)
        return window.fan_out(ones), window.over_axons(ones, np.add), None
    # (..., N, M): of a stack of maps, each has its own part
    out, into = (np.count_nonzero(node.weight, axis=axis).ravel() for axis in (-2, -1))
    return out, into, node.weight.T if node.weight.ndim == 2 else None


def window_of_map(name: str, node: nir.NIRNode) -> Window:
    """The window of a convolution or pool."""
    geometry, source = window_of(name, node), in_three_axes(node.input_type["input"])

    def axes(numbers: Shape, missing: int = 1) -> tuple[int, int]:
        y, x = (missing, *numbers)[-2:]  # those of one axis are x
        return y, x

    return Window(
        source=source,
        target=in_three_axes(node.output_type["output"]),
        kernel=axes(geometry.kernel),
        stride=axes(geometry.stride),
        padding=axes(tuple(before for before, _ in geometry.padding), 0),
        dilation=axes(geometry.dilation),
        groups=int(node.groups) if isinstance(node, CONVOLUTIONS) else source[0],
    )


def in_three_axes(extents: Sequence[int] | NDArray[np.int64]) -> tuple[int, int, int]:
    """A shape of any axes as channels and two axes: (C, X) as (C, 1, X), more than three joined."""
    shape = tuple(int(n) for n in extents)
    if len(shape) < 3:
        return shape[0], 1, math.prod(shape[1:])
    return math.prod(shape[:-2]), shape[-2], shape[-1]


@dataclass(frozen=True, eq=False)
class Population:
    """Neurons of one node.

    name: of the node.
    shape: of the node.
    presynaptic: the projections onto it.
    decays: different sets of time constants among its neurons.
    thresholds: different thresholds among them.
    leaves: whether its spikes or membranes leave the chip.
    """

    name: str
    shape: tuple[int, ...]
    presynaptic: tuple[Projection, ...]
    decays: int
    thresholds: int
    leaves: bool = False

    @cached_property
    def size(self) -> int:
        """Neurons, N."""
        return math.prod(self.shape)

    @cached_property
    def biased(self) -> bool:
        """True if a map adds something to it in every timestep."""
        return any(projection.biased for projection in self.presynaptic)

    @cached_property
    def fan_in(self) -> int:
        """Largest number of synapses of a neuron; an upper bound where paths are many."""
        return sum(int(projection.into.max()) for projection in self.presynaptic)

    @cached_property
    def synapses(self) -> int:
        """Number of synapses onto it."""
        return sum(int(projection.into.sum()) for projection in self.presynaptic)

    @cached_property
    def recurrent(self) -> bool:
        """True if a loop closes here."""
        return any(projection.late for projection in self.presynaptic)


class Block(NamedTuple):
    """The nodes without spikes that lead to one target.

    target: name of a population or an Output.
    names: of the nodes, each after its sources.
    ways: name of each input and population that they, or the target, receive from -> its
        projections.
    """

    target: str
    names: tuple[str, ...]
    ways: dict[str, list[Projection]]


@dataclass(frozen=True, eq=False)
class Lowering:
    """A graph as populations and projections.

    graph: that they are of.
    inputs: M of each input.
    populations: in an order in which those that close no loop come after their sources.
    arriving: target -> the projections onto a population or Output.
    host: names of what the host of a chip computes; empty before `on_chip`.
    """

    graph: nir.NIRGraph
    inputs: dict[str, int]
    populations: tuple[Population, ...]
    arriving: dict[str, tuple[Projection, ...]]
    host: tuple[str, ...] = ()

    def on_chip(self, membranes: bool, graded: Collection[str] = ()) -> "Lowering":
        """Assign to the host the maps behind the last neurons, and the neurons that it integrates.

        membranes: whether they can leave the chip; else the host integrates neurons without a
            threshold that only outputs are reached from.
        graded: names of nodes without a threshold that spike all the same.
        """
        graph = self.graph
        kinds = _POPULATIONS if membranes else (*SPIKING, nir.Threshold)
        own = {n for n, node in graph.nodes.items() if isinstance(node, kinds) or n in graded}
        ports = graph.inputs.keys() | graph.outputs.keys()
        last = graph.nodes.keys() - reach(own, sources(graph)) - ports
        # from the outputs backwards: the host computes no loop, and nothing that leads into one
        host = {*in_waves(last, ((target, source) for source, target in graph.edges))}
        ahead, behind = neighbours(graph.edges), host | graph.outputs.keys()
        populations = tuple(
            replace(p, leaves=not behind.isdisjoint(ahead.get(p.name, ())))
            for p in self.populations
            if p.name not in host
        )
        return replace(self, populations=populations, host=tuple(sorted(host)))

    @cached_property
    def sources(self) -> dict[str, list[str]]:
        """Names of the nodes with an edge to each."""
        return sources(self.graph)

    @cached_property
    def blocks(self) -> dict[str, Block]:
        """The block before each population and Output; RuleError at a loop without a neuron."""
        linear = {
            name: [s for s in found if isinstance(self.graph.nodes[s], LINEAR)]
            for name, found in self.sources.items()
        }
        return {target: self._block(target, linear) for target in self.arriving}

    def _block(self, target: str, linear: dict[str, list[str]]) -> Block:
        inside = reach(linear[target], linear)
        names = in_waves(inside, [(s, name) for name in inside for s in linear[name]])
        if left := sorted(inside - set(names)):
            raise RuleError(
                f"rule recurrence: nodes {', '.join(left)}: a loop without a spiking node, whose "
                "values would never settle; a chip has none. Put a neuron into it, or run the "
                "graph in float."
            )
        ways: dict[str, list[Projection]] = {}
        for each in sorted(self.arriving[target], key=lambda each: each.source):
            ways.setdefault(each.source, []).append(each)
        return Block(target, tuple(names), ways)

    @cached_property
    def leaving(self) -> dict[str, list[Projection]]:
        """The projections that start in each input or population; of some there are none."""
        found: dict[str, list[Projection]] = {}
        for projection in (each for p in self.populations for each in p.presynaptic):
            found.setdefault(projection.source, []).append(projection)
        return found

    def fan_out(self, name: str, targets: Collection[str] | None = None) -> Counts:
        """(M,) synapses that each spike of an input or population reaches, in these targets."""
        found = self.leaving.get(name, ())
        out = [each.out for each in found if targets is None or each.target in targets]
        return np.sum(out, axis=0) if out else np.zeros(1, np.int64)


def lower(artifact: Artifact) -> Lowering:
    """The populations and projections of a network; ArtifactError where ways are too many."""
    graph = artifact.graph
    names, late = _order(artifact)
    before = sources(graph)
    populations = [n for n in names if isinstance(graph.nodes[n], _POPULATIONS)]
    ways: dict[str, dict[str, Projection]] = {}
    for name in (*populations, *graph.inputs):
        ones = np.broadcast_to(np.int64(1), math.prod(shape_of(graph.nodes[name])))
        ways[name] = {name: Projection(name, "", ones, ones)}

    def arriving(name: str) -> dict[str, list[Projection]]:
        found: dict[str, list[Projection]] = {}
        for near in before[name]:
            for source, way in ways.get(near, {}).items():
                closes = (near, name) in late
                found.setdefault(source, []).append(replace(way, late=True) if closes else way)
        return found

    followed, ends = 0, {}
    for name in (name for name in names if name not in ways):
        found = arriving(name)
        followed += sum(1 + len(way.maps) for each in found.values() for way in each)
        if followed > _MAX_WAYS:
            raise ArtifactError(
                f"node {name!r}: {followed} ways lead by here from neurons over nodes without "
                f"spikes; at most {_MAX_WAYS}. Join nodes without spikes between them into one."
            )
        node = graph.nodes[name]
        if isinstance(node, nir.Output):
            ends[name] = _onto(name, found)
        ways[name] = {source: _extend(_join(each), name, node) for source, each in found.items()}
    ends |= {name: _onto(name, arriving(name)) for name in populations}
    return Lowering(
        graph=graph,
        inputs={name: math.prod(shape_of(node)) for name, node in sorted(graph.inputs.items())},
        populations=tuple(
            Population(
                name=name,
                shape=shape_of(graph.nodes[name]),
                presynaptic=ends[name],
                decays=_different(graph.nodes[name], ("tau", "tau_syn", "tau_mem")),
                thresholds=_different(graph.nodes[name], ("v_threshold", "threshold")),
            )
            for name in populations
        ),
        arriving=ends,
    )


def _order(artifact: Artifact) -> tuple[tuple[str, ...], frozenset[Edge]]:
    """The order of the nodes, and the edges that close a loop."""
    graph = artifact.graph
    try:
        return order(graph) if artifact.timing.loops else (artifact.timing.names, frozenset())
    except ArtifactError:  # a loop without a neuron, which a Delay may open
        return order(graph, [e for e in graph.edges if isinstance(graph.nodes[e[1]], nir.Delay)])


def _onto(target: str, ways: dict[str, list[Projection]]) -> tuple[Projection, ...]:
    return tuple(replace(way, target=target) for each in ways.values() for way in each)


def _different(node: nir.NIRNode, fields: tuple[str, ...]) -> int:
    """Count the different sets of these parameters among the neurons of a node."""
    code = np.zeros(1, np.int64)
    for values in (np.ravel(getattr(node, field)) for field in fields if hasattr(node, field)):
        _, place = np.unique(values, return_inverse=True)
        # at most as many as there are neurons: the product fits
        _, code = np.unique(code * len(values) + place, return_inverse=True)
    return int(code.max()) + 1
