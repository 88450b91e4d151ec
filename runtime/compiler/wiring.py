"""The wiring of a graph: its neurons, and the synapses that the nodes between them come to.

It is known in two depths, both by following the graph from node to node. A Topology takes any sound
graph, so that every node of a network that fits nowhere can still be told why: of the synapses it
has a map of each projection, which counts what leaves each source and reaches each target, and is a
matrix only where the graph has one. A LayerGraph is what a chip is compiled from: the synapses, one
set for each lag.

Synapses are a convolution's kernel with its window, or an affine map's matrix (compiler.chains). Of
anything else, two maps in a row or several ways with one lag, a matrix is found, of limited size: a
chain without spikes in it is linear but for its biases, so what it does to a unit impulse of a
source is a row of its matrix, and what it does to nothing is its bias.

Neurons without a threshold are readouts: an Output alone may receive their membranes.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import pairwise
from typing import NamedTuple, TypeAlias, TypeVar

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import MAX_BYTES, Synapses
from spikedeploy.runtime.compiler.chains import weights_of
from spikedeploy.runtime.compiler.program import HostOutput, ReadoutTerm
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError, RuleError
from spikedeploy.runtime.float_model import build_node
from spikedeploy.runtime.graph.neurons import NEURONS, SPIKING
from spikedeploy.runtime.graph.order import (
    Edge,
    in_waves,
    neighbours,
    order,
    reach,
    sources,
    timing,
)
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
_K = TypeVar("_K")
_V = TypeVar("_V")

_POPULATIONS = (*NEURONS, nir.Threshold)
_MAPS = (*DENSE, *CONVOLUTIONS, *POOLS)
_BIASED = (nir.Affine, *CONVOLUTIONS)
_LINEAR = (nir.Linear, *_BIASED, *POOLS, nir.Scale, nir.Flatten, nir.Delay)
_KNOWN = (nir.Input, nir.Output, *_LINEAR, *NEURONS)

# ways to nodes without spikes, and the nodes on them: following more takes seconds
_MAX_WAYS = 1 << 16
# multiplications that finding a matrix may take
_MAX_WORK = 1 << 34
# edges that impulses may follow, over all targets
_MAX_VISITS = 1 << 18
# numbers that the impulses sent at once may fill, and how many are sent at most
_MAX_IMPULSE_VALUES = 1 << 22
_MAX_IMPULSES = 256


def _arriving(
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


# populations and their projections, without matrices


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
    biased = isinstance(node, _BIASED) and bool(node.bias.any())
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
    if isinstance(node, POOLS):
        return *_convolved_counts(node, window_of(name, node), 1, 1), None, False
    if isinstance(node, CONVOLUTIONS):
        features = len(node.weight) // int(np.ravel(node.groups)[0])
        channels = int(node.weight.shape[1])
        return *_convolved_counts(node, window_of(name, node), features, channels), None, False
    # (..., N, M): of a stack of maps, each has its own part
    out, into = (np.count_nonzero(node.weight, axis=axis).ravel() for axis in (-2, -1))
    listed = node.weight.ndim == 2
    return out, into, node.weight.T if listed else None, not listed


def _convolved_counts(
    node: nir.NIRNode, window: ConvWindow, features: int, channels: int
) -> tuple[Counts, Counts]:
    """Synapses of each source and target of a kernel of features x channels of its group.

    Zeros in the kernel count as synapses.
    """
    (_, *takes), (_, *puts) = (
        tuple(int(n) for n in end) for end in (node.input_type["input"], node.output_type["output"])
    )
    used, seen = [], []
    for axis, (extent, places) in enumerate(zip(takes, puts, strict=True)):
        kernel = np.arange(window.kernel[axis]) * window.dilation[axis] - window.padding[axis][0]
        index = np.arange(places)[:, None] * window.stride[axis] + kernel
        inside = (index >= 0) & (index < extent)
        used.append(np.bincount(index[inside], minlength=extent))
        seen.append(inside.sum(axis=1))
    out = reduce(np.multiply.outer, used) * features
    into = reduce(np.multiply.outer, seen) * channels
    return (
        np.broadcast_to(out, tuple(node.input_type["input"])).ravel(),
        np.broadcast_to(into, tuple(node.output_type["output"])).ravel(),
    )


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
        inputs={name: math.prod(_shape(node)) for name, node in sorted(graph.inputs.items())},
        populations=tuple(
            Population(
                name=name,
                shape=_shape(graph.nodes[name]),
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
        ones = np.broadcast_to(np.int64(1), math.prod(_shape(graph.nodes[name])))
        ways[name] = {name: Projection(name, "", ones, ones)}
    followed = 0
    for name in (name for name in names if name not in ways):
        found = _arriving(name, before, ways, late, _closing)
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
            for each in _arriving(name, before, ways, late, _closing).values()
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


def _shape(node: nir.NIRNode) -> tuple[int, ...]:
    return tuple(int(n) for n in node.output_type["output"])


# layers, and their synapses as weights


@dataclass(frozen=True, eq=False)
class LayerGraph:
    """A graph as layers of neurons; neurons of any shape in a row, in C order.

    input: name of the input; those of several Input nodes, joined.
    inputs: the Input nodes, side by side in the input's axons.
    layers: names of the nodes of neurons, each after its sources of the same timestep.
    synapses: onto each layer, in floats; their delays are the lags from a spike to its arrival, as
        the graph and its convention say.
    bias: (N,) of each layer.
    outlets: the Output nodes.
    """

    input: str
    inputs: tuple[Port, ...]
    layers: tuple[str, ...]
    synapses: dict[str, tuple[Synapses, ...]]
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
    matrices, inputs = _Matrices(graph, convention), ports(graph.inputs)
    layers = tuple(n for n in matrices.timing.names if isinstance(graph.nodes[n], NEURONS))
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
        synapses={n: _synapses(matrices, blocks[n], name, inputs) for n in layers},
        bias={layer: matrices.bias(blocks[layer]) for layer in layers},
        outlets=tuple(_outlet(matrices, blocks[p.name], p) for p in ports(graph.outputs)),
    )


def _check_sources(graph: nir.NIRGraph, block: "_Block", sigma_delta: Collection[str]) -> None:
    for source in block.sources:
        node = graph.nodes[source]
        spikes = source in sigma_delta or isinstance(node, SPIKING)
        if isinstance(node, NEURONS) and not spikes:
            raise RuleError(
                f"rule primitive: node {source!r}: {type(node).__name__} does not spike, and node "
                f"{block.target!r} receives its membranes; only an Output can. Give it a "
                "threshold, or run it in float."
            )


def _synapses(
    matrices: "_Matrices", block: "_Block", name: str, inputs: Sequence[Port]
) -> tuple[Synapses, ...]:
    """The synapses onto a layer by source and lag; those of several Inputs as one matrix."""
    ends = np.cumsum([port.size for port in inputs]).tolist()
    rows = {port.name: slice(end - port.size, end) for port, end in zip(inputs, ends, strict=True)}
    found: list[Synapses] = []
    joined: dict[int, Floats] = {}
    for each in (each for source in block.sources for each in matrices.between(source, block)):
        if each.source not in rows:
            found.append(each)
        elif len(rows) == 1:
            found.append(replace(each, source=name))
        else:
            matrix = joined.setdefault(each.delay, np.zeros((ends[-1], each.shape[1])))
            matrix[rows[each.source]] = each.listed().weight
    return *found, *(Synapses(name, matrix, lag) for lag, matrix in joined.items())


def _outlet(matrices: "_Matrices", block: "_Block", port: Port) -> HostOutput:
    """Return the output of an Output node from the layers, which the host computes."""
    for source in block.sources:
        if not isinstance(matrices.graph.nodes[source], NEURONS):
            raise RuleError(
                f"rule outputs: node {port.name!r}: the output must come from neurons; it "
                f"is connected to the input {source!r} without neurons between. Put "
                "some there, or run the graph in float."
            )
    taps = [
        ReadoutTerm(source, None if _is_identity(each) else each.listed().weight, each.delay)
        for source in block.sources
        for each in matrices.between(source, block)
    ]
    return HostOutput(port, tuple(taps), matrices.bias(block))


def _is_identity(synapses: Synapses) -> bool:
    size, targets = synapses.shape
    if size != targets or not (synapses.fan_out == 1).all():
        return False
    if synapses.window:
        return synapses.window.is_one_to_one and bool((synapses.weight == 1).all())
    return bool((np.diagonal(synapses.weight) == 1).all())


class _Block(NamedTuple):
    """The nodes without spikes that lead to one target.

    target: name of a spiking node or an Output.
    names: of the nodes, each after its sources.
    sources: the spiking nodes and Inputs from which they, or the target, receive spikes.
    """

    target: str
    names: tuple[str, ...]
    sources: tuple[str, ...]


class _Matrices:
    """The linear part of a graph as weights, which may take so much memory and no more."""

    def __init__(self, graph: nir.NIRGraph, convention: Convention) -> None:
        self.graph, self.timing = graph, timing(graph, convention)
        self._nodes = {}
        for name, node in graph.nodes.items():
            if isinstance(node, _BIASED):
                node = copy(node)
                node.bias = np.zeros_like(node.bias)
            if isinstance(node, _LINEAR):
                self._nodes[name] = build_node(name, node, convention, np.float64)
        self._sources = sources(graph)
        self._linear = {
            name: [near for near in found if near in self._nodes]
            for name, found in self._sources.items()
        }
        self._bytes = self._visited = 0

    def block(self, target: str) -> _Block:
        """The block before a target."""
        inside = reach(self._linear[target], self._linear)
        names = in_waves(inside, [(s, name) for name in inside for s in self._linear[name]])
        if left := sorted(inside - set(names)):
            raise RuleError(
                f"rule recurrence: nodes {', '.join(left)}: a loop without a spiking node, whose "
                "values would never settle; a chip has none. Put a neuron into it, or run the "
                "graph in float."
            )
        near = {s for name in (*names, target) for s in self._sources[name]}
        return _Block(target, tuple(names), tuple(sorted(near - inside)))

    def between(self, source: str, block: _Block) -> list[Synapses]:
        """The synapses from a source to the target of a block; delays are what they take."""
        if (way := self._only_way(block, source)) is not None:
            chain = [(name, self.graph.nodes[name]) for name in way]
            if found := weights_of(chain, _shape(self.graph.nodes[source])):
                self._check_size(block.target, found[0].nbytes)
                self._bytes += found[0].nbytes
                lag = self._lag([source, *way, block.target])
                synapses = Synapses(source, found[0], lag, window=found[1])
                # one to one: vectors as a diagonal
                is_vector = len(_shape(self.graph.nodes[source])) == 1
                return [synapses.listed() if is_vector else synapses]
        return [Synapses(source, m, lag) for lag, m in self._matrices(source, block).items()]

    def _only_way(self, block: _Block, source: str) -> list[str] | None:
        """The nodes from a source to the target; None where ways part, or Delays differ."""
        ahead: dict[str, list[str]] = {}
        for name in (*block.names, block.target):
            for near in self._sources[name]:
                ahead.setdefault(near, []).append(name)
        way: list[str] = []
        while (behind := ahead[way[-1] if way else source]) != [block.target]:
            if len(behind) > 1 or np.ptp(self.timing.delays.get(behind[0], 0)):
                return None
            way += behind
        return way

    def _lag(self, way: Sequence[str]) -> int:
        """[timesteps] that a way takes, its ends included, on which Delays are uniform."""
        steps = (int(np.max(self.timing.delays.get(name, 0))) for name in way)
        return sum(edge in self.timing.late for edge in pairwise(way)) + sum(steps)

    def _matrices(self, source: str, block: _Block) -> dict[int, Floats]:
        """(M, N) from a source to the target of a block, by the timesteps that it takes."""
        size, targets = self._size(source), self._size(block.target)
        self._check_size(block.target, 8 * size * targets)
        self._check_work(block, source)
        found: dict[int, Floats] = {}
        for first, impulses in self._impulses(block, source):
            for lag, rows in self._respond(block, {source: {0: impulses}}).items():
                if lag not in found:
                    self._check_size(block.target, 8 * size * targets)
                    found[lag] = np.zeros((size, targets))
                    self._bytes += found[lag].nbytes
                found[lag][first : first + len(rows)] = rows.reshape(len(rows), -1)
        # a Delay of different steps may leave nothing in one of them
        return {lag: m for lag, m in sorted(found.items()) if m.any()} or dict([min(found.items())])

    def bias(self, block: _Block) -> Floats:
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
        """Refuse so many more bytes of weights onto a target where they are too many."""
        if (found := self._bytes + size) > MAX_BYTES:
            raise RuleError(
                f"rule matrix: node {target!r}: the weights take {found} bytes by here; at "
                f"most {MAX_BYTES}. Two maps without neurons between them become one matrix: put "
                "neurons there, or run the network in float."
            )

    def _check_work(self, block: _Block, source: str) -> None:
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
                f"multiplications; at most {_MAX_WORK}. Put neurons between its maps, or run the "
                "network in float."
            )

    def _impulses(self, block: _Block, source: str) -> Iterator[tuple[int, Floats]]:
        """Rows of the identity as (R, *shape), a few at a time, and the number of the first."""
        widest = max(map(self._size, (source, *block.names, block.target)))
        some = min(max(1, _MAX_IMPULSE_VALUES // widest), _MAX_IMPULSES)
        size = self._size(source)
        for first in range(0, size, some):
            rows = np.zeros((min(some, size - first), size))
            np.fill_diagonal(rows[:, first:], 1.0)
            yield first, rows.reshape(len(rows), *_shape(self.graph.nodes[source]))

    def _respond(self, block: _Block, start: Mapping[str, Parts], biased: bool = False) -> Parts:
        """Return the input of the target when the sources put out `start`."""
        self._visited += sum(len(self._sources[name]) for name in (*block.names, block.target))
        if self._visited > _MAX_VISITS:
            raise RuleError(
                f"rule matrix: node {block.target!r}: {len(block.names)} nodes without spikes "
                f"lead to it, and by here {self._visited} edges were followed; at most "
                f"{_MAX_VISITS}. Join nodes without spikes between them into one."
            )
        put = dict(start)
        for name in block.names:
            put[name] = self._through(name, self._summed(name, put))
            node = self.graph.nodes[name]
            if biased and isinstance(node, _BIASED):
                shape, bias = _shape(node), node.bias.astype(np.float64)
                if isinstance(node, CONVOLUTIONS):
                    bias = bias.reshape(-1, *(1 for _ in shape[1:]))
                bias = np.broadcast_to(bias, shape)[None]
                put[name][0] = put[name][0] + bias if 0 in put[name] else bias
        return self._summed(block.target, put)

    def _summed(self, name: str, put: Mapping[str, Parts]) -> Parts:
        late = self.timing.late
        arriving = _arriving(name, self._sources, put, late, lambda lag, rows: (lag + 1, rows))
        return {lag: sum(rows[1:], rows[0]) for lag, rows in arriving.items()}

    def _through(self, name: str, arriving: Parts) -> Parts:
        """Apply a node to its input, its bias left out."""
        if (steps := self.timing.delays.get(name)) is None:
            compute = self._nodes[name]
            return {lag: np.asarray(compute(rows[None])[0]) for lag, rows in arriving.items()}
        put: Parts = {}
        for lag, rows in arriving.items():
            for step in np.unique(steps).tolist():
                put[lag + step] = put.get(lag + step, 0.0) + np.where(steps == step, rows, 0.0)
        return put

    def _size(self, name: str) -> int:
        return math.prod(_shape(self.graph.nodes[name]))
