"""Graphs inside graphs, taken apart: the same network in one level.

The nodes of an inner graph are called outer.inner. Its Input and Output are no computation; they
become edges.
"""

from itertools import product

import nir
import numpy as np

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.order import Edge
from spikedeploy.runtime.graph.validate import check_edges
from spikedeploy.runtime.graph.windows import whole_numbers


def flattened(graph: nir.NIRGraph, path: str = "") -> nir.NIRGraph:
    """The graph in one level; itself if it is so already."""
    check_edges(graph, path)
    inner = {n: node for n, node in graph.nodes.items() if isinstance(node, nir.NIRGraph)}
    if not inner:
        return graph
    nodes = {name: node for name, node in graph.nodes.items() if name not in inner}
    edges = set(graph.edges)
    for name, node in sorted(inner.items()):
        _unpack(name, flattened(node, f"{path}{name}."), nodes, edges, f"{path}{name}")
    return nir.NIRGraph(nodes, sorted(edges), metadata=graph.metadata, type_check=False)


def _unpack(
    outer: str, graph: nir.NIRGraph, nodes: dict[str, nir.NIRNode], edges: set[Edge], path: str
) -> None:
    """Put the nodes and edges of an inner graph in its place."""
    entry = _port(path, graph.inputs, "Input")
    leaving = _port(path, graph.outputs, "Output")
    for name, node in graph.nodes.items():
        if f"{outer}.{name}" in nodes:
            raise ArtifactError(
                f"node {path!r}: its node {name!r} would be called {outer}.{name}, but there is "
                "one already. Rename one of the two."
            )
        nodes[f"{outer}.{name}"] = node
    for source, target in list(edges):
        if outer in (source, target):
            edges.remove((source, target))
            source = f"{outer}.{leaving}" if source == outer else source
            target = f"{outer}.{entry}" if target == outer else target
            edges.add((source, target))
    edges.update((f"{outer}.{source}", f"{outer}.{target}") for source, target in graph.edges)
    for port in (entry, leaving):
        _short_circuit(f"{outer}.{port}", nodes, edges)


def _short_circuit(port: str, nodes: dict[str, nir.NIRNode], edges: set[Edge]) -> None:
    """Join what comes to a port with what follows; where that would double an edge, keep it."""
    sources = [source for source, target in edges if target == port]
    targets = [target for source, target in edges if source == port]
    through = set(product(sources, targets))
    if port in sources or through & edges:
        # times one: NIR's way to write a node that does nothing
        stated = np.asarray(nodes[port].output_type["output"])
        shape = whole_numbers(port, "shape", stated, stated.size, least=1)
        nodes[port] = nir.Scale(np.ones(shape))
        return
    del nodes[port]
    edges -= {(source, port) for source in sources} | {(port, target) for target in targets}
    edges |= through


def _port(path: str, found: dict[str, nir.NIRNode], kind: str) -> str:
    if len(found) != 1:
        raise ArtifactError(
            f"node {path!r}: the graph inside it has {len(found)} {kind} nodes "
            f"({', '.join(sorted(found))}), and an edge cannot say which it means. Give it one, or "
            "flatten the graph in the tool that wrote it."
        )
    return next(iter(found))
