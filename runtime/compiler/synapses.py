"""Synapses: the weights that the nodes between neurons amount to, in a lowered network.

A chain of nodes that has weights of its own is at most a pool without overlap, then at most one map
(a convolution, another pool, or an affine map), and scales, delays and changes of shape around
them. An affine map comes to a matrix, or behind a pool to a kernel as large as its input; all
others come to a kernel and its window. A weight is what a unit impulse of its source brings to its
target, in the order in which the chain multiplies.

For anything else, such as two maps in a row or several paths with one lag, a matrix of limited size
is computed. The nodes between neurons are affine: the response to a unit impulse of a source is a
row of the matrix, and the response to zero is the bias.

Neurons without a threshold are readouts: an Output alone may receive their membranes.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import NamedTuple, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.chips.layer import MAX_BYTES, Synapses, check_matrix
from spikedeploy.runtime.compiler.lowering import (
    BIASED,
    LINEAR,
    Block,
    Lowering,
    in_three_axes,
    window_of_map,
)
from spikedeploy.runtime.compiler.program import Output, OutputTerm
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model import Node, build_node
from spikedeploy.runtime.graph.discretisation import NEURONS, SPIKING
from spikedeploy.runtime.graph.ports import Port, ports
from spikedeploy.runtime.graph.shapes import (
    CONVOLUTIONS,
    DENSE,
    POOLS,
    Shape,
    multiplications,
    shape_of,
    window_of,
)

Floats: TypeAlias = NDArray[np.float64]
Maps: TypeAlias = tuple[int, int, int]
Chain: TypeAlias = Sequence[tuple[str, nir.NIRNode]]
# what arrives how many timesteps late, (R, *shape)
Parts: TypeAlias = dict[int, Floats]

_KNOWN = (nir.Input, nir.Output, *LINEAR, *NEURONS)

# multiplications that finding a matrix may take
_MAX_WORK = 1 << 34
# edges that impulses may follow, over all targets
_MAX_VISITS = 1 << 18
# numbers that the impulses sent at once may fill, and how many are sent at most
_MAX_IMPULSE_VALUES = 1 << 22
_MAX_IMPULSES = 256


@dataclass(frozen=True, eq=False)
class LayerGraph:
    """A graph as layers of neurons; neurons of any shape in a row, in C order.

    input: name of the input; those of several Input nodes, joined.
    inputs: the Input nodes, side by side in the input's axons.
    layers: names of the nodes of neurons, each after its sources of the same timestep.
    synapses: onto each layer, in floats; their delays are the lags from a spike to its arrival, as
        the graph and its convention say.
    bias: (N,) of each layer.
    outputs: the Output nodes.
    """

    input: str
    inputs: tuple[Port, ...]
    layers: tuple[str, ...]
    synapses: dict[str, tuple[Synapses, ...]]
    bias: dict[str, Floats]
    outputs: tuple[Output, ...]

    @property
    def width(self) -> int:
        """M of the input."""
        return sum(port.size for port in self.inputs)


def layer_graph(lowered: Lowering, artifact: Artifact) -> LayerGraph:
    """The layers of a network; RuleError for nodes that neither spike nor are linear.

    lowered: of this network, or of one that differs from it in numbers alone.
    """
    graph = artifact.graph
    for name, node in sorted(graph.nodes.items()):
        if not isinstance(node, _KNOWN):
            raise RuleError(
                f"rule primitive: node {name!r}: {type(node).__name__} has no place on a chip, "
                "whose neurons send spikes and whose synapses are linear; possible are "
                f"{', '.join(kind.__name__ for kind in _KNOWN)}. Replace it, or run it in float."
            )
    weights, inputs = _Weights(lowered, artifact), ports(graph.inputs)
    layers = tuple(n for n in artifact.timing.names if isinstance(graph.nodes[n], NEURONS))
    blocks = lowered.blocks
    for layer in layers:
        _check_sources(artifact, blocks[layer])
    name = ", ".join(port.name for port in inputs)
    while name in layers:
        name = f"{name}, inputs"
    return LayerGraph(
        input=name,
        inputs=inputs,
        layers=layers,
        synapses={n: _synapses(weights, blocks[n], name, inputs) for n in layers},
        bias={layer: weights.bias(blocks[layer]) for layer in layers},
        outputs=tuple(_output(weights, blocks[p.name], p) for p in ports(graph.outputs)),
    )


def _check_sources(artifact: Artifact, block: Block) -> None:
    for source in block.ways:
        node = artifact.graph.nodes[source]
        spikes = source in artifact.sigma_delta or isinstance(node, SPIKING)
        if isinstance(node, NEURONS) and not spikes:
            raise RuleError(
                f"rule primitive: node {source!r}: {type(node).__name__} does not spike, and node "
                f"{block.target!r} receives its membranes; only an Output can. Give it a "
                "threshold, or run it in float."
            )


def _synapses(
    weights: "_Weights", block: Block, name: str, inputs: Sequence[Port]
) -> tuple[Synapses, ...]:
    """The synapses onto a layer by source and lag; those of several Inputs as one matrix."""
    ends = [*accumulate(port.size for port in inputs)]
    rows = {port.name: slice(end - port.size, end) for port, end in zip(inputs, ends, strict=True)}
    found: list[Synapses] = []
    joined: dict[int, Floats] = {}
    for each in (each for source in block.ways for each in weights.between(source, block)):
        if each.source not in rows:
            found.append(each)
        elif len(rows) == 1:
            found.append(replace(each, source=name))
        else:
            if each.delay not in joined:
                shape = ends[-1], each.shape[1]
                check_matrix(name, shape, "a row of several Inputs")
                joined[each.delay] = np.zeros(shape)
            joined[each.delay][rows[each.source]] = each.dense().weight
    return *found, *(Synapses(name, matrix, lag) for lag, matrix in joined.items())


def _output(weights: "_Weights", block: Block, port: Port) -> Output:
    """The output of an Output node from the layers, which the host computes."""
    for source in block.ways:
        if not isinstance(weights.graph.nodes[source], NEURONS):
            raise RuleError(
                f"rule outputs: node {port.name!r}: the output must come from neurons; it "
                f"is connected to the input {source!r} without neurons between. Put "
                "some there, or run the graph in float."
            )
    end, terms = f"an Output behind maps, {port.name!r},", list[OutputTerm]()
    for source, ways in block.ways.items():
        if [each.way for each in ways] == [()]:
            terms.append(OutputTerm(source, None, weights.lag([source, port.name])))
            continue
        for each in weights.between(source, block):
            weight = None if _is_identity(each) else each.dense(end).weight
            terms.append(OutputTerm(source, weight, each.delay))
    return Output(port, tuple(terms), weights.bias(block))


def _is_identity(synapses: Synapses) -> bool:
    size, targets = synapses.shape
    if size != targets or not (synapses.fan_out == 1).all():
        return False
    if synapses.window:
        return synapses.window.is_one_to_one and bool((synapses.weight == 1).all())
    return bool((np.diagonal(synapses.weight) == 1).all())


class _Weights:
    """The linear part of a graph as weights, which may take so much memory and no more."""

    def __init__(self, lowered: Lowering, artifact: Artifact) -> None:
        self.graph, self._timing = artifact.graph, artifact.timing
        self._convention, self._sources = artifact.convention, lowered.sources
        self._functions: dict[str, Node] = {}
        self._bytes = self._visited = 0

    def between(self, source: str, block: Block) -> list[Synapses]:
        """The synapses from a source to the target of a block; delays are what they take."""
        first, *others = block.ways[source]
        delays = self._timing.delays
        if (
            first.way is not None
            and not others
            and not any(np.ptp(delays[name]) for name in first.way if name in delays)
        ):
            shape = shape_of(self.graph.nodes[source])
            if found := weights_of([(n, self.graph.nodes[n]) for n in first.way], shape):
                self._check_size(block.target, found[0].nbytes)
                self._bytes += found[0].nbytes
                lag = self.lag([source, *first.way, block.target])
                synapses = Synapses(source, found[0], lag, window=found[1])
                # one to one: vectors as a diagonal
                return [synapses.dense() if len(shape) == 1 else synapses]
        return [Synapses(source, m, lag) for lag, m in self._matrices(source, block).items()]

    def lag(self, way: Sequence[str]) -> int:
        """[timesteps] that a way takes, its ends included, on which Delays are uniform."""
        late, delays = self._timing.late, self._timing.delays
        steps = (int(delays[name].max()) for name in way if name in delays)
        return sum(edge in late for edge in pairwise(way)) + sum(steps)

    def _matrices(self, source: str, block: Block) -> dict[int, Floats]:
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

    def bias(self, block: Block) -> Floats:
        """(N,) that arrives at the target in every timestep."""
        size = self._size(block.target)
        if not any(isinstance(self.graph.nodes[name], BIASED) for name in block.names):
            return np.zeros(size)
        parts = self._respond(block, {}, biased=True)
        for lag, rows in parts.items():
            if lag and rows.any():
                raise RuleError(
                    f"rule bias: node {block.target!r}: a bias reaches it through a delay of "
                    f"{lag} timesteps, so that it would begin late, which no chip does. Put the "
                    "bias behind the delay."
                )
        return np.asarray(parts.get(0, np.zeros(size)).reshape(-1))

    def _check_size(self, target: str, size: int) -> None:
        """Refuse more bytes of weights onto a target than the limit."""
        if (found := self._bytes + size) > MAX_BYTES:
            raise RuleError(
                f"rule matrix: node {target!r}: the weights take {found} bytes by here; at "
                f"most {MAX_BYTES}. Two maps without neurons between them become one matrix: put "
                "neurons there, or run the network in float."
            )

    def _check_work(self, block: Block, source: str) -> None:
        """Refuse windows so large that sending all impulses through them takes minutes."""
        nodes = {name: self.graph.nodes[name] for name in block.names}
        # impulses are cheap through matrices: most rows of their input are zero
        each = sum(
            multiplications(name, node, shape_of(node))
            for name, node in nodes.items()
            if not isinstance(node, DENSE)
        )
        if (found := each * self._size(source)) > _MAX_WORK:
            raise RuleError(
                f"rule matrix: node {block.target!r}: the matrix from {source!r} takes {found} "
                f"multiplications; at most {_MAX_WORK}. Put neurons between its maps, or run the "
                "network in float."
            )

    def _impulses(self, block: Block, source: str) -> Iterator[tuple[int, Floats]]:
        """Rows of the identity as (R, *shape), a few at a time, and the number of the first."""
        widest = max(map(self._size, (source, *block.names, block.target)))
        some = min(max(1, _MAX_IMPULSE_VALUES // widest), _MAX_IMPULSES)
        size = self._size(source)
        for first in range(0, size, some):
            rows = np.zeros((min(some, size - first), size))
            np.fill_diagonal(rows[:, first:], 1.0)
            yield first, rows.reshape(len(rows), *shape_of(self.graph.nodes[source]))

    def _respond(self, block: Block, start: Mapping[str, Parts], biased: bool = False) -> Parts:
        """Return the input of the target when the sources send `start`."""
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
            if biased and isinstance(node, BIASED):
                shape, bias = shape_of(node), node.bias.astype(np.float64)
                if isinstance(node, CONVOLUTIONS):
                    bias = bias.reshape(-1, *(1 for _ in shape[1:]))
                bias = np.broadcast_to(bias, shape)[None]
                put[name][0] = put[name][0] + bias if 0 in put[name] else bias
        return self._summed(block.target, put)

    def _summed(self, name: str, put: Mapping[str, Parts]) -> Parts:
        found: Parts = {}
        for near in self._sources[name]:
            for lag, rows in put.get(near, {}).items():
                late = lag + ((near, name) in self._timing.late)
                found[late] = found[late] + rows if late in found else rows
        return found

    def _through(self, name: str, arriving: Parts) -> Parts:
        """Apply a node to its input, its bias left out."""
        if (steps := self._timing.delays.get(name)) is None:
            return {
                lag: np.asarray(self._function(name)(rows[None])[0])
                for lag, rows in arriving.items()
            }
        put: Parts = {}
        for lag, rows in arriving.items():
            for step in np.unique(steps).tolist():
                put[lag + step] = put.get(lag + step, 0.0) + np.where(steps == step, rows, 0.0)
        return put

    def _function(self, name: str) -> Node:
        """The function that computes a node, its bias left out."""
        if name not in self._functions:
            node = self.graph.nodes[name]
            if isinstance(node, BIASED):
                node = copy(node)
                node.bias = np.zeros_like(node.bias)
            self._functions[name] = build_node(name, node, self._convention, np.float64)
        return self._functions[name]

    def _size(self, name: str) -> int:
        return math.prod(shape_of(self.graph.nodes[name]))


# chains that have weights of their own


def weights_of(chain: Chain, source: Shape) -> tuple[Floats, Window | None] | None:
    """The weights of a chain, with their window if they are a kernel; None if it has none such.

    chain: names and nodes between the source and the target, both excluded.
    source: shape of its input.
    """
    head, rest = _read_head(chain, source)
    if head is None:
        return None
    (name, node), *tail = rest or [("", None)]
    if not all(isinstance(each, nir.Scale) for _, each in tail):
        return None
    scales = [np.ravel(each.scale).astype(np.float64) for _, each in tail]
    if isinstance(node, DENSE):
        return _affine(node, head, scales)
    return _kernel(name, node, head, scales)


class _Head(NamedTuple):
    """Operations of a chain before its map.

    source, maps: shapes in front of the pool and behind it.
    pool: by which coordinates are divided.
    scale: of each element of the maps, in C order.
    """

    source: Maps
    maps: Maps
    pool: tuple[int, int]
    scale: Floats

    def of_channels(self) -> Floats | None:
        """Scales (C,) of the channels; None where they differ in one."""
        return _alike(self.scale, self.maps[0])


def _alike(values: Floats, channels: int) -> Floats | None:
    each = values.reshape(channels, -1)
    return np.asarray(each[:, 0]) if (each == each[:, :1]).all() else None


def _read_head(chain: Chain, source: Shape) -> tuple[_Head | None, Chain]:
    """Scales and pools without overlap at the beginning of a chain, and the rest of it."""
    maps = [each for each in chain if not isinstance(each[1], (nir.Flatten, nir.Delay))]
    first = in_three_axes(source)
    head = _Head(first, first, (1, 1), np.ones(math.prod(source)))
    for place, (name, node) in enumerate(maps):
        takes = (
            head.maps
            if isinstance(node, (nir.Scale, *DENSE))
            else in_three_axes(node.input_type["input"])
        )
        if head.pool == (1, 1):  # shapes may change until the pool
            head = head._replace(source=takes, maps=takes)
        elif takes != head.maps:
            return None, ()
        if isinstance(node, nir.Scale):
            head = head._replace(scale=head.scale * np.ravel(node.scale).astype(np.float64))
        elif isinstance(node, POOLS) and _is_division(name, node):
            if (each := head.of_channels()) is None:
                return None, ()
            y, x = window_of(name, node).kernel
            each = each / (y * x) if isinstance(node, nir.AvgPool2d) else each
            puts = in_three_axes(node.output_type["output"])
            pool = head.pool[0] * y, head.pool[1] * x
            head = head._replace(maps=puts, pool=pool, scale=each.repeat(math.prod(puts[1:])))
        else:
            return head, maps[place:]
    return head, ()


def _affine(
    node: nir.NIRNode, head: _Head, scales: Sequence[Floats]
) -> tuple[Floats, Window | None] | None:
    if node.weight.ndim != 2:
        return None
    weight = node.weight.astype(np.float64) * head.scale
    for scale in scales:
        weight = weight * scale[:, None]
    # + 0.0: as a sum has it, no zero is negative
    weight = weight + 0.0
    if head.pool == (1, 1):
        return np.ascontiguousarray(weight.T), None
    features, maps = len(weight), head.maps
    window = Window(head.source, (features, 1, 1), kernel=maps[1:], pool=head.pool)
    return weight.reshape(features, *maps), window


def _kernel(
    name: str, node: nir.NIRNode | None, head: _Head, scales: Sequence[Floats]
) -> tuple[Floats, Window | None] | None:
    """The kernel of a convolution or pool; without a node, of the head alone."""
    each = head.of_channels()
    if node is None and each is None and head.pool == (1, 1):  # one to one, a scale of each
        size = math.prod(head.maps)
        head, each = _Head((size, 1, 1), (size, 1, 1), (1, 1), head.scale), head.scale
    if each is None:
        return None
    if node is None:
        window = Window(head.source, head.maps, (1, 1), head.pool, groups=head.maps[0])
    else:
        window = replace(window_of_map(name, node), source=head.source, pool=head.pool)
    (features, *_), groups = window.target, window.groups
    weight: Floats = np.ones((features, 1, *window.kernel))
    if isinstance(node, CONVOLUTIONS):
        weight = node.weight.astype(np.float64).reshape(features, -1, *window.kernel)
    # weights of a group see its channels alone
    parted = weight.reshape(groups, -1, *weight.shape[1:]) * each.reshape(groups, 1, -1, 1, 1)
    weight = parted.reshape(weight.shape)
    if isinstance(node, nir.AvgPool2d):
        weight = weight / math.prod(weight.shape[2:])
    for scale in scales:
        if (after := _alike(scale, features)) is None:
            return None
        weight = weight * after[:, None, None, None]
    # what only padding comes under is no weight
    rows, columns = window.seen
    used = np.logical_and.outer(rows.any(axis=0), columns.any(axis=0))
    return weight * used + 0.0, window


def _is_division(name: str, node: nir.NIRNode) -> bool:
    """True for a pool whose positions neither overlap nor leave anything out between them."""
    window = window_of(name, node)
    return window.stride == window.kernel and not any(map(any, window.padding))
