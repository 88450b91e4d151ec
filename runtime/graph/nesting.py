"""Graphs nested in graphs, flattened into one level.

The nodes of an inner graph are called outer.inner. Its Input and Output compute nothing; they
become edges.
"""

from itertools import product

import nir
import numpy as np

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.order import Edge
from spikedeploy.runtime.graph.validate import check_edges
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
    edges = set(graph.edges)
    for name, node in sorted(inner.items()):
        _unpack(name, flattened(node, f"{path}{name}."), nodes, edges, f"{path}{name}")
    return nir.NIRGraph(nodes, sorted(edges), metadata=graph.metadata, type_check=False)


def _unpack(
    outer: str, graph: nir.NIRGraph, nodes: dict[str, nir.NIRNode], edges: set[Edge], path: str
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
    for source, target in list(edges):
        if outer in (source, target):
            edges.remove((source, target))
            source = f"{outer}.{exit_}" if source == outer else source
            target = f"{outer}.{entry}" if target == outer else target
            edges.add((source, target))
    edges.update((f"{outer}.{source}", f"{outer}.{target}") for source, target in graph.edges)
    for port in (entry, exit_):
        _bypass(f"{outer}.{port}", nodes, edges)


def _bypass(port: str, nodes: dict[str, nir.NIRNode], edges: set[Edge]) -> None:
    """Connect the sources of a port to its targets; keep it where an edge would double."""
    sources = [source for source, target in edges if target == port]
    targets = [target for source, target in edges if source == port]
    through = set(product(sources, targets))
    if port in sources or through & edges:
        # NIR has no identity node; a Scale by one is one
        stated = np.asarray(nodes[port].output_type["output"])
        shape = whole_numbers(port, "shape", stated, stated.size, minimum=1)
        nodes[port] = nir.Scale(np.ones(shape))
        return
    del nodes[port]
    edges -= {(source, port) for source in sources} | {(port, target) for target in targets}
    edges |= through


def _port(path: str, found: dict[str, nir.NIRNode], kind: str) -> str:
    if len(found) != 1:
        raise ArtifactError(
            f"node {path!r}: the graph inside it has {len(found)} {kind} nodes "
            f"({', '.join(sorted(found))}); it must have one, because an edge names only the outer "
            "node. Give it one, or flatten the graph in the tool that wrote it."
        )
    return next(iter(found))
