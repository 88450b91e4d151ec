"""The wiring of a graph: its neurons, and the synapses that the nodes between them come to.

A LayerGraph is what a chip is compiled from: the synapses, one set for each lag.

Synapses are a convolution's kernel with its window, or an affine map's matrix (compiler.chains). Of
anything else, two maps in a row or several ways with one lag, a matrix is found, of limited size: a
chain without spikes in it is linear but for its biases, so what it does to a unit impulse of a
source is a row of its matrix, and what it does to nothing is its bias.

Neurons without a threshold are readouts: an Output alone may receive their membranes.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import MAX_BYTES, Synapses, check_matrix
from spikedeploy.runtime.compiler.chains import weights_of
from spikedeploy.runtime.compiler.program import HostOutput, ReadoutTerm
from spikedeploy.runtime.compiler.topology import BIASED, arriving
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model import build_node
from spikedeploy.runtime.graph.neurons import NEURONS, SPIKING
from spikedeploy.runtime.graph.order import in_waves, reach, sources, timing
from spikedeploy.runtime.graph.ports import Port, ports
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE, POOLS, multiplications, shape_of

Floats: TypeAlias = NDArray[np.float64]
# what arrives how many timesteps late, (R, *shape)
Parts: TypeAlias = dict[int, Floats]

_LINEAR = (nir.Linear, *BIASED, *POOLS, nir.Scale, nir.Flatten, nir.Delay)
_KNOWN = (nir.Input, nir.Output, *_LINEAR, *NEURONS)

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
    outlets: the Output nodes.
    ways: (source, target) -> names of the nodes between them, where one chain of nodes leads from a
        source to a layer or Output and its weights are those of the chain; None where it does not.
    """

    input: str
    inputs: tuple[Port, ...]
    layers: tuple[str, ...]
    synapses: dict[str, tuple[Synapses, ...]]
    bias: dict[str, Floats]
    outlets: tuple[HostOutput, ...]
    ways: dict[tuple[str, str], tuple[str, ...] | None]

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
        ways=matrices.ways,
    )


def rewired(wired: LayerGraph, graph: nir.NIRGraph, convention: Convention) -> LayerGraph:
    """The layers of a graph whose numbers alone have changed since it was wired.

    It follows no edge again where chains lead from source to target, so that training compiles
    quickly; of anything else it is `wiring`.
    """
    if len(wired.inputs) > 1 or any(way is None for way in wired.ways.values()):
        return wiring(graph, convention)
    nodes, biases = graph.nodes, dict[str, list[Floats]]()
    for (_, target), way in wired.ways.items():
        for name in way or ():
            if isinstance(nodes[name], BIASED):
                if name != (way or ("",))[-1]:
                    return wiring(graph, convention)
                shape, bias = shape_of(nodes[name]), nodes[name].bias.astype(np.float64)
                bias = bias.reshape(-1, *(1 for _ in shape[1:]))
                biases.setdefault(target, []).append(np.broadcast_to(bias, shape).ravel())

    def weights(source: str, target: str, synapses: Synapses) -> Synapses:
        chain = [(name, nodes[name]) for name in wired.ways[source, target] or ()]
        found = weights_of(chain, shape_of(nodes[source]))
        assert found is not None  # as when it was wired
        is_listed = synapses.window is None and found[1] is not None
        renewed = replace(synapses, weight=found[0], window=found[1])
        return renewed.listed() if is_listed else renewed

    def bias_of(target: str, before: Floats) -> Floats:
        found = biases.get(target)
        return before if found is None else np.asarray(sum(found[1:], found[0]))

    def tap(target: str, term: ReadoutTerm) -> ReadoutTerm:
        if term.weight is None and not wired.ways[term.layer, target]:
            return term
        plain = Synapses(term.layer, np.zeros((0, 0)), 0)
        return replace(term, weight=weights(term.layer, target, plain).listed().weight)

    return replace(
        wired,
        synapses={
            layer: tuple(weights(s.source, layer, s) for s in synapses)
            for layer, synapses in wired.synapses.items()
        },
        bias={layer: bias_of(layer, before) for layer, before in wired.bias.items()},
        outlets=tuple(
            replace(
                outlet,
                taps=tuple(tap(outlet.port.name, term) for term in outlet.taps),
                bias=bias_of(outlet.port.name, outlet.bias),
            )
            for outlet in wired.outlets
        ),
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
            if each.delay not in joined:
                shape = ends[-1], each.shape[1]
                check_matrix(name, shape, "a row of several Inputs")
                joined[each.delay] = np.zeros(shape)
            joined[each.delay][rows[each.source]] = each.listed().weight
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
    end = f"an Output behind maps, {port.name!r},"
    taps = [
        ReadoutTerm(source, None if _is_identity(each) else each.listed(end).weight, each.delay)
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
            if isinstance(node, BIASED):
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
        self.ways: dict[tuple[str, str], tuple[str, ...] | None] = {}

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
        self.ways[source, block.target] = None
        if (way := self._only_way(block, source)) is not None:
            chain = [(name, self.graph.nodes[name]) for name in way]
            if found := weights_of(chain, shape_of(self.graph.nodes[source])):
                self.ways[source, block.target] = tuple(way)
                self._check_size(block.target, found[0].nbytes)
                self._bytes += found[0].nbytes
                lag = self._lag([source, *way, block.target])
                synapses = Synapses(source, found[0], lag, window=found[1])
                # one to one: vectors as a diagonal
                is_vector = len(shape_of(self.graph.nodes[source])) == 1
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

    def _impulses(self, block: _Block, source: str) -> Iterator[tuple[int, Floats]]:
        """Rows of the identity as (R, *shape), a few at a time, and the number of the first."""
        widest = max(map(self._size, (source, *block.names, block.target)))
        some = min(max(1, _MAX_IMPULSE_VALUES // widest), _MAX_IMPULSES)
        size = self._size(source)
        for first in range(0, size, some):
            rows = np.zeros((min(some, size - first), size))
            np.fill_diagonal(rows[:, first:], 1.0)
            yield first, rows.reshape(len(rows), *shape_of(self.graph.nodes[source]))

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
            if biased and isinstance(node, BIASED):
                shape, bias = shape_of(node), node.bias.astype(np.float64)
                if isinstance(node, CONVOLUTIONS):
                    bias = bias.reshape(-1, *(1 for _ in shape[1:]))
                bias = np.broadcast_to(bias, shape)[None]
                put[name][0] = put[name][0] + bias if 0 in put[name] else bias
        return self._summed(block.target, put)

    def _summed(self, name: str, put: Mapping[str, Parts]) -> Parts:
        late = self.timing.late
        found = arriving(name, self._sources, put, late, lambda lag, rows: (lag + 1, rows))
        return {lag: sum(rows[1:], rows[0]) for lag, rows in found.items()}

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
        return math.prod(shape_of(self.graph.nodes[name]))
