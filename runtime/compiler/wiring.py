"""The wiring of a graph: its neurons, and the synapses that the nodes between them come to.

It is known in two depths. A Topology takes any sound graph, so that every node of a network that
fits nowhere can still be told why: of the synapses it has a map of each projection, which counts
what leaves each source and reaches each target, and is a matrix only where the graph has one. A
LayerGraph is what a chip is compiled from: the synapses as matrices, one for each lag.

A chain without spikes in it is linear but for its biases. So what it does to a unit impulse of a
source is a row of its matrix, and what it does to nothing is its bias.

Neurons without a threshold are readouts: an Output alone may receive their membranes.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import HostOutput, ReadoutTerm
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError, RuleError
from spikedeploy.runtime.float_model import build_node
from spikedeploy.runtime.graph.neurons import NEURONS, SPIKING
from spikedeploy.runtime.graph.order import Edge, Timing, in_waves, order, sources, timing
from spikedeploy.runtime.graph.ports import Port, ports
from spikedeploy.runtime.graph.shapes import (
    CONVOLUTIONS,
    DENSE,
    POOLS,
    ConvWindow,
    multiplications,
    window_of,
)

Counts: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]
# what arrives how many timesteps late, (R, *shape)
Parts: TypeAlias = dict[int, Floats]

_POPULATIONS = (*NEURONS, nir.Threshold)
_MAPS = (*DENSE, *CONVOLUTIONS, *POOLS)
_BIASED = (nir.Affine, *CONVOLUTIONS)
LINEAR = (nir.Linear, *_BIASED, *POOLS, nir.Scale, nir.Flatten, nir.Delay)
_KNOWN = (nir.Input, nir.Output, *LINEAR, *NEURONS)

# ways to nodes without spikes, and the nodes on them: following more takes seconds
_MAX_WAYS = 1 << 16
# bytes of matrices beyond which a network is a mistake on a chip: 33 million weights
_MAX_BYTES = 1 << 28
# multiplications that finding a matrix may take
_MAX_WORK = 1 << 34
# edges that impulses may follow, over all targets
_MAX_VISITS = 1 << 18
# numbers that the impulses sent at once may fill, and how many are sent at most
_MAX_IMPULSE_VALUES = 1 << 22
_MAX_IMPULSES = 256


# the synapses of a projection, without their matrix


@dataclass(frozen=True, eq=False)
class SynapseMap:
    """The synapses from M sources to N targets.

    out: (M,) of each source.
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
    def synapses(self) -> int:
        """Number of synapses."""
        return int(self.into.sum())

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
        targets = self.into.size
        starts = np.arange(0, targets, block)
        ends = np.minimum(starts + block, targets)
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


def _merge(maps: Sequence[SynapseMap]) -> SynapseMap:
    """Several ways between the same sources and targets, as one."""
    if len(maps) == 1:
        return maps[0]
    sources, targets = maps[0].out.size, maps[0].into.size
    return SynapseMap(
        out=np.minimum(np.sum([each.out for each in maps], axis=0), targets),
        into=np.minimum(np.sum([each.into for each in maps], axis=0), sources),
        largest=sum(each.largest for each in maps),
        biased=any(each.biased for each in maps),
        delayed=any(each.delayed for each in maps),
        late=any(each.late for each in maps),
        most=True,
        maps=tuple(dict.fromkeys(name for each in maps for name in each.maps)),
    )


def _extend(way: SynapseMap, name: str, node: nir.NIRNode) -> SynapseMap:
    """The way with one more node at its end."""
    if isinstance(node, nir.Delay):
        return replace(way, delayed=way.delayed or bool(node.delay.any()))
    if isinstance(node, nir.Scale):
        return replace(way, largest=way.largest * float(np.abs(node.scale).max()))
    if isinstance(node, (*_MAPS, nir.Flatten)):
        way = replace(way, maps=(*way.maps, name))
    if not isinstance(node, _MAPS):
        return way
    last = _map_of(name, node)
    if way.is_one_to_one:
        largest = way.largest * last.largest
        return replace(last, largest=largest, delayed=way.delayed, late=way.late, maps=way.maps)
    return replace(
        way,
        out=np.minimum(way.out * last.out.max(), last.into.size),
        into=np.minimum(last.into * way.into.max(), way.out.size),
        weight=None,
        largest=way.largest * last.largest * float(way.into.max()),
        biased=way.biased or last.biased,
        most=True,
    )


def _map_of(name: str, node: nir.NIRNode) -> SynapseMap:
    """The synapses of one node with a fan."""
    if isinstance(node, POOLS):
        out, into = _convolved_counts(node, window_of(name, node), 1, 1)
        return SynapseMap(out, into)
    largest = float(np.abs(node.weight).max())
    biased = isinstance(node, _BIASED) and bool(node.bias.any())
    if isinstance(node, CONVOLUTIONS):
        groups = int(np.ravel(node.groups)[0])
        features, channels = len(node.weight) // groups, int(node.weight.shape[1])
        out, into = _convolved_counts(node, window_of(name, node), features, channels)
        return SynapseMap(out, into, None, largest, biased)
    listed = node.weight != 0
    if node.weight.ndim == 2:
        out, into = np.count_nonzero(listed, axis=0), np.count_nonzero(listed, axis=1)
        return SynapseMap(out, into, node.weight.T, largest, biased)
    # a stack of maps, each for its own part
    out, into = listed.sum(axis=-2).ravel(), listed.sum(axis=-1).ravel()
    return SynapseMap(out, into, None, largest, biased, most=True)


def _convolved_counts(
    node: nir.NIRNode, window: ConvWindow, features: int, channels: int
) -> tuple[Counts, Counts]:
    """Synapses of each source and target of a kernel of features x channels of its group.

    Zeros in the kernel count as synapses.
    """
    takes, puts = (
        tuple(int(n) for n in end) for end in (node.input_type["input"], node.output_type["output"])
    )
    axes = [_axis(window, axis, takes[axis + 1], puts[axis + 1]) for axis in range(len(takes) - 1)]
    used = reduce(np.multiply.outer, [count for count, _ in axes])
    seen = reduce(np.multiply.outer, [count for _, count in axes])
    out = np.broadcast_to(used * features, takes).ravel()
    return out, np.broadcast_to(seen * channels, puts).ravel()


def _axis(window: ConvWindow, axis: int, extent: int, places: int) -> tuple[Counts, Counts]:
    """Places that use each element of an axis, and elements that each place of it sees."""
    before, _ = window.padding[axis]
    kernel = np.arange(window.kernel[axis]) * window.dilation[axis] - before
    index = np.arange(places)[:, None] * window.stride[axis] + kernel
    inside = (index >= 0) & (index < extent)
    return np.bincount(index[inside], minlength=extent), inside.sum(axis=1)


# populations and their projections


@dataclass(frozen=True, eq=False)
class Projection:
    """All synapses of a population that come from one source by one way."""

    source: str
    target: str
    map: SynapseMap


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
        return any(projection.map.biased for projection in self.presynaptic)

    @property
    def fan_in(self) -> int:
        """Synapses of the neuron that has most; no more than that, where ways are many."""
        return sum(int(projection.map.into.max()) for projection in self.presynaptic)

    @property
    def synapses(self) -> int:
        """All that reach it."""
        return sum(projection.map.synapses for projection in self.presynaptic)

    @property
    def recurrent(self) -> bool:
        """True if a loop closes here."""
        return any(projection.map.late for projection in self.presynaptic)


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
        out = [c.map.out for c in found if targets is None or c.target in targets]
        return np.sum(out, axis=0) if out else np.zeros(1, np.int64)


def topology(graph: nir.NIRGraph, membranes: bool = True, graded: Collection[str] = ()) -> Topology:
    """The topology of a sound, flat graph.

    membranes: whether they can leave the chip; else the host integrates neurons without a
        threshold that only outputs are reached from.
    graded: names of nodes without a threshold that spike all the same.
    """
    kinds = _POPULATIONS if membranes else (*SPIKING, nir.Threshold)
    on_chip = {n for n, node in graph.nodes.items() if isinstance(node, kinds) or n in graded}
    ahead: dict[str, set[str]] = {name: set() for name in graph.nodes}
    for source, target in graph.edges:
        ahead[source].add(target)
    host = _host(graph, ahead, on_chip)
    behind = host | set(graph.outputs)
    return Topology(
        graph=graph,
        inputs={name: math.prod(_shape(node)) for name, node in sorted(graph.inputs.items())},
        populations=tuple(
            Population(
                name=name,
                shape=_shape(graph.nodes[name]),
                presynaptic=presynaptic,
                leaves=bool(ahead[name] & behind),
                decays=_different(graph.nodes[name], ("tau", "tau_syn", "tau_mem")),
                thresholds=_different(graph.nodes[name], ("v_threshold", "threshold")),
            )
            for name, presynaptic in _projections(graph).items()
            if name not in host
        ),
        host=tuple(sorted(host)),
    )


def _projections(graph: nir.NIRGraph) -> dict[str, tuple[Projection, ...]]:
    """The projections onto each population, followed from node to node."""
    try:
        ordered = order(graph)
    except ArtifactError:  # a loop without a neuron, which a Delay may open
        into = [edge for edge in graph.edges if isinstance(graph.nodes[edge[1]], nir.Delay)]
        ordered = order(graph, into)
    before = sources(graph)
    populations = [n for n in ordered.names if isinstance(graph.nodes[n], _POPULATIONS)]
    ways: dict[str, dict[str, SynapseMap]] = {}
    for name in (*populations, *graph.inputs):
        ones = np.broadcast_to(np.int64(1), math.prod(_shape(graph.nodes[name])))
        ways[name] = {name: SynapseMap(ones, ones)}
    followed = 0
    for name in ordered.names:
        if name in ways:
            continue
        found: dict[str, list[SynapseMap]] = {}
        for source, way in _arriving_ways(name, before, ways, ordered.late):
            found.setdefault(source, []).append(way)
            followed += 1 + len(way.maps)
        if followed > _MAX_WAYS:
            raise ArtifactError(
                f"node {name!r}: {followed} ways lead by here from neurons over nodes without "
                f"spikes; at most {_MAX_WAYS}. Join nodes without spikes between them into one."
            )
        node = graph.nodes[name]
        ways[name] = {source: _extend(_merge(each), name, node) for source, each in found.items()}
    return {
        name: tuple(
            Projection(source, name, way)
            for source, way in _arriving_ways(name, before, ways, ordered.late)
        )
        for name in populations
    }


def _arriving_ways(
    name: str,
    before: Mapping[str, Sequence[str]],
    ways: Mapping[str, Mapping[str, SynapseMap]],
    late: frozenset[Edge],
) -> Iterator[tuple[str, SynapseMap]]:
    """Source and way of everything that comes to a node; a loop of maps alone is cut."""
    for near in before[name]:
        for source, way in ways.get(near, {}).items():
            closes = (near, name) in late and not way.late
            yield source, replace(way, late=True) if closes else way


def _host(graph: nir.NIRGraph, ahead: Mapping[str, set[str]], on_chip: set[str]) -> set[str]:
    """Nodes from which only outputs are reached, and none of those that a chip computes."""
    before, outputs = sources(graph), set(graph.outputs)
    found: set[str] = set()
    waiting = list(outputs)
    while waiting:
        for name in before[waiting.pop()]:
            inside = isinstance(graph.nodes[name], nir.Input) or name in on_chip or name in found
            if not inside and ahead[name] <= found | outputs:
                found.add(name)
                waiting.append(name)
    return found


def _different(node: nir.NIRNode, fields: tuple[str, ...]) -> int:
    """Different sets of these parameters among the neurons of a node."""
    code, different = np.zeros(1, np.int64), 1
    for values in (np.ravel(getattr(node, field)) for field in fields if hasattr(node, field)):
        _, place = np.unique(values, return_inverse=True)
        # at most as many as there are neurons: the product fits
        _, code = np.unique(code * len(values) + place, return_inverse=True)
        different = int(code.max()) + 1
    return different


def _shape(node: nir.NIRNode) -> tuple[int, ...]:
    return tuple(int(n) for n in node.output_type["output"])


# layers, and their synapses as matrices


@dataclass(frozen=True, eq=False)
class Connection:
    """One connection of a layer.

    source: the spiking node or the input that it comes from.
    weight: (M, N) axon-major, float.
    lag: [timesteps] from a spike to its arrival, as the graph and its convention say.
    """

    source: str
    weight: Floats
    lag: int


@dataclass(frozen=True, eq=False)
class LayerGraph:
    """A graph as layers of neurons; neurons of any shape in a row, in C order.

    input: name of the input; those of several Input nodes, joined.
    inputs: the Input nodes, side by side in the input's axons.
    layers: names of the nodes of neurons, each after its sources of the same timestep.
    connections: of each layer.
    bias: (N,) of each layer.
    outlets: the Output nodes.
    """

    input: str
    inputs: tuple[Port, ...]
    layers: tuple[str, ...]
    connections: dict[str, tuple[Connection, ...]]
    bias: dict[str, Floats]
    outlets: tuple[HostOutput, ...]

    @property
    def width(self) -> int:
        """M of the input."""
        return sum(port.size for port in self.inputs)


def wiring(
    graph: nir.NIRGraph, convention: Convention, sigma_delta: Collection[str] = ()
) -> LayerGraph:
    """The layers of a graph; nodes that neither spike nor are linear are refused.

    sigma_delta: names of nodes that send graded spikes, although NIR calls them integrators.
    """
    for name, node in sorted(graph.nodes.items()):
        if not isinstance(node, _KNOWN):
            raise RuleError(
                f"rule primitive: node {name!r}: {type(node).__name__} has no place on a chip, "
                "whose neurons send spikes and whose synapses are linear; possible are "
                f"{', '.join(kind.__name__ for kind in _KNOWN)}. Replace it, or run it in float."
            )
    when = timing(graph, convention)
    matrices, inputs = Matrices(graph, when, convention), ports(graph.inputs)
    layers = tuple(name for name in when.names if isinstance(graph.nodes[name], NEURONS))
    blocks = {name: matrices.block(name) for name in (*layers, *sorted(graph.outputs))}
    for layer in layers:
        _check_sources(graph, blocks[layer], sigma_delta)
    name = ", ".join(port.name for port in inputs)
    while name in layers:
        name = f"{name}, inputs"
    return LayerGraph(
        input=name,
        inputs=inputs,
        layers=layers,
        connections={n: _connections(matrices, blocks[n], name, inputs) for n in layers},
        bias={layer: matrices.bias(blocks[layer]) for layer in layers},
        outlets=tuple(_outlet(matrices, blocks[p.name], p) for p in ports(graph.outputs)),
    )


def _check_sources(graph: nir.NIRGraph, block: "LinearBlock", sigma_delta: Collection[str]) -> None:
    """Refuse neurons that receive membranes: between neurons there are only spikes."""
    for source in block.sources:
        node = graph.nodes[source]
        spikes = source in sigma_delta or isinstance(node, SPIKING)
        if isinstance(node, NEURONS) and not spikes:
            raise RuleError(
                f"rule primitive: node {source!r}: {type(node).__name__} does not spike, and node "
                f"{block.target!r} receives its membranes; only an Output can. Give it a "
                "threshold, or run it in float."
            )


def _connections(
    matrices: "Matrices", block: "LinearBlock", name: str, inputs: Sequence[Port]
) -> tuple[Connection, ...]:
    """The connections onto a layer by source and lag; those of all Inputs as one matrix."""
    ends = np.cumsum([port.size for port in inputs]).tolist()
    rows = {port.name: slice(end - port.size, end) for port, end in zip(inputs, ends, strict=True)}
    presynaptic: dict[tuple[str, int], Floats] = {}
    for source in block.sources:
        for lag, matrix in matrices.between(source, block).items():
            if source not in rows:
                presynaptic[source, lag] = matrix
            elif len(rows) == 1:
                presynaptic[name, lag] = matrix
            else:
                width = ends[-1]
                all_ = presynaptic.setdefault((name, lag), np.zeros((width, matrix.shape[1])))
                all_[rows[source]] = matrix
    return tuple(Connection(source, matrix, lag) for (source, lag), matrix in presynaptic.items())


def _outlet(matrices: "Matrices", block: "LinearBlock", port: Port) -> HostOutput:
    """Return the output of an Output node from the layers, which the host computes."""
    for source in block.sources:
        if not isinstance(matrices.graph.nodes[source], NEURONS):
            raise RuleError(
                f"rule outputs: node {port.name!r}: the output must come from neurons; it "
                f"is connected to the input {source!r} without neurons between. Put "
                "some there, or run the graph in float."
            )
    taps = [
        ReadoutTerm(source, None if _is_identity(matrix) else matrix, lag)
        for source in block.sources
        for lag, matrix in matrices.between(source, block).items()
    ]
    return HostOutput(port, tuple(taps), matrices.bias(block))


def _is_identity(matrix: Floats) -> bool:
    square = matrix.shape[0] == matrix.shape[1]
    ones = square and bool((np.diagonal(matrix) == 1).all())
    return ones and np.count_nonzero(matrix) == len(matrix)


@dataclass(frozen=True, eq=False)
class LinearBlock:
    """The nodes without spikes that lead to one target.

    target: name of a spiking node or an Output.
    names: of the nodes, each after its sources.
    sources: the spiking nodes and Inputs from which they, or the target, receive spikes.
    """

    target: str
    names: tuple[str, ...]
    sources: tuple[str, ...]


class Matrices:
    """The linear part of a graph as matrices, which may take so much memory and no more."""

    def __init__(self, graph: nir.NIRGraph, timing: Timing, convention: Convention) -> None:
        self.graph, self._timing = graph, timing
        self._nodes = {
            name: build_node(name, _without_bias(node), convention, np.float64)
            for name, node in graph.nodes.items()
            if isinstance(node, LINEAR)
        }
        self._sources = sources(graph)
        self._bytes = self._visited = 0

    def block(self, target: str) -> LinearBlock:
        """The block before a target."""
        inside, presynaptic, waiting = set[str](), set[str](), [target]
        while waiting:
            for name in self._sources[waiting.pop()]:
                if name not in self._nodes:
                    presynaptic.add(name)
                elif name not in inside:
                    inside.add(name)
                    waiting.append(name)
        names = in_waves(inside, [(s, name) for name in inside for s in self._sources[name]])
        if left := sorted(inside - set(names)):
            raise RuleError(
                f"rule recurrence: nodes {', '.join(left)}: a loop without a spiking node, whose "
                "values would never settle; a chip has none. Put a neuron into it, or run the "
                "graph in float."
            )
        return LinearBlock(target, tuple(names), tuple(sorted(presynaptic)))

    def between(self, source: str, block: LinearBlock) -> dict[int, Floats]:
        """(M, N) from a source to the target of a block, by the timesteps that it takes."""
        size = self._size(source)
        self._check_size(block.target, size)
        self._check_work(block, source)
        if weights := self._weights(block, source):
            return weights
        found: dict[int, Floats] = {}
        for first, impulses in self._impulses(block, source):
            for lag, rows in self._respond(block, {source: {0: impulses}}).items():
                if lag not in found:
                    self._check_size(block.target, size)
                    found[lag] = np.zeros((size, self._size(block.target)))
                    self._bytes += found[lag].nbytes
                found[lag][first : first + len(rows)] = rows.reshape(len(rows), -1)
        # a Delay of different steps may leave nothing in one of them
        return {lag: m for lag, m in sorted(found.items()) if m.any()} or dict([min(found.items())])

    def bias(self, block: LinearBlock) -> Floats:
        """(N,) that arrives at the target in every timestep."""
        parts = self._respond(block, {}, biased=True)
        for lag, rows in parts.items():
            if lag and rows.any():
                raise RuleError(
                    f"rule bias: node {block.target!r}: a bias reaches it through a delay of "
                    f"{lag} timesteps, so that it would begin late, which no chip does. Put the "
                    "bias behind the delay."
                )
        nothing = np.zeros((1, self._size(block.target)))
        return np.asarray(parts.get(0, nothing).reshape(-1))

    def _check_size(self, target: str, size: int) -> None:
        if (found := self._bytes + 8 * size * self._size(target)) > _MAX_BYTES:
            raise RuleError(
                f"rule matrix: node {target!r}: as one matrix for each pair of layers, which a "
                f"chip's axons need, the weights take {found} bytes by here; at most {_MAX_BYTES}. "
                "Run the network in float, or make its convolutions smaller."
            )

    def _check_work(self, block: LinearBlock, source: str) -> None:
        """Refuse windows so large that sending all impulses through them takes minutes."""
        nodes = {name: self.graph.nodes[name] for name in block.names}
        # impulses are cheap through matrices: most rows of their input are zero
        each = sum(
            multiplications(name, node, _shape(node))
            for name, node in nodes.items()
            if not isinstance(node, DENSE)
        )
        if (found := each * self._size(source)) > _MAX_WORK:
            raise RuleError(
                f"rule matrix: node {block.target!r}: the matrix from {source!r} takes {found} "
                f"multiplications; at most {_MAX_WORK}. Run the network in float, or make its "
                "convolutions smaller."
            )

    def _check_visits(self, block: LinearBlock) -> None:
        """Refuse so many nodes between neurons that following all of their edges takes minutes."""
        self._visited += sum(len(self._sources[name]) for name in (*block.names, block.target))
        if self._visited > _MAX_VISITS:
            raise RuleError(
                f"rule matrix: node {block.target!r}: {len(block.names)} nodes without spikes "
                f"lead to it, and by here {self._visited} edges were followed; at most "
                f"{_MAX_VISITS}. Join nodes without spikes between them into one."
            )

    def _impulses(self, block: LinearBlock, source: str) -> Iterator[tuple[int, Floats]]:
        """Rows of the identity as (R, *shape), a few at a time, and the number of the first."""
        widest = max(map(self._size, (source, *block.names, block.target)))
        some = min(max(1, _MAX_IMPULSE_VALUES // widest), _MAX_IMPULSES)
        size = self._size(source)
        for first in range(0, size, some):
            rows = np.zeros((min(some, size - first), size))
            np.fill_diagonal(rows[:, first:], 1.0)
            yield first, rows.reshape(len(rows), *_shape(self.graph.nodes[source]))

    def _respond(
        self, block: LinearBlock, start: Mapping[str, Parts], biased: bool = False
    ) -> Parts:
        """Return the input of the target when the sources put out `start`."""
        self._check_visits(block)
        put = dict(start)
        for name in block.names:
            put[name] = self._through(name, self._arriving(name, put))
            if biased and isinstance(self.graph.nodes[name], _BIASED):
                _add(put[name], 0, self._bias(name))
        return self._arriving(block.target, put)

    def _arriving(self, name: str, put: Mapping[str, Parts]) -> Parts:
        arriving: Parts = {}
        for source in self._sources[name]:
            late = (source, name) in self._timing.late
            for lag, rows in put.get(source, {}).items():
                _add(arriving, lag + late, rows)
        return arriving

    def _through(self, name: str, arriving: Parts) -> Parts:
        """Apply a node to its input, its bias left out."""
        if (steps := self._timing.delays.get(name)) is None:
            compute = self._nodes[name]
            return {lag: np.asarray(compute(rows[None])[0]) for lag, rows in arriving.items()}
        put: Parts = {}
        for lag, rows in arriving.items():
            for step in np.unique(steps).tolist():
                _add(put, lag + step, np.where(steps == step, rows, 0.0))
        return put

    def _bias(self, name: str) -> Floats:
        node = self.graph.nodes[name]
        shape, bias = _shape(node), node.bias.astype(np.float64)
        if isinstance(node, CONVOLUTIONS):
            bias = bias.reshape(-1, *(1 for _ in shape[1:]))
        return np.broadcast_to(bias, shape)[None]

    def _weights(self, block: LinearBlock, source: str) -> dict[int, Floats]:
        """The weights themselves of a lone Affine or Linear; nothing where there is more."""
        name, *others = block.names or ("",)
        node = self.graph.nodes.get(name)
        alone = [self._sources.get(at) for at in (name, block.target)] == [[source], [name]]
        if others or not alone or not isinstance(node, DENSE) or node.weight.ndim != 2:
            return {}
        edges = [(source, name), (name, block.target)]
        self._bytes += 8 * node.weight.size
        # + 0.0: as a sum has it, no zero is negative
        weight = np.ascontiguousarray(node.weight.T, np.float64) + 0.0
        return {sum(edge in self._timing.late for edge in edges): weight}

    def _size(self, name: str) -> int:
        return math.prod(_shape(self.graph.nodes[name]))


def _without_bias(node: nir.NIRNode) -> nir.NIRNode:
    if not isinstance(node, _BIASED):
        return node
    plain = copy(node)
    plain.bias = np.zeros_like(node.bias)
    return plain


def _add(parts: Parts, lag: int, rows: Floats) -> None:
    parts[lag] = parts[lag] + rows if lag in parts else rows
