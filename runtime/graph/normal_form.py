"""The normal form of a graph: one level, parameters in floats and for each value, no batch axes.

Nodes of an inner graph are called outer.inner. Its Input and Output compute nothing; they become
edges.

Whole numbers become floats of the same values: unsigned ones have no negative, and of the smallest
signed one the magnitude does not fit, so that results would be wrong silently.

Some tools write shapes with axes of one in front, for batch or time, which NIR does not count. A
weight matrix takes (M,), a Conv1d (C, X), a Conv2d or pool (C, Y, X); what stands beside one with
the same axes and further ones of length 1 before them has a batch. A Flatten may count it as well.

Some tools write one number for all neurons of a layer, whose shape is then that of what arrives.
"""

import copy
import math
from collections import defaultdict
from collections.abc import Iterable
from itertools import product
from typing import TypeAlias

import nir
import numpy as np

from spikedeploy.runtime.errors import node_error
from spikedeploy.runtime.graph.order import Edge
from spikedeploy.runtime.graph.shapes import (
    CONVOLUTIONS,
    DENSE,
    ELEMENTWISE,
    POOLS,
    Shape,
    flattened_shape,
    output_shape,
    parameter_shape,
    stated_shape,
    whole_numbers,
)
from spikedeploy.runtime.graph.validate import MAX_EDGES, check_edges

Nodes: TypeAlias = dict[str, nir.NIRNode]

_PORTS = (nir.Input, nir.Output)
# geometry of a convolution, which stays in whole numbers; types are derived
_NO_PARAMETERS = {
    "stride", "padding", "dilation", "groups", "input_shape", "input_type", "output_type",
    "metadata",
}  # fmt: skip
_LARGEST_INTEGER = 1 << 53  # up to which float64 holds every whole number


def flatten(graph: nir.NIRGraph, path: str = "") -> nir.NIRGraph:
    """Return the network in one level; the graph itself where nothing is nested.

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
        _unpack(name, flatten(node, f"{path}{name}."), nodes, edges, f"{path}{name}")
    pairs = sorted((source, target) for source, found in edges.after.items() for target in found)
    return nir.NIRGraph(nodes, pairs, metadata=graph.metadata, type_check=False)


class _Edges:
    """Edges that change, by the neighbours of each node."""

    def __init__(self, edges: Iterable[Edge]) -> None:
        self.before: defaultdict[str, set[str]] = defaultdict(set)
        self.after: defaultdict[str, set[str]] = defaultdict(set)
        self.add(edges)

    def add(self, edges: Iterable[Edge]) -> None:
        """Add edges."""
        for source, target in edges:
            self.before[target].add(source)
            self.after[source].add(target)

    def remove(self, name: str) -> tuple[set[str], set[str]]:
        """Remove the edges of a node; its sources and targets, itself in both if it is its own."""
        before, after = self.before.pop(name, set()), self.after.pop(name, set())
        for source in before - {name}:
            self.after[source].discard(name)
        for target in after - {name}:
            self.before[target].discard(name)
        return before, after


def _unpack(outer: str, graph: nir.NIRGraph, nodes: Nodes, edges: _Edges, path: str) -> None:
    """Replace the node `outer` by the nodes and edges of its graph."""
    ends = []
    for kind, found in (("Input", graph.inputs), ("Output", graph.outputs)):
        if len(found) != 1:
            names = ", ".join(sorted(found))
            many = f"the graph inside it has {len(found)} {kind} nodes ({names}), not one"
            raise node_error(path, many, "Give it one, or flatten the graph.")
        ends.append(f"{outer}.{next(iter(found))}")
    for name, node in graph.nodes.items():
        if f"{outer}.{name}" in nodes:
            taken = f"its node {name!r} would be called {outer}.{name}, but that name is taken"
            raise node_error(path, taken, "Rename one of the two.")
        nodes[f"{outer}.{name}"] = node
    before, after = edges.remove(outer)
    first, last = ends
    edges.add((last if source == outer else source, first) for source in before)
    edges.add((last, first if target == outer else target) for target in after)
    edges.add((f"{outer}.{source}", f"{outer}.{target}") for source, target in graph.edges)
    for port in ends:
        _bypass(port, nodes, edges)


def _bypass(port: str, nodes: Nodes, edges: _Edges) -> None:
    """Connect the sources of a port to its targets; keep it where an edge would double."""
    sources, targets = edges.remove(port)
    if len(sources) * len(targets) > MAX_EDGES:
        raise node_error(port, f"more than {MAX_EDGES} edges in one level lead over it")
    if port not in sources and not any(edges.after[source] & targets for source in sources):
        del nodes[port]
        edges.add(product(sources, targets))
        return
    # NIR has no identity node; a Scale by one is one
    stated = np.asarray(nodes[port].output_type["output"])
    shape = whole_numbers(port, "shape", stated, stated.size, 1)
    nodes[port] = nir.Scale(np.ones(shape))
    edges.add((source, port) for source in sources)
    edges.add((port, target) for target in targets)


def with_floats(graph: nir.NIRGraph) -> nir.NIRGraph:
    """The graph with whole parameters in float64; itself where there are none."""
    kinds = (*DENSE, *CONVOLUTIONS, *ELEMENTWISE)
    return _with_nodes(
        graph, {n: _in_floats(n, m) for n, m in graph.nodes.items() if isinstance(m, kinds)}
    )


def _with_nodes(graph: nir.NIRGraph, nodes: Nodes) -> nir.NIRGraph:
    if all(node is graph.nodes[name] for name, node in nodes.items()):
        return graph
    again = {**graph.nodes, **nodes}
    return nir.NIRGraph(again, list(graph.edges), metadata=graph.metadata, type_check=False)


def _in_floats(name: str, node: nir.NIRNode) -> nir.NIRNode:
    whole = {
        field: value
        for field, value in vars(node).items()
        if field not in _NO_PARAMETERS
        and isinstance(value, np.ndarray)
        and value.dtype.kind in "iu"
    }
    if not whole:
        return node
    other = copy.copy(node)
    for field, value in whole.items():
        # max and min in Python, whose numbers do not wrap
        if max(int(value.max()), -int(value.min())) > _LARGEST_INTEGER:
            found = f"{field} holds whole numbers beyond {_LARGEST_INTEGER}, which no float holds"
            raise node_error(name, found, "Scale them down.")
        setattr(other, field, value.astype(np.float64))
    return other


def without_batch_axis(graph: nir.NIRGraph) -> nir.NIRGraph:
    """The graph, ports and neurons without leading axes of 1 that its weights do not have."""
    nodes = graph.nodes
    axes = _axes(graph)
    return _with_nodes(
        graph, {n: _without_leading_axes(nodes[n], axes[n]) for n in axes if n in nodes}
    )


def _axes(graph: nir.NIRGraph) -> dict[str, int]:
    """Number of axes of what arrives at a node or leaves it, where the weights beside it say so."""
    known = {name: axes for name, node in graph.nodes.items() if (axes := _own_axes(node))}
    waiting = list(known)
    near: defaultdict[str, set[str]] = defaultdict(set)
    for source, target in graph.edges:
        near[source].add(target)
        near[target].add(source)
    for here in waiting:
        for name in sorted(near[here]):
            node = graph.nodes.get(name)
            if name not in known and isinstance(node, (*ELEMENTWISE, *_PORTS)):
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


def _without_leading_axes(node: nir.NIRNode, axes: int) -> nir.NIRNode:
    """The port or neurons without leading axes of 1 beyond these; another node itself."""
    if isinstance(node, _PORTS):
        shape = np.asarray(node.output_type["output"])
        extra = _extra(shape.tolist(), axes) if shape.ndim == 1 else 0
        return type(node)(shape[extra:]) if extra else node
    if not isinstance(node, ELEMENTWISE):
        return node
    arrays = {n: value for n, value in vars(node).items() if isinstance(value, np.ndarray)}
    stripped = {n: value[(0,) * _extra(value.shape, axes)] for n, value in arrays.items()}
    if all(stripped[n].ndim == value.ndim for n, value in arrays.items()):
        return node
    other = copy.copy(node)
    vars(other).update(stripped)
    shape = np.array(next(iter(stripped.values())).shape)
    other.input_type, other.output_type = {"input": shape}, {"output": shape}
    return other


def _extra(lengths: Iterable[int], axes: int) -> int:
    """Number of leading axes of length 1 beyond these axes."""
    lengths = list(lengths)
    found = 0
    while len(lengths) - found > axes and lengths[found] == 1:
        found += 1
    return found


def with_full_parameters(graph: nir.NIRGraph) -> nir.NIRGraph:
    """The graph whose nodes have one parameter for every value that arrives, and say their shapes.

    A parameter of size 1 is that of all values, one of shape (C, 1, 1) that of all positions of a
    channel. A Flatten that counts the batch gets axes that do not; an Output behind neurons of size
    1 takes what they put out. What does not fit is left for the check of shapes.
    """
    if not any(map(_is_open, graph.nodes.values())):
        return graph
    sources, targets = defaultdict(list), defaultdict(list)
    for source, target in sorted(graph.edges):
        sources[target].append(source)
        targets[source].append(target)
    nodes, puts, widened = dict(graph.nodes), dict[str, Shape](), set[str]()

    def visit(name: str, arriving: Shape | None) -> None:
        node = nodes[name]
        if arriving is not None:
            behind = widened.intersection(sources[name])
            wanted = [stated_shape(n, nodes[n]) for n in targets[name] if not _is_open(nodes[n])]
            fitted = _fitted(name, node, arriving, next(iter(wanted), None), bool(behind))
            if fitted is not node and isinstance(node, ELEMENTWISE):
                widened.add(name)
            nodes[name] = node = fitted
        takes = stated_shape(name, node) or arriving
        if takes is not None:
            puts[name] = output_shape(name, node, takes)

    for name in sorted(nodes):
        if not _is_open(nodes[name]):
            visit(name, None)
    waiting = sorted(nodes.keys() - puts.keys())
    while waiting:
        new = []
        for name in waiting:
            if name not in puts and (known := [s for s in sources[name] if s in puts]):
                visit(name, puts[known[0]])
                new.append(name)
        waiting = sorted({t for name in new for t in targets[name] if t not in puts})
    return _with_nodes(graph, nodes)


def _is_open(node: nir.NIRNode) -> bool:
    """True if the shape of a node may be that of what arrives."""
    if isinstance(node, nir.Output):
        shape = np.asarray(node.output_type["output"])
        return shape.dtype.kind in "fiu" and shape.ndim == 1 and bool(np.prod(shape) <= 1)
    if isinstance(node, ELEMENTWISE):
        return 1 in parameter_shape(node)
    return isinstance(node, (nir.Flatten, *POOLS)) or (
        isinstance(node, CONVOLUTIONS) and node.input_shape is None
    )


def _fitted(
    name: str, node: nir.NIRNode, arriving: Shape, wanted: Shape | None, widened: bool
) -> nir.NIRNode:
    """The node for what arrives; itself where it fits, or does not fit at all.

    wanted: by the node behind it.
    widened: True if it stands behind a node whose parameters were those of one value.
    """
    if isinstance(node, nir.Flatten):
        return _fitted_flatten(name, node, arriving, wanted)
    if isinstance(node, nir.Output):
        return nir.Output(np.array(arriving)) if widened else node
    if not isinstance(node, ELEMENTWISE):
        return node
    shape = parameter_shape(node)
    single = math.prod(shape) == 1
    aligned = len(shape) == len(arriving) and all(
        a in (1, b) for a, b in zip(shape, arriving, strict=True)
    )
    if shape == arriving or not (single or aligned):
        return node
    other = copy.copy(node)
    for field, value in vars(node).items():
        if isinstance(value, np.ndarray) and value.shape == shape:
            whole = value.reshape(-1)[:1] if single else value
            setattr(other, field, np.array(np.broadcast_to(whole, arriving)))
    other.input_type = {"input": np.array(arriving)}
    other.output_type = {"output": np.array(arriving)}
    return other


def _fitted_flatten(
    name: str, node: nir.Flatten, arriving: Shape, wanted: Shape | None
) -> nir.NIRNode:
    """The Flatten of what arrives, without axes of 1 in front that its shape or its axes count."""
    stated = stated_shape(name, node) or arriving
    extra = len(stated) - len(arriving)
    if extra < 0 or stated != (1,) * extra + arriving:
        return node
    for shift in (extra, 0, 1) if wanted else (extra,):
        start, end = int(node.start_dim), int(node.end_dim)
        other = nir.Flatten(
            {"input": np.array(arriving)},
            max(start - shift, 0) if start > 0 else start,
            max(end - shift, 0) if end > 0 else end,
        )
        if wanted is None or flattened_shape(name, other, arriving) == wanted:
            return node if (extra, shift) == (0, 0) else other
    return node
