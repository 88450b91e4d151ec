"""Graphs nested in graphs, flattened into one level.

The nodes of an inner graph are called outer.inner. Its Input and Output compute nothing; they
become edges.
"""

from collections import defaultdict
from collections.abc import Iterable
from itertools import product

import nir
import numpy as np

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.order import Edge
from spikedeploy.runtime.graph.validate import MAX_EDGES, check_edges
from spikedeploy.runtime.metadata import whole_numbers


def flattened(graph: nir.NIRGraph, path: str = "") -> nir.NIRGraph:
    """The same network in one level; the graph itself where nothing is nested.

    path: of the graph inside an outer one, ending in a dot.
    """
    check_edges(graph, path)
    inner = {n: node for n, node in graph.nodes.items() if isinstance(node, nir.NIRGraph)}
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
