"""The normal form of a graph: one level, parameters in floats, no batch axes.

Nodes of an inner graph are called outer.inner. Its Input and Output compute nothing; they become
edges.

Whole numbers become floats of the same values: unsigned ones have no negative, and of the smallest
signed one the magnitude does not fit, so that results would be wrong without a word.

Some tools write shapes with axes of one in front, for batch or time, which NIR does not count. A
weight matrix takes (M,), a Conv1d (C, X), a Conv2d or pool (C, Y, X); what stands beside one with
the same axes and further ones of length 1 before them has a batch.
"""

import copy
from collections import defaultdict
from collections.abc import Iterable
from itertools import product

import nir
import numpy as np

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.neurons import NEURONS
from spikedeploy.runtime.graph.order import Edge
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE, POOLS, whole_numbers
from spikedeploy.runtime.graph.validate import MAX_EDGES, check_edges


def flattened(graph: nir.NIRGraph, path: str = "") -> nir.NIRGraph:
    """The same network in one level; the graph itself where nothing is nested.

    path: of the graph inside an outer one, ending in a dot.
    """
    inner = {n: node for n, node in graph.nodes.items() if isinstance(node, nir.NIRGraph)}
    if inner or path:
        check_edges(graph, path)
    if not inner:
        return graph
    nodes = {name: node for name, node in graph.nodes.items() if name not in inner}
    edges = _Edges(graph.edges)
    for name, node in sorted(inner.items()):
        _unpack(name, flattened(node, f"{path}{name}."), nodes, edges, f"{path}{name}")
    return nir.NIRGraph(nodes, sorted(edges.all), metadata=graph.metadata, type_check=False)


class _Edges:
    """Edges that change; all, and the neighbours of each node."""

    def __init__(self, edges: Iterable[Edge]) -> None:
        self.all: set[Edge] = set()
        self._before: defaultdict[str, set[str]] = defaultdict(set)
        self._after: defaultdict[str, set[str]] = defaultdict(set)
        self.add(edges)

    def add(self, edges: Iterable[Edge]) -> None:
        """Add edges."""
        for source, target in edges:
            self.all.add((source, target))
            self._before[target].add(source)
            self._after[source].add(target)

    def taken(self, name: str) -> tuple[set[str], set[str]]:
        """The sources and targets of a node, whose edges are removed; its own is in both."""
        before, after = self._before.pop(name, set()), self._after.pop(name, set())
        for source in before - {name}:
            self._after[source].discard(name)
        for target in after - {name}:
            self._before[target].discard(name)
        self.all -= {(source, name) for source in before} | {(name, target) for target in after}
        return before, after


def _unpack(
    outer: str, graph: nir.NIRGraph, nodes: dict[str, nir.NIRNode], edges: _Edges, path: str
) -> None:
    """Replace the node `outer` by the nodes and edges of its graph."""
    entry = _port(path, graph.inputs, "Input")
    exit_ = _port(path, graph.outputs, "Output")
    for name, node in graph.nodes.items():
        if f"{outer}.{name}" in nodes:
            raise ArtifactError(
                f"node {path!r}: its node {name!r} would be called {outer}.{name}, but that name "
                "is taken. Rename one of the two."
            )
        nodes[f"{outer}.{name}"] = node
    before, after = edges.taken(outer)
    first, last = f"{outer}.{entry}", f"{outer}.{exit_}"
    edges.add((last if source == outer else source, first) for source in before)
    edges.add((last, first if target == outer else target) for target in after)
    edges.add((f"{outer}.{source}", f"{outer}.{target}") for source, target in graph.edges)
    for port in (entry, exit_):
        _bypass(f"{outer}.{port}", nodes, edges)


def _bypass(port: str, nodes: dict[str, nir.NIRNode], edges: _Edges) -> None:
    """Connect the sources of a port to its targets; keep it where an edge would double."""
    sources, targets = edges.taken(port)
    if len(sources) * len(targets) > MAX_EDGES:
        raise ArtifactError(
            f"node {port!r}: {len(sources)} edges lead to it and {len(targets)} from it, which "
            f"makes more than {MAX_EDGES} edges in one level. Put a node without effect between."
        )
    through = set(product(sources, targets))
    if port in sources or through & edges.all:
        # NIR has no identity node; a Scale by one is one
        stated = np.asarray(nodes[port].output_type["output"])
        shape = whole_numbers(port, "shape", stated, stated.size, minimum=1)
        nodes[port] = nir.Scale(np.ones(shape))
        edges.add({(source, port) for source in sources} | {(port, target) for target in targets})
        return
    del nodes[port]
    edges.add(through)


def _port(path: str, found: dict[str, nir.NIRNode], kind: str) -> str:
    if len(found) != 1:
        raise ArtifactError(
            f"node {path!r}: the graph inside it has {len(found)} {kind} nodes "
            f"({', '.join(sorted(found))}); it must have one, because an edge names only the outer "
            "node. Give it one, or flatten the graph in the tool that wrote it."
        )
    return next(iter(found))


# kinds with parameters, which are arrays of numbers, one for each synapse or neuron
_KINDS = (*DENSE, *CONVOLUTIONS, nir.Scale, nir.Threshold, nir.Delay, *NEURONS)
# geometry of a convolution, which stays in whole numbers; types are derived
_OTHERS = {
    "stride", "padding", "dilation", "groups", "input_shape", "input_type", "output_type",
    "metadata",
}  # fmt: skip
_LARGEST = 1 << 53


def with_floats(graph: nir.NIRGraph) -> nir.NIRGraph:
    """The graph with whole parameters in float64; itself where there are none."""
    nodes = {name: _node(name, node) for name, node in graph.nodes.items()}
    if all(node is graph.nodes[name] for name, node in nodes.items()):
        return graph
    return nir.NIRGraph(nodes, list(graph.edges), metadata=graph.metadata, type_check=False)


def _node(name: str, node: nir.NIRNode) -> nir.NIRNode:
    whole = {
        field: value
        for field, value in vars(node).items()
        if field not in _OTHERS and isinstance(value, np.ndarray) and value.dtype.kind in "iu"
    }
    if not isinstance(node, _KINDS) or not whole:
        return node
    other = copy.copy(node)
    for field, value in whole.items():
        # max and min in Python, whose numbers do not wrap
        if max(int(value.max()), -int(value.min())) > _LARGEST:
            raise ArtifactError(
                f"node {name!r}: {field} holds whole numbers beyond {_LARGEST}, which no float "
                "holds. Scale them down."
            )
        setattr(other, field, value.astype(np.float64))
    return other


_ELEMENTWISE = (*NEURONS, nir.Threshold, nir.Scale, nir.Delay)
_PORTS = (nir.Input, nir.Output)


def without_batch_axis(graph: nir.NIRGraph) -> nir.NIRGraph:
    """The graph, ports and neurons without leading axes of 1 that its weights do not have."""
    axes = _axes(graph)
    nodes = {name: _stripped(node, axes.get(name)) for name, node in graph.nodes.items()}
    if all(node is graph.nodes[name] for name, node in nodes.items()):
        return graph
    return nir.NIRGraph(nodes, list(graph.edges), metadata=graph.metadata, type_check=False)


def _axes(graph: nir.NIRGraph) -> dict[str, int]:
    """Number of axes of what arrives at a node or leaves it, where the weights beside it say so."""
    known = {name: axes for name, node in graph.nodes.items() if (axes := _own_axes(node))}
    waiting = list(known)
    near: dict[str, set[str]] = {}
    for source, target in graph.edges:
        near.setdefault(source, set()).add(target)
        near.setdefault(target, set()).add(source)
    for here in waiting:
        for name in sorted(near.get(here, ())):
            node = graph.nodes.get(name)
            if name not in known and isinstance(node, (*_ELEMENTWISE, *_PORTS)):
                known[name] = known[here]
                waiting.append(name)
    return known


def _own_axes(node: nir.NIRNode) -> int:
    """Axes that the weights of a node imply; 0 where they imply none."""
    if isinstance(node, DENSE) and np.ndim(node.weight) == 2:
        return 1
    if isinstance(node, nir.Conv1d):
        return 2
    return 3 if isinstance(node, (nir.Conv2d, *POOLS)) else 0


def _stripped(node: nir.NIRNode, axes: int | None) -> nir.NIRNode:
    if axes is None:
        return node
    if isinstance(node, _PORTS):
        shape = np.asarray(node.output_type["output"])
        extra = _extra(shape.tolist(), axes) if shape.ndim == 1 else 0
        return type(node)(shape[extra:]) if extra else node
    if not isinstance(node, _ELEMENTWISE):
        return node
    arrays = {n: value for n, value in vars(node).items() if isinstance(value, np.ndarray)}
    fewer_axes = {n: value[(0,) * _extra(value.shape, axes)] for n, value in arrays.items()}
    if all(fewer_axes[n].ndim == value.ndim for n, value in arrays.items()):
        return node
    other = copy.copy(node)
    for n, value in fewer_axes.items():
        setattr(other, n, value)
    shape = np.array(next(iter(fewer_axes.values())).shape)
    other.input_type, other.output_type = {"input": shape}, {"output": shape}
    return other


def _extra(shape: Iterable[int], axes: int) -> int:
    """How many leading axes are 1 and beyond these axes."""
    lengths = list(shape)
    found = 0
    while len(lengths) - found > axes and lengths[found] == 1:
        found += 1
    return found
